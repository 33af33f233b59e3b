"""Bounds in floats: against what is proven, and their gradients against differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_tuning import agree, random_system

import certrack
from certrack.certificates import semidefinite
from certrack.certificates.arithmetic import decimal
from certrack.certificates.estimates import known_stage
from certrack.certificates.estimates.loop_data import PlainLoop
from certrack.certificates.estimates.riccati import riccati_estimate
from certrack.certificates.formulation import error_problem
from certrack.certificates.scaling import Scaling
from certrack.certificates.search import riccati as search
from certrack.certificates.search.riccati_equation import RiccatiEquation
from certrack.certificates.semidefinite import SemidefiniteProgram, best_solution
from certrack.certificates.symmetric import svec


@pytest.mark.parametrize("n", range(1, 7))
def test_riccati_equation_gives_the_program_s_bound(n):
    problem = PlainLoop.of(random_system(6, n)).problem
    found = riccati_estimate(problem)
    bound = best_solution(SemidefiniteProgram(problem)).bound
    assert found.bound == pytest.approx(bound, rel=1e-3)
    assert found.bound <= bound * (1 + 1e-5)  # the program's alpha is only searched to 2e-3


@pytest.mark.parametrize("n", range(1, 7))
def test_the_riccati_equation_solves_the_program(n):
    """Its P and multipliers keep every condition, and no program does better at that rate."""
    problem = PlainLoop.of(random_system(8, n)).problem
    found = riccati_estimate(problem)
    s = found.solution
    assert s.bound == pytest.approx(found.bound, rel=1e-6) and s.alpha == found.alpha
    assert min(*s.lam, *s.nu, *s.k, math.inf) > 0
    scaling = Scaling.of(problem)
    sizes = np.concatenate([scaling.sizes, np.ones(sum(problem.counts))])
    Q = problem.inequality(s.P, s.lam, s.nu, s.k, s.alpha)
    Q, P = Q * np.outer(sizes, sizes), s.P * np.outer(scaling.sizes, scaling.sizes)
    assert np.linalg.eigvalsh(Q).max() < 1e-7 * np.abs(np.linalg.eigvalsh(Q)).max()
    largest = np.linalg.eigvalsh(P).max()
    P[0, 0] -= scaling.sizes[0] ** 2
    assert np.linalg.eigvalsh(P).min() > -1e-7 * largest
    program = SemidefiniteProgram(problem).solve(found.alpha)
    assert program is None or s.bound <= program.bound * (1 + 2e-6)


def test_a_warm_start_without_a_solution_gives_way_to_a_cold_one():
    """A pole at half of what it was."""
    chain = certrack.System(
        plant=certrack.Plant(
            states=["x1", "x2", "x3", "x4"],
            chain=[1, 1, 1],
            gain_sign=1,
            input_gain=2,
            uncertainty=certrack.Uncertainty([0, 0, 0, 1], [0, 0, 0, 1e-5], [0, 0, 0, 0.1]),
        ),
        law=certrack.Robust(c=(3, 3, 3, 3), feedforward=1),
        reference=certrack.SymbolicReference("0.2*cos(t)"),
        truth=certrack.Truth(2),
        settings=certrack.Settings([0.5, 0, 0, 0], 20),
    )
    state = riccati_estimate(error_problem(chain, decimal)).state
    slower = error_problem(chain.replace(law=replace(chain.law, c=(1.5, 3, 3, 3))), decimal)
    scaled = state.scaling.applied(slower)
    assert RiccatiEquation(scaled).at(state.logarithms) is None
    assert riccati_estimate(slower, state).bound == riccati_estimate(slower).bound


def test_an_input_that_moves_no_error_takes_no_estimate_away():
    """There X is singular; the peak bound and the tube from |e_1(0)| are left."""
    plant = certrack.Plant(
        states=["x", "v"],
        chain=[1],
        linear=[[-1.0]],
        gain_sign=1,
        input_gain=1.3,
        uncertainty=certrack.Uncertainty([1e-3, 0], [0, 0], [1e-2, 0]),
    )
    system = certrack.System(
        plant=plant,
        law=certrack.Linear(K=(0, -2), feedforward=1),
        reference=certrack.SymbolicReference("0"),
        truth=certrack.Truth(1.3),
        settings=certrack.Settings([0.7, 0.1], 5),
    )
    found = certrack.estimate(system)
    assert found.bound == pytest.approx(1e-5, rel=1e-3)
    assert found.tube is None or found.tube(0.0) >= 0.7


def test_a_solution_that_is_rounding_is_none(monkeypatch):
    """Where X_tt is nothing beside the rest of X, its digits are those of the rest."""
    plant = certrack.Plant(
        states=["x1", "x2", "x3", "x4"],
        chain=[8.641, 1.362, 0.8],
        linear=[[-0.004], [-0.315, 0.032], [0.32, 0.093, 0.414]],
        drift="-0.3*x1",
        regressor=["x1"],
        gain_sign=1,
        input_gain=1.3,
        theta=[0.4],
        uncertainty=certrack.Uncertainty([1] * 4, [0.00264] * 3 + [0], [0, 0.005853, 0, 0.3532]),
    )
    law = certrack.Robust(
        c=(0.1371523, 76.95078, 7.176153, 5.141961),
        k=(
            (121.3965, 28.19543),
            (18.8016, 706.6972, 13.81303, 7.489845),
            (261.1354, 982.3907, 35.00695, 5.58451, 6.096720, 257.5622),
            (600.3604, 8.670972, 7.697233, 322.9064, 5.671097, 1.051914, 32.51954, 33.55282),
        ),
        p=(18.20473, 872.5557, 76.93490),
    )
    system = certrack.System(
        plant=plant,
        law=law,
        reference=certrack.SymbolicReference("0.2*sin(t)+0.1*cos(2*t)"),
        truth=certrack.Truth(1.3, theta=[0.4]),
        settings=certrack.Settings([0, 0, 0, 0], 5),
    )
    proven = certrack.certify(system, effort="fast").best.bound
    assert certrack.estimate(system).bound == pytest.approx(proven, rel=1e-3)
    monkeypatch.setattr(search, "LEAST_DIAGONAL", 0.0)
    assert certrack.estimate(system).bound < 0.1 * proven


def test_the_tube_of_an_estimate_begins_where_that_of_the_proof_does():
    for seed in range(6):
        system = random_system(seed, 3)
        tube, proof = certrack.estimate(system).tube, certrack.certify(system, effort="fast").tube
        assert tube.start == pytest.approx(math.sqrt(float(proof.start)), rel=0.02)


@pytest.mark.parametrize("n", range(1, 7))
def test_riccati_gradient(n):
    """In K and in the column of y^(q+1), each difference of two optima that are found anew."""
    loop = PlainLoop.of(random_system(7, n))
    K = loop.problem.M[-1]
    r = -loop.problem.Uy[-1, -1] / loop.last_bound if loop.last_bound else 0.0
    found = riccati_estimate(loop.problem)
    gradient = np.append(found.gradient.M[-1], -found.gradient.Uy[-1, -1] * loop.last_bound)
    point = np.append(K, r)
    steps = 1e-3 * np.maximum(np.abs(point), 0.3)
    expected = []
    for i, step in enumerate(steps):
        bounds = []
        for sign in (1, -1):
            moved = point.copy()
            moved[i] += sign * step
            bounds.append(riccati_estimate(loop.with_feedback(moved[:-1], moved[-1])).bound)
        expected.append((bounds[0] - bounds[1]) / (2 * step))
    scale = steps / 1e-3
    assert agree(gradient * scale, np.array(expected) * scale)


def test_a_warm_start_ends_where_a_cold_one_does():
    loop = PlainLoop.of(certrack.load("dual-motor-lean"))
    K, r = loop.problem.M[-1], -loop.problem.Uy[-1, -1] / loop.last_bound
    state = riccati_estimate(loop.problem).state
    rng = np.random.default_rng(0)
    for _ in range(10):
        problem = loop.with_feedback(K * (1 + 0.03 * rng.standard_normal(4)), r)
        warm, cold = riccati_estimate(problem, state), riccati_estimate(problem)
        assert warm.bound == pytest.approx(cold.bound, rel=1e-4)
        state = warm.state


def test_a_loop_that_is_not_covered_has_no_estimate():
    found = certrack.estimate(certrack.load("example1-classic"))
    assert found.bound == math.inf and not found.method and "without leakage" in found.reason
    assert repr(found).startswith("BoundEstimate(none, without leakage")


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("dual-motor-lean", ("peak", "semidefinite")),
        ("example1", ("semidefinite", "cascade")),
        ("dual-motor-drive", ("implemented",)),
        ("axis", ("vertices",)),
    ],
)
def test_estimates_are_what_certify_proves(name, kinds):
    system = certrack.load(name)
    found, proven = certrack.estimate(system), certrack.certify(system, "fast")
    assert set(kinds) <= set(found.bounds)
    assert found.bound == min(found.bounds.values())
    for kind in kinds:
        assert found.bounds[kind] == pytest.approx(getattr(proven, kind).bound, rel=2e-3), kind
    if found.shares:
        assert sum(found.shares.values()) == pytest.approx(found.bound)
    if found.tube is not None and proven.tube_kind == "semidefinite":
        assert found.tube(1.0) == pytest.approx(proven.tube(1.0), rel=1e-2)


def test_the_cascade_is_estimated_with_its_centred_stage_warm_and_cold():
    system = certrack.load("example1")
    warm = certrack.estimate(system)
    assert warm.cascade.centred is not None and warm.cascade.shift
    for factor in (1.02, 1.1, 1.4):
        law = replace(system.law, c=tuple(factor * v for v in system.law.c))
        moved = system.replace(law=law)
        warm = certrack.estimate(moved, warm=warm)
        proven = certrack.certify(moved, "fast").cascade
        assert warm.method == "cascade"
        assert warm.bound == pytest.approx(proven.bound, rel=1e-3)
        assert sum(warm.shares.values()) == pytest.approx(warm.bound)


@pytest.fixture
def solved(monkeypatch):
    """The decay rates of the programs that were solved so far."""
    rates = []
    real = SemidefiniteProgram.point
    monkeypatch.setattr(
        SemidefiniteProgram, "point", lambda self, a: rates.append(a) or real(self, a)
    )
    return rates


def test_a_warm_estimate_of_the_adaptive_law_takes_few_programs(solved):
    system = certrack.load("example1")
    warm = certrack.estimate(system)
    for factor in (1.005, 1.01, 1.015, 1.02):
        law = replace(system.law, c=tuple(factor * v for v in system.law.c))
        moved = system.replace(law=law)
        solved.clear()
        warm = certrack.estimate(moved, warm=warm)
        assert len(solved) <= 14
        cold = certrack.estimate(moved)
        assert warm.bounds == pytest.approx(cold.bounds, rel=2e-6)
        assert warm.cascade.shift == pytest.approx(cold.cascade.shift, rel=0.02)
        assert warm.cascade.problems[0].adaptation.shift == warm.cascade.shift


def test_a_quick_look_follows_a_centred_stage_that_is_worth_it(monkeypatch):
    """One that is not is tried again when the bound of e_n has moved."""
    system = certrack.load("example1")

    def quick(factor, warm):
        law = replace(system.law, c=tuple(factor * v for v in system.law.c))
        moved = system.replace(law=law)
        return certrack.estimate(moved, warm=warm, accuracy=1e-4), certrack.estimate(moved)

    near = certrack.estimate(system)
    stage = near.cascade.stage
    assert stage.shift == near.cascade.shift and stage.without == near.cascade.last.bound
    assert stage.worth == 1 - near.cascade.centred.bound / near.cascade.last.bound
    followed, cold = quick(1.005, near)
    assert followed.cascade.centred is not None
    assert followed.bound == pytest.approx(cold.bound, rel=1e-4)
    monkeypatch.setattr(known_stage, "LEAST_WORTH", 1.0)
    monkeypatch.setattr(known_stage, "TRIED_AGAIN", 1e-3)
    idle, _ = quick(1.005, near)
    assert idle.cascade.centred is None and idle.cascade.stage == stage
    assert idle.bound > followed.bound
    again, cold = quick(1.1, idle)
    assert again.cascade.centred is not None and again.cascade.stage.worth > 0
    assert again.bound == pytest.approx(cold.bound, rel=1e-3)
    other, _ = quick(1.005, replace(near, method="semidefinite"))
    assert other.cascade.centred is None and other.cascade.stage.worth == 0
    exact = certrack.estimate(system, warm=other)
    assert exact.cascade.shift == pytest.approx(near.cascade.shift, rel=0.02)


@pytest.mark.parametrize("gain", ["leak_theta", "leak_gain", "gain_rate"])
def test_a_long_drag_finds_the_centre_that_fits(gain):
    """The best kappa ends at a kink and has shrunk: a look nearby alone would keep the first."""
    system, warm = certrack.load("example1"), None
    for k in range(15):
        law = replace(system.law, **{gain: getattr(system.law, gain) * 0.85**k})
        moved = system.replace(law=law)
        accuracy = {"accuracy": 1e-4} if k > 1 else {}
        warm = certrack.estimate(moved, warm=warm, **accuracy)
    assert warm.bound == pytest.approx(certrack.estimate(moved).bound, rel=0.02)
    rested = certrack.estimate(moved, warm=warm)
    assert rested.bound == pytest.approx(certrack.estimate(moved).bound, rel=2e-3)


@pytest.mark.parametrize("gain", ["leak_theta", "leak_gain", "gain_rate"])
def test_one_far_jump_is_searched_anew(gain):
    system = certrack.load("example1")
    near = certrack.estimate(system)
    law = replace(system.law, **{gain: getattr(system.law, gain) / 10})
    moved = system.replace(law=law)
    cold = certrack.estimate(moved)
    for accuracy in ({}, {"accuracy": 1e-4}):
        found = certrack.estimate(moved, warm=near, **accuracy)
        assert found.bound == pytest.approx(cold.bound, rel=1e-3)


def test_an_estimate_has_no_centred_stage_where_the_proof_has_none():
    """The exact enclosure knows no power of |x2|, which may be zero; floats do."""
    example = certrack.load("example1")
    plant = replace(example.plant, drift="0.1*abs(x2)**1.3")
    system = example.replace(plant=plant)
    near = certrack.estimate(system)
    assert near.cascade.centred is None
    assert near.bound == pytest.approx(certrack.certify(system, "fast").best.bound, rel=1e-3)
    moved = system.replace(law=replace(system.law, c=tuple(1.02 * v for v in system.law.c)))
    assert certrack.estimate(moved, warm=near, accuracy=1e-4).cascade.centred is None


@pytest.mark.parametrize("name", ["example1", "theorem1-counterexample"])
def test_a_program_that_is_aimed_elsewhere_is_the_one_made_for_there(name):
    problem = error_problem(certrack.load(name), decimal)
    first, last = SemidefiniteProgram(problem), SemidefiniteProgram(problem, problem.n - 1)
    aimed, alpha = first.aimed_at(problem.n - 1), 0.1 * first.fastest
    for mine, made in zip(aimed.numbers(alpha), last.numbers(alpha), strict=True):
        assert (mine == made).all()
    mine, made = aimed.solve(alpha), last.solve(alpha)
    assert mine.bound == made.bound != first.solve(alpha).bound
    assert (mine.P == made.P).all() and (aimed.floor[1] == last.floor[1]).all()


def test_the_columns_of_a_program_are_its_inequality():
    """Each variable's column against the inequality with this variable alone, for two alphas."""
    problem = error_problem(certrack.load("example1"), decimal)
    program = SemidefiniteProgram(problem)
    scaled, rng = program.scaling.applied(problem), np.random.default_rng(3)
    for alpha in (0.0, 0.7):
        rate = program.scaling.rate(alpha)
        x = rng.normal(size=len(program.entries) + sum(problem.counts))
        P, (lam, nu, k) = program.parts(x)
        base, slope = program.inequality
        expected = svec(scaled.inequality(P, lam, nu, k, rate))
        assert base @ x + rate * (slope @ x) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_a_program_in_its_own_units_that_fails_is_solved_with_the_solver_s(monkeypatch):
    problem = error_problem(certrack.load("example1"), decimal)
    real, asked = semidefinite._clarabel, []

    def without_luck(*numbers, equilibrate=True):
        asked.append(equilibrate)
        return real(*numbers) if equilibrate else None

    monkeypatch.setattr(semidefinite, "_clarabel", without_luck)
    program = SemidefiniteProgram(problem, 0, Scaling.of(problem).alone())
    alpha = 0.1 * program.fastest
    assert program.solve(alpha).bound == SemidefiniteProgram(problem).solve(alpha).bound
    assert asked == [False, True, True]


