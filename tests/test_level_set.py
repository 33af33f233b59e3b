"""Premises that hold near the states only: the level set that keeps them, and what it allows."""

from dataclasses import replace
from fractions import Fraction

import independent_checker
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.certificates import certify, to_document, verify
from certrack.certificates.layout import digest_of
from certrack.certificates.level_set import (
    KeptRegion,
    kept_region,
    largest_box,
    premises_from_x0,
    region_of_level,
)
from certrack.certificates.region import claim_text, is_only_in_region
from certrack.systems.writer import to_text


def example(omega="0.002*x2**3 + 0.1/(1 + t)", **plant):
    """Example 1 with |w_2| <= 0.04 ||x|| + 0.02 while |x2| <= 10, far away not."""
    base = certrack.load("example1")
    return base.replace(
        plant=replace(base.plant, **plant), truth=replace(base.truth, omega=("0", omega))
    )


def robust():
    """A robust design whose truth breaks its bound far away."""
    base = certrack.load("dual-motor-lean")
    u = replace(base.plant.uncertainty, gamma=(0, 0.04, 0, 0.01))
    omega = ("0", "0.0001*x2**3", "0", str(base.truth.omega[3]))
    return base.replace(
        plant=replace(base.plant, uncertainty=u), truth=replace(base.truth, omega=omega)
    )


@pytest.fixture(scope="module")
def system():
    return example()


@pytest.fixture(scope="module")
def found(system):
    return certify(system)


# Claims -------------------------------------------------------------------------------------------


def test_what_breaks_far_away_is_certified_from_x0(system, found):
    assert found.verified and found.best.kind == "bootstrap"
    assert found.best.bound == certify(example("0")).best.bound  # the proof is the same
    (held,) = (p for p in found.premises if is_only_in_region([p]))
    assert held.name == "w_2 in the region" and held.status == "proven"
    assert found.tube is not None and found.starts_box > 1
    document = to_document(system, *found.stages)
    assert document["claim"].endswith(" from simulation.x0")
    assert verify(document).verified
    independent_checker.check(document)


@pytest.mark.parametrize("drift", ["log(x1 + 6)", "asin(x1/4)", "sqrt(x1 + 6)", "1/(x2 - 8)"])
def test_a_formula_that_ends_far_away_is_certified_from_x0(drift):
    system = example("0.1/(1 + t)", drift=drift)
    found = certify(system, "fast")
    assert found.verified
    assert [p.name for p in found.premises if is_only_in_region([p])] == ["domain in the region"]
    document = to_document(system, *found.stages)
    assert verify(document).verified
    if not {"log", "asin"} & {drift[:3], drift[:4]}:  # of which it knows no intervals
        independent_checker.check(document)
    near = example("0.1/(1 + t)", drift="log(x1 + 1)")
    assert [p.name for p in certify(near, "fast").contradicted] == ["domain"]


def test_what_breaks_where_the_states_may_be_is_refused():
    refused = certify(example("0.008*x2**3"), "fast")
    assert not refused.verified and refused.region is None and refused.stages == ()
    assert [p.name for p in refused.contradicted] == ["w_2"]


def test_peak_gains_rest_on_the_same_region():
    system = robust()
    found = certify(system, "fast")
    assert found.verified and found.best.kind == "peak"
    document = to_document(system, *found.stages)
    assert verify(document).verified
    independent_checker.check(document)


def test_without_need_there_is_no_region():
    system = certrack.load("example1")
    found = certify(system, "fast")
    assert found.region is None and found.starts_box is None
    assert kept_region(system, [found.proof]) is None
    document = to_document(system, KeptRegion(found.proof), *found.stages)
    assert "region" in document and not verify(document).verified


def test_a_soft_start_has_no_region(system, found):
    text = to_text(system).replace("[reference]", "[reference]\ntransient = 1.0")
    soft = certrack.loads(text)
    assert region_of_level(soft, found.region) is None
    assert not certify(soft, "fast").verified


# Forged files -------------------------------------------------------------------------------------


