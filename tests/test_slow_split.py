"""Sensors' errors apart from what is slow: the split loop, its proofs, and attacks on its parts."""

import math
import re
from dataclasses import replace
from functools import cache

import flint
import numpy as np
import pytest
from sampled_attack import STEPS, SampledLoop
from slow_attack import fed_back, worst_slow_error
from test_slow import axis, less, on_drive, refused_by_the_page, rewritten

import certrack
import certrack.certificates.implemented.step_search as step_search
import certrack.certificates.implemented.superposition as superposition
from certrack.certificates import to_document, verify
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import _bounds, cells_of
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.linear.search import NothingTried, continuous_case, sampled_case

NOISE, SLOPE = 5e-3, 0.3


def noisy_axis(slopes=(0.0, SLOPE), **values):
    """An axis whose w changes with the speed, which noisy sensors drive."""
    values = {"beta": [0, 0.2], "rate": [0, 0.1], "Delta_rate": [[0, 0], list(slopes)]} | values
    system = axis(omega="0.1*sin(t)", **values)
    return on_drive(system, noise_bound=[NOISE, NOISE])


@cache
def saved():
    system = noisy_axis(fast=[0, 0.01])
    found, proofs = certify_implemented(system)
    return system, found, proofs, to_document(system, *proofs)


def without_rates(plant):
    return replace(plant, uncertainty=replace(plant.uncertainty, rate=None, Delta_rate=None))


def split_of(system):
    """The bounds of both parts, whether they make anything smaller or not."""
    _, (proof,) = certify_implemented(system.replace(plant=without_rates(system.plant)))
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive_of(system), cells_of(drive_of(system)))
        bounds = _bounds(period, proof.doublings)
        X = [flint.arb(float(v)) for v in proof.states]
        return superposition.search_split(bounds, X, flint.arb(float(proof.input)))


def with_the_whole_alone(monkeypatch, system):
    monkeypatch.setattr(step_search, "search_split", lambda *args: ())
    found, (proof,) = certify_implemented(system)
    assert not proof.split
    return found.bound


# The bound --------------------------------------------------------------------------------------


def test_split_is_smaller_and_verified(monkeypatch):
    system, found, (proof,), document = saved()
    assert [len(part) for part in proof.split] == [3, 3]
    verdict = verify(document)
    assert verdict.verified, verdict.reason
    assert found.bound < 0.95 * with_the_whole_alone(monkeypatch, system)
    (premise,) = (p for p in premises_as_implemented(system, [proof]) if "rate" in p.name)
    assert "is a function of t and x, without hysteresis" in premise.detail


@pytest.mark.parametrize(
    "values",
    [
        {"slopes": (0.0, 0.0)},
        {"jump": [0, 0.1], "dwell": 1.0},
        pytest.param({"beta": [0, 0], "bound": ["", "1 + 0.01*x2**2"]}, marks=pytest.mark.slow),
    ],
)
def test_where_nothing_is_split(values):
    """Without rates of states, with jumps, and with formulas that may grow too fast."""
    system = noisy_axis(**values)
    _, (proof,) = certify_implemented(system)
    assert not proof.split
    assert not any("function" in p.detail for p in premises_as_implemented(system, [proof]))


SLOPES = [
    (0.0, 4.0),
    *(pytest.param(s, marks=pytest.mark.slow) for s in [(3, 0), (0, -4), (-2, 3)]),
]


@pytest.mark.parametrize("slopes", SLOPES)
def test_parts_of_a_linear_function_are_within_their_bounds(slopes):
    """w = d x: x_f is the loop with d x fed back, and the worst of it nearly the bound."""
    system = noisy_axis(np.abs(slopes).tolist(), beta=[0, 2])
    split = split_of(system)
    loop = fed_back(SampledLoop(system), np.array([slopes]))
    periods, reached = int(math.log(1e-5) / math.log(loop.radius)), np.zeros(3)
    for output in range(3):
        row = np.eye(len(loop.jump))[loop.newest if output == 2 else output]
        for place in range(0 if output < 2 else STEPS, STEPS + 1, 5):
            signs = loop.signs(row, place, periods)
            chi = np.zeros(len(row))
            for of_w, of_noise, of_step in signs:
                chi = loop.jump @ chi + loop.noise @ (loop.mu * of_noise)
                chi[loop.newest] += loop.eta * of_step
                for step, _ in zip(loop.steps, of_w, strict=False):
                    chi = step @ chi
            reached[output] = max(reached[output], abs(row @ chi))
    claimed = np.array([float(v) for v in split[1]])
    assert (reached <= claimed).all()
    assert (reached[:2] > 0.5 * claimed[:2]).all()


