"""Rates, jumps and fast parts of uncertain terms: keys, proofs, premises, attacks."""

import copy
from dataclasses import replace
from functools import cache

import flint
import independent_checker
import numpy as np
import pytest

import certrack
from certrack import InputError
from certrack.certificates import to_document, verify
from certrack.certificates.document import _digest
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import (
    RATES_PART,
    _bounds,
    cells_of,
    failed_implemented,
    periods_needed,
)
from certrack.certificates.implemented.slow import SlowTerms, as_function
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable
from certrack.model.slowness import slow_size
from certrack.studies.ensembles.members import Members
from certrack.studies.falsifier.linear.slow_signal import _worst

ESO = certrack.load("dual-motor-observer")
ZERO = [0.0] * 4
RATES = {"rate": [0, "inf", 0, 0.1], "Delta_rate": [ZERO, ZERO, ZERO, [0.01] * 4]}


def with_rates(system=ESO, **values):
    uncertainty = replace(system.plant.uncertainty, **(RATES | values))
    return system.replace(plant=replace(system.plant, uncertainty=uncertainty))


def axis(observer=True, omega="0.3*sin(3*t)", **values):
    """An axis at 200 Hz: fast to prove."""
    text = """
[plant]
states = ["x1", "x2"]
chain = [1]
drift = "-2*x2"
gain_sign = 1
input_gain = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 1]
[truth]
input_gain = 1
omega = [0, "OMEGA"]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [8, 8]
feedforward = 1
sampled_feedforward = true
OBSERVER
[implementation]
period = 0.005
delay = 0.5
measurement_quantum = [1e-4, 1e-4]
[simulation]
x0 = [0, 0]
duration = 10
"""
    part = '[law.observer]\nkind = "dob"\nbandwidth = 6\n' if observer else ""
    system = certrack.loads(text.replace("OMEGA", omega).replace("OBSERVER", part))
    uncertainty = replace(system.plant.uncertainty, **values)
    return system.replace(plant=replace(system.plant, uncertainty=uncertainty))


@cache
def proven(observer=True, **values):
    return certify_implemented(
        axis(observer, **{k: list(v) if isinstance(v, tuple) else v for k, v in values.items()})
    )


# Keys -------------------------------------------------------------------------------------------


def test_files():
    system = with_rates(jump=[0, 0, 0, 0.05], dwell=2.0, fast=[0, 0, 0, "1/50"])
    assert certrack.loads(certrack.to_text(system)) == system


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rate": None, "Delta_rate": None, "jump": [0, 0, 0, 1]}, "jump: .*needs rate"),
        ({"jump": [0, 0, 0, 1]}, "jump: needs dwell"),
        ({"dwell": 1.0}, "dwell: belongs to jump"),
        ({"jump": [0, 0, 0, 1], "dwell": 0}, "dwell: must be positive"),
        ({"fast": [0, 0, 0, 0.2]}, r"fast\[3\]: must be at most beta\[3\] = 0.1"),
        ({"fast": [0, 0.1, 0, 0]}, r"fast\[1\]: must be zero where rate\[1\] is inf"),
        ({"rate": [0, 0, 0, -1]}, r"rate\[3\]: must be zero or positive"),
        ({"rate": [1]}, "rate: must be a list of 4"),
        ({"Delta_rate": [[0] * 3] * 4}, r"Delta_rate\[0\]: must be a list of 4"),
    ],
)
def test_what_says_nothing_is_refused(values, message):
    with pytest.raises(InputError, match=f"plant.uncertainty.{message}"):
        with_rates(**values)


# The bound --------------------------------------------------------------------------------------