def test_a_warm_certificate_is_as_good_and_as_proven():
    system = certrack.load("dual-motor-lean")
    warm = certrack.certify(system, "fast", warm=certrack.estimate(system))
    cold = certrack.certify(system, "fast")
    assert warm.semidefinite.verified
    assert warm.semidefinite.bound == pytest.approx(cold.semidefinite.bound, rel=1e-4)
    nearby = system.replace(law=replace(system.law, c=(5.5, 6, 6.5, 6)))
    moved = certrack.estimate(nearby, warm=certrack.estimate(system))
    assert moved.bound == pytest.approx(certrack.estimate(nearby).bound, rel=1e-6)
    with pytest.raises(certrack.InputError, match="must be what certrack.estimate returned"):
        certrack.estimate(system, warm=3)


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
def test_a_quick_estimate_is_nearly_the_least_and_takes_few_programs(name, solved):
    system = certrack.load(name)
    quick = warm = certrack.estimate(system)
    for k in range(12):
        law = replace(system.law, c=tuple(1.02**k * v for v in system.law.c))
        moved = system.replace(law=law)
        warm = certrack.estimate(moved, warm=warm)
        least, slow = warm.bound, len(solved)
        solved.clear()
        quick = certrack.estimate(moved, warm=quick, accuracy=1e-4)
        assert quick.bound == pytest.approx(least, rel=2e-4)
        assert len(solved) <= 6 and (not solved or len(solved) < slow)
        solved.clear()
    for accuracy in (0, -1, 0.2, math.nan, "x"):
        with pytest.raises(certrack.InputError, match="accuracy"):
            certrack.estimate(system, warm=warm, accuracy=accuracy)
