"""Rates, jumps and fast parts of uncertain terms: keys, proofs, premises, attacks."""

import copy
import json
import re
from dataclasses import replace
from functools import cache

import flint
import independent_checker
import numpy as np
import pytest
from depth import depth
from observer_loops import with_estimates
from slow_attack import with_random_rates, worst_slow_error
from test_implemented import random_drive

import certrack
import certrack.certificates.implemented.drive as drive_module
from certrack import InputError
from certrack.certificates import to_document, verify
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.document import implemented_proofs, record_of
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import (
    RATES_PART,
    _bounds,
    cells_of,
    periods_needed,
)
from certrack.certificates.implemented.slow import SlowTerms, as_function
from certrack.certificates.layout import digest_of
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable
from certrack.model.slowness import slow_size
from certrack.reports.sampled import implemented_notes
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


def on_drive(system, **values):
    return system.replace(implementation=replace(system.implementation, **values))


def with_integral(system):
    return system.replace(law=replace(system.law, observer=None, integral=4.0))


def with_formula(system):
    uncertainty = replace(system.plant.uncertainty, beta=(0, 0), bound=("", "0.5 + 0.05*x2**2"))
    return system.replace(plant=replace(system.plant, uncertainty=uncertainty))


def with_range(system):
    text = certrack.to_text(system).replace('drift = "-2*x2"', 'drift = "-a*x2"')
    text = text.replace("[plant.constants]", "[plant.constants]\na = 2")
    return certrack.loads(text.replace("[plant.ranges]", "[plant.ranges]\na = [1.9, 2.1]"))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda s: on_drive(s, jitter=0.02), "implementation.jitter"),
        (with_range, "plant.ranges"),
        (lambda s: s.replace(law=replace(s.law, observer=None)), "nothing estimates"),
        pytest.param(lambda s: on_drive(s, saturation=(-20, 20)), "", marks=pytest.mark.slow),
        (lambda s: on_drive(s, delay=(0.5, 1.0)), ""),
        pytest.param(with_formula, "", marks=pytest.mark.slow),
        (with_integral, ""),
    ],
)
def test_what_stands_beside_rates(change, reason):
    """They count, and the file is verified; or they are left out, and that is said."""
    plain, rated = (change(axis(omega="0.1*sin(t)", **v)) for v in ({}, {"rate": [0, 0.3]}))
    without, _ = certify_implemented(plain)
    found, proofs = certify_implemented(rated)
    assert verify(to_document(rated, *proofs)).verified
    notes = " ".join(implemented_notes(found, 5))
    if reason:
        assert found.bound == without.bound
        assert reason in found.rates_unused in notes
    else:
        assert found.bound < 0.3 * without.bound
        assert found.slow == ("w_2",)
        (printed,) = re.findall(
            r"w_2 is slow and estimated: without the rates \|e_1\| <= (\S+)", notes
        )
        assert float(printed) == pytest.approx(without.bound, rel=1e-3)
    assert not without.slow and not without.rates_unused


def test_jumps_as_often_as_they_hurt():
    """Below a period, and below what the estimate takes, nothing is left of the rates."""
    bounds = [
        proven(rate=(0, 0.3), jump=(0, 0.2), dwell=dwell)[0].bound
        for dwell in (0.004, 0.01, 0.02, 0.1, 1.0, 10.0)
    ]
    assert bounds[0] == bounds[1] == proven()[0].bound
    assert bounds[1] > bounds[2] > bounds[3] > bounds[4] > bounds[5]


# Saved proofs -----------------------------------------------------------------------------------


@cache
def saved():
    values = {"rate": [0, 3.0], "jump": [0, 0.2], "dwell": 1.0, "fast": [0, 0.01]}
    system = axis(omega="0.3*sin(10*t)", **values)
    _, proofs = certify_implemented(system)
    return system, proofs, to_document(system, *proofs)


def test_verified():
    _, proofs, document = saved()
    assert proofs[0].slow
    verdict = verify(document)
    assert verdict.verified, verdict.reason


def less(text, factor=0.9999):
    return repr(float(text) * factor)


def with_z(change):
    return lambda p: replace(p, slow=(tuple(change(list(p.slow[0]))),))


def in_the_middle(z, *steps):
    half = len(z) // 2
    return [*z[:half], *steps, *z[half + 1 :]]