def test_slower_is_smaller():
    plain, _ = proven()
    bounds = [proven(rate=(0, r))[0].bound for r in (100.0, 1.0, 0.1)]
    assert bounds[0] == pytest.approx(plain.bound, rel=1e-6)
    assert all(a >= b for a, b in zip(bounds, bounds[1:], strict=False))
    assert bounds[-1] < 0.5 * plain.bound
    with_jumps = proven(rate=(0, 0.1), jump=(0, 0.5), dwell=2.0)[0].bound
    with_fast = proven(rate=(0, 0.1), fast=(0, 0.1))[0].bound
    assert bounds[-1] < min(with_jumps, with_fast) < max(with_jumps, with_fast) < plain.bound
    found = proven(rate=(0, 0.1))[0]
    assert sum(found.parts.values()) == pytest.approx(found.bound, rel=1e-3)
    assert found.parts[RATES_PART] < 0


def test_nothing_is_claimed_without_an_estimate():
    plain, rated = proven(False), proven(False, rate=(0, 0.0))
    assert rated[0].bound == plain[0].bound
    assert not rated[1][0].slow


def test_a_rate_of_the_states_counts():
    free, bound = (proven(rate=(0, 0.1), Delta_rate=d)[0].bound for d in (None, ((0, 0), (0, 1.0))))
    assert free < bound


def test_any_z_is_a_bound():
    """TV(z) s0 + rho int |g - z| is never below what a slow signal reaches, whatever z is."""
    system = axis(rate=[0, 0.5])
    _, (proof,) = certify_implemented(system)
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive_of(system), cells_of(drive_of(system)))
        doublings = periods_needed(period)
        bounds = _bounds(period, doublings)
        X = [flint.arb(float(v)) for v in proof.states]
        terms = SlowTerms.of(period, bounds, doublings, X, flint.arb(float(proof.input)))
    responses, rng = terms.responses, np.random.default_rng(1)
    old = bounds.gains.old[terms.chosen, 0]
    g = responses.end[:, :, -1, 0]
    for row in range(0, len(g), 3):
        increments = np.diff(responses.end[row, ..., 0].ravel(), prepend=0.0)
        lengths = responses.lengths[row].ravel()
        held = lengths > 0
        edges = np.concatenate([[0.0], np.cumsum(lengths[held])])
        times, values = _worst(increments[held], edges, 1.0, 0.5)
        reached = increments[held] @ np.interp((edges[1:] + edges[:-1]) / 2, times, values)
        for z in (
            as_function(proof.slow[0], len(g[0])),
            g[row],
            0 * g[row],
            rng.normal(size=len(g[0])),
        ):
            tv, area, _ = responses.measures(0, z, old, 0)
            assert tv[row] + 0.5 * area[row] >= reached * (1 - 1e-9)
        tv, area, _ = responses.measures(0, as_function(proof.slow[0], len(g[0])), old, 0)
        assert tv[row] + 0.5 * area[row] <= 1.05 * reached  # the program leaves little


# Saved proofs -----------------------------------------------------------------------------------


def saved():
    system = axis(omega="0.3*sin(t)", rate=[0, 0.3], jump=[0, 0.2], dwell=1.0, fast=[0, 0.01])
    _, proofs = certify_implemented(system)
    return system, proofs, to_document(system, *proofs)


def test_verified_and_by_another_reading():
    _, proofs, document = saved()
    assert proofs[0].slow
    verdict = verify(document)
    assert verdict.verified, verdict.reason
    assert float(independent_checker.check(document)) == float(proofs[0].bound)


def changed(document, **values):
    body = copy.deepcopy(document)
    body["proof"][0] |= values
    body["claim"] = f"limsup |e_1(t)| <= {body['proof'][0]['bound']}"
    return body | {"sha256": _digest(body)}


