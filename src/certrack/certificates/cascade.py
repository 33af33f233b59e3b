"""The cascade: a tighter bound for the adaptive law, in two linear steps.

In one program the slow leakage of the estimates limits alpha, although e_1 ... e_{n-1} settle much
faster and never see the estimates: only the last row of the error system does. So

1. bound the last coordinate, limsup |e_n| <= E, by the semidefinite program with P >= e_n e_n^T;
2. treat e_n as one more bounded input of the first n - 1 rows, a problem without estimates, and
   bound e_1 there, with any alpha the fast rows allow.

Once |e_n| <= E (1 + eps), the second inequality, which is strict, still holds for small eps; so
limsup |e_1| is at most its bound. Both steps are verified exactly. A stage
between the two, centred on better virtual parameters (:mod:`certrack.certificates.centred`), makes
E smaller where it helps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from certrack.certificates.arithmetic import rational
from certrack.certificates.centred import centred_problem
from certrack.certificates.certificate import Certificate, NoCertificate, missing
from certrack.certificates.exact import Proof, check, float_up, from_text, prove
from certrack.certificates.problem import ErrorProblem, assumptions, error_problem
from certrack.certificates.semidefinite import FAILED, Program, Solution, best_solution
from certrack.systems.system import System


def certify_cascade(system: System) -> tuple[Certificate, tuple[Proof, ...] | None]:
    """The cascade of `system`, and its two or three proven stages."""
    try:
        exact = error_problem(system, rational)
        if exact.adaptation is None or exact.n < 2:
            raise NoCertificate("the cascade helps the adaptive law of order 2 and more only")
        stages = [_step(exact, exact.n - 1)]
        closer = _centred_stage(system, exact, stages[0])
        stages += [] if closer is None else [closer]
        first = _step(head_problem(exact, from_text(stages[-1].bound)), 0)
    except NoCertificate as problem:
        return missing("cascade", str(problem)), None
    alpha, bound = float(from_text(first.alpha)), float_up(from_text(first.bound))
    rests = tuple(assumptions(system))
    found = Certificate("cascade", bound, alpha, bound**2 * alpha / 2, True, assumptions=rests)
    return found, (*stages, first)


def check_cascade(system: System, problem: ErrorProblem, stages: Sequence[Proof]) -> str:
    """Empty if every stage holds for the (exact) problem, else what fails."""
    if problem.n < 2 or problem.adaptation is None:
        return "a cascade needs the adaptive law and at least two states"
    *inner, first = stages
    reason = check(problem, inner[0], problem.n - 1)
    if not reason and len(inner) == 2:
        kappa = from_text(inner[1].shift)
        reason = check(centred_problem(system, problem, inner[0], kappa), inner[1], problem.n - 1)
    return reason or check(head_problem(problem, from_text(inner[-1].bound)), first)


#: Shifts that are tried, of either sign; the best is refined.
SHIFTS = (0.01, 0.03, 0.1)


def _centred_stage(system: System, exact: ErrorProblem, reached: Proof) -> Proof | None:
    """A smaller bound on e_n with V centred elsewhere, or None."""
    target = exact.n - 1
    solved: dict[str, Solution] = {}

    def bound(kappa: float) -> float:
        text = f"{kappa:.6g}"
        centred = centred_problem(system, exact, reached, from_text(text))
        found = best_solution(Program(centred.in_floats(), target))
        if found is None:
            return FAILED
        solved[text] = found
        return found.bound

    try:
        grid = sorted([-s for s in SHIFTS] + list(SHIFTS))
        values = [bound(kappa) for kappa in grid]
        if min(values) == FAILED:
            return None
        best = grid[int(np.argmin(values))]
        ends = sorted((best / 3, best * 2.5))
        minimize_scalar(bound, bounds=ends, method="bounded", options={"maxiter": 8})
    except NoCertificate:
        return None
    ranked = sorted(solved, key=lambda text: solved[text].bound)
    for text in ranked[:2]:
        centred = centred_problem(system, exact, reached, from_text(text))
        proof = prove(centred, solved[text], target)
        if proof is not None and from_text(proof.bound) < from_text(reached.bound):
            return replace(proof, shift=text)
    return None


def head_problem(problem: ErrorProblem, limit: Any) -> ErrorProblem:
    """The first n - 1 rows, with e_n as a bounded input, |e_n| <= limit."""
    m = problem.n - 1
    return replace(
        problem,
        M=problem.M[:m, :m],
        Ua=problem.Ua[:m],
        Ub=problem.Ub[:m],
        Uy=np.hstack([problem.Uy[:m], problem.M[:m, m:] * limit]),
        Xe=problem.Xe[:, :m],
        Xy=np.hstack([problem.Xy, problem.Xe[:, m:] * limit]),
        adaptation=None,
    )


def _step(exact: ErrorProblem, target: int) -> Proof:
    found = best_solution(Program(exact.in_floats(), target))
    proof = None if found is None else prove(exact, found, target)
    if proof is None:
        raise NoCertificate("no cascade found; lower tau, raise c, or use fewer damping terms")
    return proof