def test_no_attack_with_feedback_beats_the_bound():
    system = noisy_axis()
    found, (proof,) = certify_implemented(system)
    assert proof.split
    for slopes in ((0.0, SLOPE), (0.0, -SLOPE)):
        reached = worst_slow_error(system, 0.1, 1.0, feedback=np.array([slopes]), within=0.5)
        assert 0.5 * found.bound < reached <= found.bound


# Saved proofs -----------------------------------------------------------------------------------


def part(k, change):
    """The proof with another part: 0 is the slow one, 1 the fast one."""

    def changed(proof):
        parts = list(proof.split)
        parts[k] = tuple(change(list(parts[k])))
        return replace(proof, split=tuple(parts))

    return changed


def entry(i, factor):
    return lambda v: [*v[:i], less(v[i], factor), *v[i + 1 :]]


#: Splits that prove nothing, or not this bound.
MUTANTS = {
    **{f"slow {i}": part(0, entry(i, 0.99)) for i in range(3)},
    **{f"fast {i}": part(1, entry(i, 0.99)) for i in range(3)},
    "slow is negative": part(0, lambda v: [less(t, -1) for t in v]),
    "fast is negative": part(1, lambda v: [less(t, -1) for t in v]),
    "fast is zero": part(1, lambda v: ["0"] * len(v)),
    "slow is the fast one": lambda p: replace(p, split=(p.split[1], p.split[1])),
    "turned": lambda p: replace(p, split=p.split[::-1]),
    "one part": lambda p: replace(p, split=p.split[:1]),
    "three parts": lambda p: replace(p, split=(*p.split, p.split[0])),
    "a part too short": part(1, lambda v: v[:-1]),
    "fast is larger": part(1, lambda v: [less(t, 30) for t in v]),
    "no split": lambda p: replace(p, split=()),
    "no z": lambda p: replace(p, slow=()),
    "bound": lambda p: replace(p, bound=less(p.bound)),
}

#: Systems for which the bound is claimed as well, and is none.
WORSE = {
    "a higher rate": ("rate = [0.0, 0.1]", "rate = [0.0, 0.101]"),
    "a steeper function": ("[0.0, 0.3]", "[0.0, 0.31]"),
    "a function of more": ("[0.0, 0.3]", "[0.1, 0.3]"),
    "a function of less": ("[0.0, 0.3]", "[0.0, 0.0]"),
    "a larger fast part": ("fast = [0.0, 0.01]", "fast = [0.0, 0.011]"),
    "jumps": ("fast = [0.0, 0.01]", "fast = [0.0, 0.01]\njump = [0.0, 1e-9]\ndwell = 9.0"),
    "more noise": ("noise_bound = [0.005, 0.005]", "noise_bound = [0.00501, 0.005]"),
    "a larger w": ("beta = [0.0, 0.2]", "beta = [0.0, 0.201]"),
    "jitter": ("delay = 0.5", "delay = 0.5\njitter = 0.001"),
}


#: Those that every run tries; the others are slow together.
SOON = {"slow 1", "fast 1", "fast is zero", "turned", "no split", "more noise", "jumps", "jitter"}
SOON |= {"a part too short", "a steeper function"}


def names(changes):
    return [pytest.param(n, marks=() if n in SOON else pytest.mark.slow) for n in changes]


@pytest.mark.parametrize("name", names(MUTANTS))
def test_changed_splits_are_refused(name):
    _, _, (proof,), document = saved()
    verdict = verify(rewritten(document, MUTANTS[name](proof)))
    assert not verdict.verified
    assert re.search("bound|split|parts|z ", verdict.reason), verdict.reason


