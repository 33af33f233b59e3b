"""Gradients of certificates against differences of fourth order, on random plants n = 1 ... 6.

The values that are differenced are solved for to ten digits, as the gradients are.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from test_tuning import GRADIENT, agree, candidate_of, random_system

import certrack
from certrack.certificates.arithmetic import decimal, rational
from certrack.certificates.centred import CentredProblems
from certrack.certificates.estimates.cascade import cascade_estimate, centred_cascade_estimate
from certrack.certificates.estimates.centred_stage import CentredStage, ReachedSet
from certrack.certificates.estimates.dual import semidefinite_estimate
from certrack.certificates.estimates.last_digits import matrices
from certrack.certificates.estimates.loop_data import PlainLoop
from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.estimates.riccati import riccati_estimate
from certrack.certificates.formulation import error_problem
from certrack.certificates.semidefinite import SemidefiniteProgram, fastest_rate
from certrack.tuning import ranged as ranged_room
from certrack.tuning.candidate import DIFFERENCE, Candidate
from certrack.tuning.implemented import IMPLEMENTED_DIFFERENCE, ImplementedError
from certrack.tuning.quantities import SemidefiniteError
from certrack.tuning.ranged import RangedError
from certrack.tuning.registry import tuning_family

#: Decay rates of the programs, as parts of the fastest.
SHARE, HEAD_SHARE = 0.35, 0.3

#: Steps in logarithms of rates, and in parts of K, which poles answer more to: with 2e-4
#: differences err by up to 3 %.
STEPS = {"robust": 2e-3, "adaptive": 2e-3, "linear": 2e-5}

#: First step of the quadrature of peak gains, s; as a part of the fastest time constant it moves
#: with the gains, and the bound by up to 1e-4 of its own slope.
QUADRATURE_STEP = 2e-3

#: Of the implemented loop, whose kinks lie close to each other.
IMPLEMENTED_STEP = 2e-6

#: Orders of the plants; the large ones take seconds each.
ORDERS = [1, 2, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (4, 5, 6))]


def differences(value, v, step=2e-3):
    """Central ones, right to the fourth power of the step."""
    slopes = []
    for unit in step * np.eye(len(v)):
        near, far = (value(v + m * unit) - value(v - m * unit) for m in (1, 2))
        slopes.append((8 * near - far) / (12 * step))
    return np.array(slopes)


def problems(kind, n, seed):
    """The problem of a random plant as a function of the tuned numbers, and where they begin."""
    if kind == "adaptive":
        point = candidate_of(random_system(seed, n, kind))
        quantity = SemidefiniteError(point.base)

        def adaptive(v):
            return quantity.problem(Candidate(point.family, point.base, np.append(v, 0.0)))

        return adaptive, point.v[:-1]
    system = random_system(seed, n)
    family = tuning_family(system, kind, system.law.feedforward)
    base = system.replace(law=family.law(family.start))
    loop = PlainLoop.of(base)
    return lambda v: loop.with_design(Candidate(family, base, v).design), family.start


def beside(problem, v):
    units = DIFFERENCE * np.eye(len(v))
    return [(problem(v + unit), problem(v - unit)) for unit in units]


@pytest.mark.parametrize("kind", ["robust", "linear", "adaptive"])
@pytest.mark.parametrize("n", ORDERS)
def test_semidefinite_program(n, kind):
    check_semidefinite_program(*problems(kind, n, 2), SHARE, STEPS[kind])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["robust", "linear", "adaptive"])
@pytest.mark.parametrize("seed", [3, 7])
def test_semidefinite_program_of_other_plants(seed, kind):
    check_semidefinite_program(*problems(kind, 5, seed), 0.2, STEPS[kind])


def check_semidefinite_program(problem, v, share, step):
    def log_bound(v, share=share):
        return math.log(semidefinite_estimate(problem(v), share).bound)

    found = semidefinite_estimate(problem(v), share, beside(problem, v), DIFFERENCE)
    solver = SemidefiniteProgram(problem(v)).solve(share * fastest_rate(problem(v)))
    assert found.bound == pytest.approx(solver.bound, rel=1e-7 if problem(v).n < 4 else 1e-4)
    assert agree(found.log_gradient, differences(log_bound, v, step))
    (by_share,) = differences(lambda s: log_bound(v, math.exp(s[0])), np.log([share]))
    assert found.by_log_share == pytest.approx(by_share, abs=1e-6)


@pytest.mark.parametrize("n", ORDERS[1:])
def test_cascade(n):
    problem, v = problems("adaptive", n, 2)
    shares = SHARE, HEAD_SHARE

    def log_bound(v, shares=shares):
        return math.log(cascade_estimate(problem(v), shares).bound)

    found = cascade_estimate(problem(v), shares, beside(problem, v), DIFFERENCE)
    assert agree(found.log_gradient, differences(log_bound, v))
    by_shares = differences(lambda s: log_bound(v, tuple(np.exp(s))), np.log(shares))
    np.testing.assert_allclose(found.by_log_shares, by_shares, atol=1e-6)


def centred_designs(n, seed=2):
    """The centred stage of a random plant, its designs as a function, and where they begin."""
    point = candidate_of(random_system(seed, n, "adaptive"))
    quantity = SemidefiniteError(point.base)

    def design(v):
        candidate = Candidate(point.family, point.base, np.append(v, 0.0))
        return quantity.problem(candidate), candidate.design

    return CentredStage.of(point.base), design, point.v[:-1]


CENTRED = [
    pytest.param(n, shift, marks=[pytest.mark.slow] * (n > 3))
    for n in (2, 3, 4, 6)
    for shift in (0.03, -0.02)
]


@pytest.mark.parametrize(("n", "shift"), CENTRED)
def test_cascade_with_a_centred_stage(n, shift):
    """For n = 3 and more the first program has many optimal P, of which the largest counts."""
    check_centred_cascade(n, 2, shift)


@pytest.mark.slow
@pytest.mark.parametrize("shift", [0.03, -0.02])
@pytest.mark.parametrize("seed", [4, 5])
def test_cascade_with_a_centred_stage_of_other_plants(seed, shift):
    """Where a reward in the program's units would outweigh the cost, or cost 1 % of the bound."""
    check_centred_cascade(6, seed, shift)


