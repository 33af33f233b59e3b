"""Searches in floats: fast ones against slow ones, and what exact proofs make of wrong results."""

from __future__ import annotations

import math
import pickle
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

import certrack
from certrack.certificates import strength
from certrack.certificates.arithmetic import decimal, rational
from certrack.certificates.cascade import certify_cascade
from certrack.certificates.centred import CentredProblems
from certrack.certificates.exact import BACK_OFF, failed_condition, from_text, prove
from certrack.certificates.formulation import error_problem
from certrack.certificates.methods import certify_semidefinite
from certrack.certificates.search import best_proof as best_proof_module
from certrack.certificates.search.best_proof import best_proof
from certrack.certificates.search.decay_rate import best_by_slope
from certrack.certificates.search.descent import quasi_newton
from certrack.certificates.search.riccati import riccati_optimum
from certrack.certificates.search.riccati_equation import RiccatiEquation
from certrack.certificates.search.shift import best_shifts
from certrack.certificates.semidefinite import SemidefiniteProgram, best_solution
from certrack.core import once as once_module
from certrack.core.blas import one_blas_thread
from certrack.core.errors import InputError
from certrack.core.once import once
from certrack.studies.margins import margins

STARTER = Path(__file__).parent / "data" / "starter.toml"


def random_system(seed):
    """A robust design of order 1 to 4 with uncertain terms of any strength that leaves room."""
    rng = np.random.default_rng([seed, 18])
    n = int(rng.integers(1, 5))

    def some(low, high, share):
        return [float(v) if rng.random() < share else 0.0 for v in 10 ** rng.uniform(low, high, n)]

    uncertainty = certrack.Uncertainty(some(-2, 0, 0.8), some(-3, -1, 0.7), some(-3, 0, 0.8))
    plant = certrack.Plant(
        states=[f"x{i}" for i in range(1, n + 1)],
        chain=[float(v) for v in 10 ** rng.uniform(-0.5, 0.5, n - 1)],
        input_gain=1,
        uncertainty=uncertainty,
    )
    law = certrack.Robust(
        c=[float(v) for v in 10 ** rng.uniform(0, 1, n)], feedforward=int(rng.integers(0, n))
    )
    reference = certrack.SymbolicReference("0.2*cos(t)")
    return certrack.System(plant, law, reference, certrack.Truth(1), certrack.Settings([0] * n, 1))