def sealed(document):
    return document | {"sha256": digest_of(document)}


def scaled(region, **factors):
    """The region with numbers scaled."""
    changed = dict(region)
    for name, factor in factors.items():

        def times(value, factor=factor):
            if isinstance(value, str):
                return repr(float(value) * factor)
            return [times(v) for v in value]

        changed[name] = times(region[name])
    return changed


@pytest.mark.parametrize("factors", [{"P": 3}, {"alpha": 3}, {"bound": 0.5}, {"nu": 0.2}])
def test_a_region_that_is_not_kept_is_refused(system, found, factors):
    document = to_document(system, *found.stages)
    forged = sealed(document | {"region": scaled(document["region"], **factors)})
    assert not verify(forged).verified
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(forged)


def test_other_claims_are_refused(system, found):
    document = to_document(system, *found.stages)
    bare = {key: value for key, value in document.items() if key != "region"}
    every_start = document["claim"].removesuffix(" from simulation.x0")
    farther = document["system"].replace("x0 = [1.0, 2.0]", "x0 = [3.0, 6.0]")
    assert farther != document["system"]
    for change in (bare, document | {"claim": every_start}, document | {"system": farther}):
        assert not verify(sealed(change)).verified
        with pytest.raises(independent_checker.Refused):
            independent_checker.check(sealed(change))


def test_the_claim_in_words():
    assert claim_text("0.1", False) + " from simulation.x0" == claim_text("0.1", True)


# What the level set keeps -------------------------------------------------------------------------


def test_the_region_is_the_ellipsoid_of_v(system, found):
    """x_2 at its largest over the level set, by the Lagrange multiplier in floats."""
    region = region_of_level(system, found.region)
    proof, design = found.region.stage, system.controller.coordinates
    P = np.array(proof.P, dtype=float)
    start = certrack.certificates.tube(system, proof).start
    row = np.linalg.inv(design.A)[1]
    size = np.sqrt(start * row @ np.linalg.solve(P, row))
    offset = np.abs(row @ design.B) @ [0.2] * 1
    assert float(region[1]) == pytest.approx(size + offset, rel=1e-6)
    assert float(region[1]) >= size + offset


def test_starts_in_the_box_keep_the_region_and_one_beyond_breaks_it(system, found):
    r = found.starts_box
    everywhere = premises_from_x0(system, found.region)
    assert not any(p.contradicted for p in everywhere)
    box = [(v - r, v + r) for v in system.settings.x0]
    region = region_of_level(system, found.region, box)
    assert all(a >= b for a, b in zip(region, region_of_level(system, found.region), strict=True))
    assert region[1] <= 10  # where 0.002 x^3 passes 0.2 |x|
    wider = [(v - 1.01 * r, v + 1.01 * r) for v in system.settings.x0]
    assert region_of_level(system, found.region, wider)[1] > Fraction(97, 10)
    assert largest_box(system, found.region) == r


@settings(max_examples=12, deadline=None)
@given(
    corner=st.lists(st.floats(-1, 1), min_size=2, max_size=2),
    frequency=st.floats(0.2, 20),
    phase=st.floats(0, 6),
    share=st.floats(-1, 1),
)
def test_no_run_from_the_box_leaves_the_region(system, found, corner, frequency, phase, share):
    """Disturbances at the edge of their bound while the states are in the region."""
    r = found.starts_box
    x0 = tuple(v + r * c for v, c in zip(system.settings.x0, corner, strict=True))
    region = region_of_level(system, found.region, [(v - r, v + r) for v in system.settings.x0])
    wave = f"sin({frequency}*t + {phase})"
    omega = (f"0.5*sqrt(x1**2 + x2**2)*{wave}", f"{share}*0.002*x2**3 + (1 - {abs(share)})*0.1")
    case = system.replace(
        truth=replace(system.truth, omega=omega), settings=replace(system.settings, x0=x0)
    )
    run = certrack.simulate(case)
    assert (np.abs(run.x).max(axis=1) <= np.array(region, dtype=float)).all()
    assert run.metrics.tail_error <= found.best.bound