@pytest.mark.parametrize("name", names(WORSE))
def test_a_split_of_less_is_refused(name):
    _, _, _, document = saved()
    before, after = WORSE[name]
    verdict = verify(rewritten(document, text=(before, after)))
    assert not verdict.verified
    assert "premise" not in verdict.reason, verdict.reason


@pytest.mark.slow
def test_what_verify_refuses_of_a_split_the_page_refuses():
    import independent_checker

    _, _, (proof,), document = saved()
    assert float(independent_checker.check(document)) == float(proof.bound)
    mutants = {n: rewritten(document, MUTANTS[n](proof)) for n in MUTANTS if n in SOON}
    mutants |= {n: rewritten(document, text=WORSE[n]) for n in WORSE if n in SOON}
    assert [name for name, mutant in mutants.items() if not refused_by_the_page(mutant)] == []


#: Beside a split w_2: terms whose rate is not known, slow ones, ones that jump, and another split.
BESIDE = {
    "unknown": {"rate": [math.inf, 0.1], "fast": [0, 0.01], "Delta_rate": [[0, 0], [0, SLOPE]]},
    "slow": {"rate": [0.05, 0.1], "fast": [0.01, 0.01], "Delta_rate": [[0, 0], [0, SLOPE]]},
    "jumps": {
        "rate": [0.05, 0.1],
        "Delta_rate": [[0.1, 0.1], [0, SLOPE]],
        "jump": [0.05, 0],
        "dwell": 1.0,
        "fast": [0.01, 0],
    },
    "split": {"rate": [0.05, 0.1], "fast": [0, 0.01], "Delta_rate": [[0.2, 0.1], [0, SLOPE]]},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BESIDE)
def test_the_page_agrees_on_terms_of_every_kind_beside_each_other(name):
    import independent_checker

    common = {"tau": [1, 1], "beta": [0.05, 0.2], "gamma": [0.02, 0.05]}
    system = noisy_axis(**(common | BESIDE[name]))
    _, (proof,) = certify_implemented(system)
    assert proof.split
    document = to_document(system, proof)
    assert verify(document).verified
    assert float(independent_checker.check(document)) == float(proof.bound)
    for k, i in ((0, 0), (0, 2), (1, 1)):
        changed = rewritten(document, part(k, entry(i, 0.999))(proof))
        assert not verify(changed).verified and refused_by_the_page(changed), (k, i)


def test_what_is_below_its_bound_is_said_of_the_fast_part():
    system, _, (proof,), _ = saved()
    (premise,) = (p for p in premises_as_implemented(system, [proof]) if "rate" in p.name)
    end = "and a part of at most 0.01 of any speed, without which w_2 stays so much below its bound"
    assert end in premise.detail


def test_a_split_that_believes_too_little_is_seen(monkeypatch):
    """Without what w does to x_f the bounds of x_f are below what it reaches."""
    believed = superposition.SplitLoop.of_fast

    def without(loop, slow, v):
        return believed(loop, slow, [0 * entry for entry in v])

    monkeypatch.setattr(superposition.SplitLoop, "of_fast", without)
    with pytest.raises(AssertionError):
        test_parts_of_a_linear_function_are_within_their_bounds((0.0, 4.0))


def test_the_file_is_text():
    system = noisy_axis(fast=[0, 0.01])
    assert certrack.loads(certrack.to_text(system)) == system


# Attacks of falsify on an integral ----------------------------------------------------------------


@pytest.mark.parametrize("rate", [None, [0, 0.3]])
def test_an_integral_is_attacked_as_sampled(rate):
    """The run of the case reaches what the linear loop says, below the certificate."""
    system = axis(False, omega="0.1*sin(3*t)", rate=rate)
    system = system.replace(law=replace(system.law, integral=4.0))
    system = on_drive(system, measurement_quantum=None)
    bounds = tuple(reference_bounds(system, system.controller.coordinates.q + 1))
    case = sampled_case(system, bounds)
    bound = certify_implemented(system)[0].bound
    assert 0.9 * bound < case.estimate < bound
    assert case.error == pytest.approx(case.estimate, rel=0.02)
    with pytest.raises(NothingTried, match=r"law.integral is attacked as sampled only"):
        continuous_case(system.replace(implementation=None), bounds)