@pytest.mark.slow
def test_mutants_are_refused():
    _, (proof,), document = saved()
    less = f"{float(proof.bound) * (1 - 1e-4):.12g}"
    steps = [list(step) for step in proof.slow[0]]
    mutants = [
        changed(document, bound=less),
        changed(document, slow=[[[0, "0.5"]]]),
        changed(document, slow=[[*steps[:1], [steps[1][0], "nan"], *steps[2:]]]),
        changed(document, slow=[steps[1:]]),
        changed(document, slow=[[*steps, [10**6, "0"]]]),
        changed(document, slow=[steps, steps]),
        changed(document, slow=[]),
    ]
    for text in ("rate = [0.0, 0.3]", "jump = [0.0, 0.2]", "fast = [0.0, 0.01]"):
        assert text in document["system"]
        smaller = text.replace("0.3]", "0.03]").replace("0.2]", "0.0]").replace("0.01]", "0.0]")
        body = document | {"system": document["system"].replace(text, smaller)}
        if "jump" in text:
            body["system"] = body["system"].replace("dwell = 1.0\n", "")
        mutants.append(body | {"sha256": _digest(body)})
    for mutant in mutants:
        refused = 0
        for check in (lambda d: verify(d).verified, independent_checker.check):
            try:
                refused += not check(mutant)
            except (InputError, independent_checker.Refused, ValueError):
                refused += 1
        assert refused, mutant["proof"][0]["slow"]
    assert failed_implemented(axis(False, rate=[0, 0.3]), proof, flint.fmpq(1, 2))


# Premises ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("omega", "values", "status"),
    [
        ("0.3*sin(t)", {"rate": [0, 0.3]}, "proven"),
        ("0.3*sin(t)", {"rate": [0, 0.25]}, "contradicted"),
        ("0.3*sin(t) + 0.1*tanh(x2)", {"rate": [0, 0.3]}, "contradicted"),
        ("0.3*sin(t) + 0.1*x2", {"rate": [0, 0.3], "Delta_rate": [[0, 0], [0, 0.1]]}, "proven"),
        ("0.3*sign(sin(t))", {"rate": [0, 0.3]}, "contradicted"),
        ("0.3*sign(x2)", {"rate": [0, 0], "jump": [0, 0.6], "dwell": 1.0}, "assumed"),
        ("0.1*sin(90*t)", {"rate": [0, 0], "fast": [0, 0.1]}, "assumed"),
    ],
)
def test_the_truth_against_the_rates(omega, values, status):
    system = axis(omega=omega, gamma=[0, 0.2] if "x2" in omega else [0, 0], **values)
    _, proofs = certify_implemented(system)
    found = [p for p in premises_as_implemented(system, proofs) if p.name == "rate of w_2"]
    assert [p.status for p in found] == [status]


# Signals ----------------------------------------------------------------------------------------


def test_members_keep_to_the_rates():
    system = axis(rate=[0, 0.3])
    system = system.replace(population=certrack.Population(disturbance="multisine"))
    members = Members(system, seed=1)
    fastest = members.population.frequencies[1]
    assert slow_size(system.plant.uncertainty, 1, fastest) * fastest <= 0.3
    for i in range(3):
        t, values = over_time(members.member(i).truth.omega[1], 10)
        assert np.abs(np.diff(values)).max() <= 0.3 * t[1] * (1 + 1e-9)
        assert np.abs(values).max() > 0


def over_time(formula, end):
    t = np.linspace(0, end, 2001)
    return t, np.broadcast_to(numpy_callable([TIME], [formula.expr])(t)[0], t.shape)


def test_attacks_keep_to_the_rates_and_stay_below():
    system = axis(rate=[0, 0.3])
    found = certrack.falsify(system, budget=30)
    drive = found.drive
    assert drive.estimate <= drive.certificate.bound <= 1.3 * drive.estimate
    assert not drive.exceeds
    assert certrack.simulate(drive.system).outcome.name == "finished"
    t, values = over_time(drive.system.truth.omega[1], drive.system.settings.duration)
    assert np.abs(np.diff(values)).max() <= 0.3 * t[1] * (1 + 1e-6)
    assert np.abs(values).max() <= 1


def test_a_rate_too_small_is_caught():
    """A certificate for a tenth of the rate is below what a signal of the true rate reaches."""
    believed, _ = proven(rate=(0, 0.1))
    attack = certrack.falsify(axis(rate=[0, 1.0]), budget=30).drive
    assert attack.estimate > believed.bound