#: Numbers of the proof that are better than they may be, or prove nothing.
MUTANTS = {
    "bound": lambda p: replace(p, bound=less(p.bound)),
    "step": lambda p: replace(p, step=less(p.step)),
    "states": lambda p: replace(p, states=tuple(map(less, p.states))),
    "input": lambda p: replace(p, input=less(p.input)),
    "z is zero": with_z(lambda z: [(0, "0")]),
    "z has one value": with_z(lambda z: [(0, "0.0005")]),
    "z has another sign": with_z(lambda z: [(m, less(v, -1)) for m, v in z]),
    "z is twice as large": with_z(lambda z: [(m, less(v, 2)) for m, v in z]),
    "z has one step less": with_z(lambda z: in_the_middle(z)),
    "z has one larger value": with_z(
        lambda z: in_the_middle(z, (z[len(z) // 2][0], less(z[len(z) // 2][1], 2)))
    ),
    "z does not begin": with_z(lambda z: z[1:]),
    "z turns back": with_z(lambda z: [z[0], z[2], z[1], *z[3:]]),
    "z is beyond all periods": with_z(lambda z: [*z, (10**6, "0")]),
    "z is before the first": with_z(lambda z: [(-1, "0"), *z]),
    "two z": lambda p: replace(p, slow=p.slow * 2),
    "no z": lambda p: replace(p, slow=()),
}

CONSTANTS = """drift = "{}"
regressor = []
gain_sign = 1
input_gain = 1

[plant.constants]
{}
[plant.ranges]
{}"""

#: Systems for which the bound is claimed as well, and is none.
WORSE = {
    "a higher rate": ("rate = [0.0, 3.0]", "rate = [0.0, 3.001]"),
    "an unknown rate": (
        "rate = [0.0, 3.0]\njump = [0.0, 0.2]\ndwell = 1.0\nfast = [0.0, 0.01]",
        "rate = [0.0, inf]",
    ),
    "a rate of the states": ("dwell = 1.0", "dwell = 1.0\nDelta_rate = [[0, 0], [0, 0.01]]"),
    "a larger jump": ("jump = [0.0, 0.2]", "jump = [0.0, 0.21]"),
    "a shorter window": ("dwell = 1.0", "dwell = 0.25"),
    "a window of less than a period": ("dwell = 1.0", "dwell = 0.004"),
    "a larger fast part": ("fast = [0.0, 0.01]", "fast = [0.0, 0.011]"),
    "a larger w": ("beta = [0.0, 1.0]", "beta = [0.0, 1.001]"),
    "a w that grows": ("gamma = [0.0, 0.0]", "gamma = [0.0, 0.001]"),
    "a slower estimate": ("bandwidth = 6.0", "bandwidth = 5.99"),
    "jitter": ("delay = 0.5", "delay = 0.5\njitter = 0.001"),
    "a range": (
        CONSTANTS.format("-2*x2", "", ""),
        CONSTANTS.format("-a*x2", "a = 2", "a = [1, 3]"),
    ),
}


def rewritten(document, proof=None, text=None):
    """A file with another proof, or another system: signed, with its own claim and premises."""
    body = copy.deepcopy(document)
    if proof is not None:
        body["proof"] = [json.loads(json.dumps(record_of(proof)))]
    if text is not None:
        before, after = text
        assert body["system"].count(before) == 1
        body["system"] = body["system"].replace(before, after)
    system, proofs = certrack.loads(body["system"]), implemented_proofs(body["proof"])
    body["claim"] = f"limsup |e_1(t)| <= {proofs[0].bound}"
    body["premises"] = [p.record() for p in premises_as_implemented(system, proofs)]
    return body | {"sha256": digest_of(body)}


def refused_by_the_page(document):
    try:
        independent_checker.check(document)
    except (independent_checker.Refused, ValueError):
        return True
    return False


@pytest.mark.parametrize("name", MUTANTS)
def test_changed_proofs_are_refused(name):
    """`verify` refuses each for what its proof says, not for a sum or a premise of the file."""
    _, (proof,), document = saved()
    verdict = verify(rewritten(document, MUTANTS[name](proof)))
    assert not verdict.verified
    assert re.search("bound|z |periods", verdict.reason), verdict.reason


@pytest.mark.parametrize("name", WORSE)
def test_a_bound_of_less_is_refused(name):
    _, _, document = saved()
    verdict = verify(rewritten(document, text=WORSE[name]))
    assert not verdict.verified
    assert "premise" not in verdict.reason, verdict.reason


@pytest.mark.slow
def test_what_verify_refuses_the_page_refuses():
    _, (proof,), document = saved()
    assert float(independent_checker.check(document)) == float(proof.bound)
    mutants = {n: rewritten(document, change(proof)) for n, change in MUTANTS.items()}
    mutants |= {n: rewritten(document, text=text) for n, text in WORSE.items()}
    assert [name for name, mutant in mutants.items() if not refused_by_the_page(mutant)] == []


@pytest.mark.parametrize(
    ("text", "premise"),
    [
        (("rate = [0.0, 3.0]", "rate = [0.0, 2.0]"), "contradicted"),
        (("jump = [0.0, 0.2]\ndwell = 1.0\nfast = [0.0, 0.01]", ""), "proven"),
    ],
)
def test_a_file_that_says_less_of_w_is_refused(text, premise):
    """The premises that are written are those of the text, and its truth keeps them."""
    _, _, document = saved()
    if premise == "contradicted":
        text = (text[0] + WORSE["an unknown rate"][0].removeprefix("rate = [0.0, 3.0]"), text[1])
    signed = document | {"system": document["system"].replace(*text)}
    verdict = verify(signed | {"sha256": digest_of(signed)})
    assert not verdict.verified
    assert "premise" in verdict.reason
    assert verify(rewritten(document, text=text)).verified == (premise == "proven")


def test_without_an_estimate_there_is_no_proof_by_rates():
    _, _, document = saved()
    dob = '[law.observer]\nkind = "dob"\nbandwidth = 6.0\n'
    verdict = verify(rewritten(document, text=(dob, "")))
    assert verdict.reason == "the proof uses rates where there are none"


# Attacks on random loops ------------------------------------------------------------------------


def attacked_loops(seed, count):
    """Bound over attack of random loops with estimates, whose rates count."""
    rng, ratios = np.random.default_rng(seed), []
    while len(ratios) < count:
        system, amplitude, frequency = random_drive(rng)
        system = with_estimates(system, rng)
        if system is None:
            continue
        system = with_random_rates(system, rng)
        found, _ = certify_implemented(system)
        if not found.exists or not found.slow:
            continue
        ratios.append(found.bound / worst_slow_error(system, amplitude, frequency))
        assert ratios[-1] >= 1, (seed, system)
    return ratios


@pytest.mark.parametrize(
    ("values", "most", "believed"),
    [
        ({"rate": [0, 0.5]}, 1.01, lambda b: replace(b, rate=b.rate * 4 / 5)),
        ({"rate": [0, 0.1], "fast": [0, 0.2]}, 1.01, lambda b: replace(b, fast=b.fast * 4 / 5)),
        (
            {"rate": [0, 0], "jump": [0, 0.5], "dwell": 2.0},
            1.06,
            lambda b: replace(b, jump=b.jump * 4 / 5),
        ),
        (
            {"rate": [0, 0], "jump": [0, 0.5], "dwell": 0.3},
            1.45,
            lambda b: replace(b, dwell=b.dwell * 4),
        ),
    ],
)
def test_what_is_slow_alone_nearly_reaches_the_bound(values, most, believed, monkeypatch):
    """Without reference and sensors; and a proof that believes less is beaten."""
    system = axis(omega="0", **values).replace(reference=certrack.SymbolicReference("0"))
    system = on_drive(system, measurement_quantum=None)
    reached, right = worst_slow_error(system, 0.0, 1.0), drive_module._slow_bound
    found, _ = certify_implemented(system)
    assert reached <= found.bound <= most * reached
    monkeypatch.setattr(drive_module, "_slow_bound", lambda *args: believed(right(*args)))
    assert certify_implemented(system)[0].bound < reached


def test_no_attack_beats_the_bound_of_random_slow_loops():
    attacked_loops(1, 2)


@pytest.mark.slow
@pytest.mark.search
def test_no_attack_beats_the_bound_of_many_random_slow_loops():
    """Where rates of the states count, sensors' errors loosen it: they count as motion."""
    ratios = [ratio for seed in range(100, depth(102, 112)) for ratio in attacked_loops(seed, 12)]
    assert np.median(ratios) <= 1.25


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
        ("0.3*min(sin(t), 0.5)", {"rate": [0, 0.3]}, "proven"),
        ("0.3*sin(t)/(1 + t**2)", {"rate": [0, 0.4]}, "checked"),
        ("0.3*atan(tan(t))", {"rate": [0, 0.3]}, "assumed"),
        ("0.3*abs(sin(t))/sin(t)", {"rate": [0, 0.3]}, "assumed"),
        ("0.3*tanh(1/t)", {"rate": [0, 1]}, "assumed"),
        ("0.2*atan2(sin(t), cos(t))", {"rate": [0, 0.2]}, "assumed"),
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


def attack():
    drive = certrack.falsify(axis(omega="0.1*sin(3*t)", rate=[0, 0.3]), budget=20).drive
    assert drive.certificate.verified
    return drive


attacked = cache(attack)


def test_attacks_keep_to_the_rates_and_stay_below():
    drive = attacked()
    assert drive.estimate <= drive.certificate.bound <= 1.3 * drive.estimate
    assert not drive.exceeds
    assert certrack.simulate(drive.system).outcome.name == "finished"
    t, values = over_time(drive.system.truth.omega[1], drive.system.settings.duration)
    assert np.abs(np.diff(values)).max() <= 0.3 * t[1] * (1 + 1e-6)
    assert np.abs(values).max() <= 1


def test_a_rate_too_small_is_caught(monkeypatch):
    """A proof that takes a tenth of the rate has a bound that the falsifier exceeds."""
    right = attacked()
    assert not right.exceeds
    believed = drive_module._slow_bound

    def too_slow(*args):
        bound = believed(*args)
        return bound and replace(bound, rate=bound.rate / 10)

    monkeypatch.setattr(drive_module, "_slow_bound", too_slow)
    wrong = attack()
    assert wrong.certificate.bound < right.certificate.bound
    assert wrong.exceeds