@settings(max_examples=8)
@given(st.integers(0, 10**6))
def test_the_riccati_equation_proves_what_the_grid_of_programs_does(seed):
    exact = error_problem(random_system(seed), rational)
    lowest = riccati_optimum(exact.in_floats())
    slow = best_solution(SemidefiniteProgram(exact.in_floats()))
    if lowest is None or slow is None:
        return
    expected = prove(exact, slow)
    proof = best_proof(exact).proof
    assert proof is not None and failed_condition(exact, proof) == ""
    if expected is not None:
        assert float(from_text(proof.bound)) <= float(from_text(expected.bound)) * (1 + 1e-7)
    assert float(from_text(proof.bound)) == pytest.approx(lowest.bound, rel=1e-5)
    assert float(from_text(proof.bound)) > lowest.bound * (1 - 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_gradient_by_multipliers_and_rate(seed):
    problem = error_problem(random_system(seed + 40), decimal)
    lowest = riccati_optimum(problem)
    assert lowest is not None
    rng = np.random.default_rng(seed)
    equation, x = lowest.equation, lowest.state.logarithms
    away = x + 0.05 * rng.standard_normal(len(x)) * (equation.at(x).curvature > 0.01)
    point, step = equation.at(away), 1e-5
    assert point is not None
    for i, unit in enumerate(np.eye(len(x))):
        up, down = (equation.at(away + sign * step * unit).value for sign in (1, -1))
        assert point.gradient[i] == pytest.approx((up - down) / (2 * step), rel=1e-4, abs=1e-6)
    assert (np.abs(equation.at(x).gradient) < 1e-4).all()


def test_no_multipliers_have_no_riccati_solution():
    problem = error_problem(certrack.load("dual-motor-lean"), decimal)
    equation = riccati_optimum(problem).equation
    huge = np.full(sum(problem.counts) + 1, 100.0)
    assert equation.at(huge) is None
    assert equation.at(np.full(len(huge), np.nan)) is None


MUTATIONS = {
    "nu": lambda s: replace(s, nu=0.9 * s.nu),
    "k": lambda s: replace(s, k=0.9 * s.k),
    "lam": lambda s: replace(s, lam=0.9 * s.lam),
    "alpha": lambda s: replace(s, alpha=1.1 * s.alpha),
    "P": lambda s: replace(s, P=0.9 * s.P),
}


@pytest.mark.parametrize("mutation", MUTATIONS)
def test_a_wrong_float_result_is_not_proven(mutation):
    exact = error_problem(certrack.load("dual-motor-lean"), rational)
    solution = riccati_optimum(exact.in_floats()).solution(1e-7, 1e5)
    assert prove(exact, solution, back_off=BACK_OFF[:1]) is not None
    assert prove(exact, MUTATIONS[mutation](solution), back_off=BACK_OFF[:1]) is None


def test_a_wrong_search_makes_room_for_the_next(monkeypatch):
    """An X that is too small is not proven; the bound is then that of a program."""
    system = certrack.load("dual-motor-lean")
    honest = certify_semidefinite(system)[0].bound
    real = RiccatiEquation.strict_solution
    monkeypatch.setattr(
        RiccatiEquation, "strict_solution", lambda *arguments: 0.9 * real(*arguments)
    )
    found, proof = certify_semidefinite(system)
    assert found.verified and failed_condition(error_problem(system, rational), proof) == ""
    assert honest < found.bound < honest * (1 + 1e-5)


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
def test_slope_by_log_alpha(name):
    program = SemidefiniteProgram(error_problem(certrack.load(name), decimal))
    alpha = 0.7 * best_by_slope(program).alpha
    slope, step = program.by_log_alpha(program.point(alpha), alpha), 1e-3
    up, down = (2 * math.log(program.solve(alpha * math.exp(h)).bound) for h in (step, -step))
    assert slope == pytest.approx((up - down) / (2 * step), rel=1e-2)


def test_alpha_by_its_slope_is_that_of_the_grid(monkeypatch):
    for name in ("example1", "theorem1-counterexample"):
        problem = error_problem(certrack.load(name), decimal)
        for target in range(problem.n):
            program = SemidefiniteProgram(problem, target)
            slow = best_solution(program)
            solved = []
            real = program.point
            monkeypatch.setattr(program, "point", lambda a: solved.append(a) or real(a))  # noqa: B023
            fast = best_by_slope(program)
            assert fast.bound <= slow.bound * (1 + 1e-8)
            assert len(solved) <= 12
            assert best_by_slope(program, 1.1 * fast.alpha).bound <= slow.bound * (1 + 1e-8)


def test_no_centre_is_searched_that_would_creep_towards_none(monkeypatch):
    """Of this plant any centre is worse than none, the less the smaller it is."""
    system = certrack.load(STARTER)
    problem = error_problem(system, rational)
    reached = best_proof(problem, problem.n - 1).proof
    centred = CentredProblems.of(system, problem, reached).in_floats()
    alpha, bound = (float(from_text(text)) for text in (reached.alpha, reached.bound))
    solved = []
    real = SemidefiniteProgram.point
    monkeypatch.setattr(
        SemidefiniteProgram, "point", lambda self, a: solved.append(a) or real(self, a)
    )
    assert best_shifts(centred, alpha, problem.n - 1, bound) == []
    assert len(solved) == 6
    crept = best_shifts(centred, alpha, problem.n - 1)
    assert len(solved) <= 40 and abs(crept[0][0]) < 1e-6
    least = SemidefiniteProgram(centred.at(crept[0][0]), problem.n - 1).solve(crept[0][1]).bound
    assert bound * (1 - 1e-6) < least


def test_the_cascade_of_example_1_takes_few_programs(monkeypatch):
    solved = []
    real = SemidefiniteProgram.point
    monkeypatch.setattr(
        SemidefiniteProgram, "point", lambda self, a: solved.append(a) or real(self, a)
    )
    found, stages = certify_cascade(certrack.load("example1"))
    assert found.bound <= 0.07863788918094  # of a grid of programs for each of 14 kappa
    assert len(stages) == 3 and len(solved) <= 40


@pytest.mark.parametrize("name", ["dual-motor", "example1", 3, 5, 8])
def test_the_strength_of_one_program_is_that_of_a_bisection(name, monkeypatch):
    system = certrack.load(name) if isinstance(name, str) else random_system(name)
    certified, _ = certify_semidefinite(system)
    fast = strength.critical_semidefinite(system, certified)
    monkeypatch.setattr(strength, "largest_strength", lambda *_: None)
    slow = strength.critical_semidefinite(system, certified)
    assert fast >= slow * (1 - 1e-4)
    assert fast <= slow * (1 + 2e-3) or slow <= 1


def test_a_wrong_strength_is_not_proven(monkeypatch):
    system = certrack.load("dual-motor")
    honest = strength.critical_semidefinite(system)
    real = strength.largest_strength

    def larger(*arguments):
        found = real(*arguments)
        return replace(found, strength=1.01 * found.strength)

    monkeypatch.setattr(strength, "largest_strength", larger)
    assert strength.critical_semidefinite(system) <= honest * (1 + 1e-9)


def test_the_same_numbers_every_time():
    proofs = [
        (certify_semidefinite(system)[1], certify_cascade(system)[1])
        for system in (certrack.load("example1") for _ in range(2))
    ]
    assert proofs[0] == proofs[1]


class _Bowl:
    def __init__(self, x):
        self.value = float(x[0] - math.log(x[0]) + 10 * (x[1] - 1) ** 2)
        self.gradient = np.array([1 - 1 / x[0], 20 * (x[1] - 1)])
        self.curvature = np.array([1.0, 5.0])


def test_a_descent_stays_where_the_function_exists():
    lowest = quasi_newton(lambda x: _Bowl(x) if x[0] > 0 else None, np.array([3.0, -2.0]), 1e-12)
    assert lowest.x == pytest.approx([1, 1], abs=1e-5)
    assert lowest.left < 1e-11
    assert quasi_newton(lambda _: None, np.zeros(2), 1e-12) is None


def test_results_are_computed_once_and_not_pickled():
    system, calls = certrack.load("dual-motor-lean"), []

    @once
    def counted(subject, factor=1):
        calls.append(factor)
        return factor * subject.plant.n

    assert [counted(system), counted(system), counted(system, 2)] == [4, 4, 8]
    assert calls == [1, 2]
    assert error_problem(system, rational) is error_problem(system, rational)
    assert once_module.RESULTS in vars(system)
    other = pickle.loads(pickle.dumps(system))
    assert once_module.RESULTS not in vars(other) and other == system
    assert counted(other) == 4 and calls == [1, 2, 1]
    with pytest.raises(ValueError, match="read-only"):
        error_problem(system, decimal).M[0, 0] = 1.0


def blas_threads():
    """Of the libraries of NumPy and SciPy; others that a process may have are not asked."""
    names = ("numpy", "scipy")
    known = [pool for pool in threadpool_info() if any(n in pool["filepath"] for n in names)]
    return [pool["num_threads"] for pool in known if pool["user_api"] == "blas"]


def test_one_thread_of_the_blas_and_then_as_before():
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        assert set(one_blas_thread(blas_threads)()) == {1}
        assert blas_threads() == before
    computations = (certrack.certify, certrack.estimate, certrack.tune, certrack.falsify, margins)
    for computation in computations:
        assert hasattr(computation, "__wrapped__")


def test_callers_that_overlap_leave_the_blas_as_it_was():
    """The second one enters within the first and leaves after it, or fails."""
    entered, leave, seen = threading.Event(), threading.Event(), []

    @one_blas_thread
    def first():
        entered.set()
        leave.wait(60)

    @one_blas_thread
    def second():
        leave.set()
        thread.join(60)
        seen.extend(blas_threads())
        raise InputError("x", "is refused")

    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        thread = threading.Thread(target=first)
        thread.start()
        entered.wait(60)
        with pytest.raises(InputError):
            second()
        assert set(seen) == {1} and blas_threads() == before


def test_unsolved_programs_leave_the_grid(monkeypatch):
    """Where no first rate has a solution, the grid is asked."""
    asked = []
    monkeypatch.setattr(
        "certrack.certificates.search.decay_rate.best_solution", lambda p: asked.append(p)
    )
    program = SemidefiniteProgram(error_problem(certrack.load("dual-motor"), decimal))
    monkeypatch.setattr(program, "point", lambda _: None)
    assert best_by_slope(program) is None and asked == [program]
    assert best_proof_module.best_by_slope is best_by_slope
