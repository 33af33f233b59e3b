"""Premises that hold near the states only: the level set that keeps them, and what it allows."""

from dataclasses import replace
from fractions import Fraction

import independent_checker
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.certificates import certify, certify_semidefinite, to_document, verify
from certrack.certificates.document import save_certificate
from certrack.certificates.layout import digest_of
from certrack.certificates.level_set import (
    KeptRegion,
    kept_region,
    largest_box,
    premises_from_x0,
    region_of_level,
)
from certrack.certificates.premise import contradicted
from certrack.certificates.region import claim_text, is_only_in_region
from certrack.cli import cli
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


@pytest.mark.slow
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


def test_what_is_seen_to_break_in_the_region_is_not_replaced():
    """A hump above the bound near one state: only the polished search meets it."""
    hump = "(0.1 + 0.2*sqrt(x1**2 + x2**2))*exp(-(x1 - 0.713)**2 - (x2 - 1.377)**2)*1.00001"
    for far in ("", "0.00001*x2**3 + "):  # with it, random states far away break the bound first
        system = example(far + hump)
        refused = certify(system, "fast")
        assert [p.name for p in refused.contradicted] == ["w_2"]
        assert not refused.verified and refused.stages == () and refused.starts_box is None
        stage = certify_semidefinite(system)[1]
        assert contradicted(premises_from_x0(system, KeptRegion(stage)))


def test_a_box_of_starts_is_proven_and_not_sampled():
    """The bound holds, but no rule proves it: from x0 it is checked, and no box is claimed."""
    system = example("0.004*x2**3*(1 - cos(x2))")
    found = certify(system, "fast")
    (held,) = (p for p in found.premises if is_only_in_region([p]))
    assert held.status == "checked" and held.detail.endswith("the worst polished")
    assert found.verified and found.starts_box == 0


#: A first order plant in which w_1 breaks its bound far away, or near a singular root.
FIRST_ORDER = """
[plant]
states = ["x1"]
gain_sign = 1
input_gain = 1.0

[plant.uncertainty]
tau = [1]
gamma = [{gamma}]
beta = [{beta}]

[truth]
input_gain = 1.0
omega = ["{omega}"]

[reference]
signal = "{signal}"

[law]
kind = "robust"
c = [2.0]

[simulation]
x0 = [0]
duration = 10
"""


def test_a_level_of_zero_keeps_nothing():
    """x' = -2 x + sqrt(|x|) leaves the origin, for 1/4."""
    text = FIRST_ORDER.format(gamma=0.5, beta=0, omega="sqrt(abs(x1))", signal="0")
    system = certrack.loads(text)
    found, stage = certify_semidefinite(system)
    assert found.bound == 0 and region_of_level(system, KeptRegion(stage)) is None
    assert [p.name for p in certify(system, "fast").contradicted] == ["w_1"]
    x0 = replace(system.settings, x0=(1e-12,))
    assert certrack.simulate(system.replace(settings=x0)).metrics.tail_error > 0.2


def test_a_reference_without_bounds_has_no_region():
    system = certrack.loads(FIRST_ORDER.format(gamma=0, beta=1, omega="x1**3/100", signal="t"))
    assert [p.name for p in certify(system, "fast").contradicted] == ["w_1"]


#: A truth with states of its own, which may have other units or be more.
OWN_STATES = """
[plant]
states = ["x1", "x2"]
chain = [1]
drift = "log(x1 + 12)"
gain_sign = 1
input_gain = 1.0

[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]

[truth]
states = ["a", "b"{more}]
rates = ["b", "u"{rate}]
outputs = [{outputs}]

[reference]
signal = "sin(t)"

[law]
kind = "robust"
c = [2.0, 2.0]

[simulation]
x0 = [0.1, 0{start}]
duration = 10
"""


@pytest.mark.parametrize(
    "own",
    [
        {"more": "", "rate": "", "start": "", "outputs": '"10*a", "b"'},
        {"more": ', "d"', "rate": ', "-d"', "start": ", 0", "outputs": '"a", "b"'},
    ],
)
def test_no_box_is_claimed_of_a_truth_with_states_of_its_own(own):
    """x0 is of these states, the region of those of the design."""
    found = certify(certrack.loads(OWN_STATES.format(**own)), "fast")
    assert found.verified and found.region is not None and found.starts_box == 0


def test_what_is_said_names_the_start(system, found, tmp_path):
    assert repr(found).endswith("from x0)")
    path = tmp_path / "region.json"
    save_certificate(system, found.stages, path)
    said = CliRunner().invoke(cli, ["verify", str(path)])
    assert said.exit_code == 0 and " from simulation.x0, resting on" in said.output


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


def test_a_region_has_no_shift(system, found):
    document = to_document(system, *found.stages)
    forged = sealed(document | {"region": document["region"] | {"shift": "0.5"}})
    assert "a shift" in verify(forged).reason
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