def test_points_with_last_digits_stay_in_the_cones():
    """Many P are optimal here: Newton's method went to ones with eigenvalues of -1 among them."""
    stage, design, v = centred_designs(6)
    rng = np.random.default_rng(0)
    for _ in range(5):
        problem, coordinates = design(v + 1e-10 * rng.standard_normal(len(v)))
        first = ReachedSet.of((problem, SHARE * fastest_rate(problem)))
        centred = stage.problems((problem, coordinates), first.P, first.bound).at(-0.02)
        best = semidefinite_estimate(centred, HEAD_SHARE, target=5)
        _, matrix, right = best.program.numbers(best.alpha)
        slack = right - matrix @ best.point.x
        sizes = centred.n + sum(centred.counts), centred.n
        ends = np.cumsum([size * (size + 1) // 2 for size in sizes])
        parts = np.split(slack, ends)
        for part, size in zip(parts[:2], sizes, strict=True):
            values = np.linalg.eigvalsh(matrices(part[:, None], size)[0])
            assert values[0] >= -1e-9 * values[-1]
        assert parts[2].min() >= -1e-9


def check_centred_cascade(n, seed, shift):
    stage, design, v = centred_designs(n, seed)
    shares = SHARE, HEAD_SHARE, HEAD_SHARE

    def log_bound(v, shares=shares, shift=shift):
        return math.log(centred_cascade_estimate(stage, design(v), shares, shift).bound)

    pairs = beside(design, v)
    found = centred_cascade_estimate(stage, design(v), shares, shift, pairs, DIFFERENCE)
    expected = differences(log_bound, v)
    accuracy = 1e-5 if n < 4 else GRADIENT
    assert np.abs(found.log_gradient - expected).max() < accuracy * np.abs(expected).max()
    # The fourth plant has another active set two steps of 2e-3 away.
    step, tolerance = (2e-3, 2e-6) if n < 4 else (5e-4, 1e-5)
    by_shares = differences(lambda s: log_bound(v, tuple(np.exp(s))), np.log(shares), step)
    np.testing.assert_allclose(found.by_log_shares, by_shares, atol=tolerance)
    sign = math.copysign(1, shift)
    (by_shift,) = differences(
        lambda s: log_bound(v, shares, sign * math.exp(s[0])), np.log([abs(shift)]), step
    )
    assert found.by_log_shift == pytest.approx(by_shift, abs=tolerance)


def test_centred_problems_are_those_of_the_certificate():
    """Of the set that the cascade of Example 1 has proven, with its kappa and alpha."""
    system = certrack.load("example1")
    exact = error_problem(system, rational)
    reached, proof, _ = certrack.certify(system, "fast").cascade_proof
    expected = CentredProblems.of(system, exact, reached).in_floats()
    design = error_problem(system, decimal), system.controller.coordinates
    P = np.array([[float(v) for v in row] for row in reached.P])
    found = CentredStage.of(system).problems(design, P, float(reached.bound))
    assert found.remainder == pytest.approx(expected.remainder, rel=1e-9)
    for name in ("row", "columns", "residual", "Xy"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    problem = found.at(float(proof.shift))
    share = float(proof.alpha) / fastest_rate(problem)
    bound = semidefinite_estimate(problem, share, target=problem.n - 1).bound
    assert bound == pytest.approx(float(proof.bound), rel=1e-6)


def test_the_largest_set_costs_next_to_nothing_and_is_no_larger():
    """e^T P e <= E^2: a larger P has a smaller set, and E is that of the best P to 1e-7."""
    _, design, v = centred_designs(3)
    problem = design(v)[0]
    best = semidefinite_estimate(problem, SHARE, target=2)
    largest = ReachedSet.of((problem, best.alpha))
    P = best.program.solution(best.point, best.alpha).P
    assert best.bound * (1 - 1e-9) <= largest.bound <= best.bound * (1 + 1e-7)
    assert np.trace(largest.P[:2, :2]) > 1.01 * np.trace(P[:2, :2])


@pytest.mark.parametrize("kind", ["robust", "linear"])
@pytest.mark.parametrize("n", range(1, 7))
def test_peak_gains(n, kind):
    """With the quadrature's first step held fixed, as the gradient has it."""
    system = random_system(2, n)
    family = tuning_family(system, kind, system.law.feedforward)
    base = system.replace(law=family.law(family.start))
    loop, v = PlainLoop.of(base), family.start

    def estimate(v, gradient=False):
        design = Candidate(family, base, v).design
        return peak_estimate(loop.with_design(design), gradient=gradient, step=QUADRATURE_STEP)

    found = estimate(v, gradient=True)
    pairs = Candidate(family, base, v).neighbours
    changes = [
        found.gradient.along(*(loop.with_design(point.design) for point in pair)) for pair in pairs
    ]
    gradient = np.array(changes) / (2 * DIFFERENCE * found.bound)
    expected = differences(lambda v: math.log(estimate(v).bound), v, STEPS[kind] / 10)
    assert agree(gradient, expected)


@pytest.mark.parametrize("kind", ["robust", "linear"])
@pytest.mark.parametrize("n", ORDERS)
def test_worst_corner_of_ranges(monkeypatch, n, kind):
    held = partial(peak_estimate, step=QUADRATURE_STEP)
    monkeypatch.setattr(ranged_room, "peak_estimate", held)
    system = random_system(2, n)
    ranges = {"input_gain_range": (1.2, 1.4), "theta_range": ((0.35, 0.45),)}
    system = system.replace(plant=replace(system.plant, **ranges))
    family = tuning_family(system, kind, system.law.feedforward)
    base = system.replace(law=family.law(family.start))
    error, v = RangedError(base), family.start

    def log_bound(v):
        return math.log(error.value(Candidate(family, base, v)))

    gradient = error.log_gradient(Candidate(family, base, v))
    assert agree(gradient, differences(log_bound, v, STEPS[kind] / 10))


@pytest.mark.parametrize("kind", ["robust", "linear"])
@pytest.mark.parametrize("n", ORDERS)
def test_loop_as_implemented(n, kind):
    """The fixed point is differentiated; differences search it each time, to 1e-8."""
    system = random_system(2, n)
    family = tuning_family(system, kind, system.law.feedforward)
    base = system.replace(law=family.law(family.start))
    drive = certrack.Implementation(period=0.01, delay=0.5, measurement_quantum=[1e-4] * n)
    error = ImplementedError(drive)

    def estimate(v):
        return error.estimate(Candidate(family, base, v))

    v, step = family.start, IMPLEMENTED_STEP
    gradient = error.log_gradient(Candidate(family, base, v))
    assert agree(gradient, differences(lambda v: math.log(estimate(v).bound), v, step))
    pairs = error.nearby(Candidate(family, base, v))
    peaks = np.array([above.peak_input - below.peak_input for above, below in pairs])
    expected = differences(lambda v: estimate(v).peak_input, v, step)
    assert agree(peaks / (2 * IMPLEMENTED_DIFFERENCE), expected)


@pytest.mark.parametrize("kind", ["robust", "linear"])
@pytest.mark.parametrize("n", range(1, 7))
def test_dual_and_riccati_equation_tell_the_same(n, kind):
    """Two ways to one bound: at the best decay rate, values and gradients are equal.

    The equation's descent ends 1e-10 above the lowest; its gradient errs by the root of that, times
    a condition that is larger in K than in rates.
    """
    problem, v = problems(kind, n, 3)
    pairs, here = beside(problem, v), problem(v)
    riccati = riccati_estimate(here)
    slopes = np.array([riccati.gradient.along(*pair) for pair in pairs])
    share = riccati.alpha / fastest_rate(here)
    found = semidefinite_estimate(here, share, pairs, DIFFERENCE)
    assert found.bound == pytest.approx(riccati.bound, rel=1e-8)
    assert found.by_log_share == pytest.approx(0, abs=2e-5)
    expected = slopes / (2 * DIFFERENCE * riccati.bound)
    error = np.abs(found.log_gradient - expected).max() / np.abs(expected).max()
    assert error < (GRADIENT if kind == "robust" else 5 * GRADIENT)


def test_the_solver_s_first_point_is_too_far_off():
    """Why a program is solved again about its solution: here, it costs 6 % more than the least."""
    problem, v = problems("robust", 6, 3)
    here = problem(v)
    riccati = riccati_estimate(here)
    first = SemidefiniteProgram(here).solve(riccati.alpha)
    again = semidefinite_estimate(here, riccati.alpha / fastest_rate(here))
    assert again.bound == pytest.approx(riccati.bound, rel=1e-8)
    assert first is None or first.bound > riccati.bound * (1 + 1e-7)
