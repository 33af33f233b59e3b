"""The cascade: a tighter bound for the adaptive law, in two linear steps.

In one program the slow leakage of the estimates limits alpha, although e_1 ... e_{n-1} settle much
faster and never see the estimates: only the last row of the error system does. So

1. bound the last coordinate, limsup |e_n| <= E, by the semidefinite program with P >= e_n e_n^T;
2. treat e_n as one more bounded input of the first n - 1 rows, a problem without estimates, and
   bound e_1 there, with any alpha the fast rows allow.

Once |e_n| <= E (1 + eps), the second inequality, which is strict, still holds for small eps; so
limsup |e_1| is at most its bound. Both steps are verified exactly. The same argument may be applied
to any law; without leakage one program does as well.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import Certificate, NoCertificate, missing
from certrack.certificates.exact import Proof, check, float_up, from_text, prove
from certrack.certificates.problem import ErrorProblem, assumptions, error_problem
from certrack.certificates.semidefinite import Program, best_solution
from certrack.system import System


def certify_cascade(system: System) -> tuple[Certificate, tuple[Proof, Proof] | None]:
    """The two-step bound of `system`, and the numbers that prove it."""
    try:
        exact = error_problem(system, rational)
        if exact.adaptation is None or exact.n < 2:
            raise NoCertificate("the cascade helps the adaptive law of order 2 and more only")
        last = _step(exact, exact.n - 1)
        head = head_problem(exact, from_text(last.bound))
        first = _step(head, 0)
    except NoCertificate as problem:
        return missing("cascade", str(problem)), None
    alpha, bound = float(from_text(first.alpha)), float_up(from_text(first.bound))
    rests = tuple(assumptions(system))
    found = Certificate("cascade", bound, alpha, bound**2 * alpha / 2, True, assumptions=rests)
    return found, (last, first)


def check_cascade(problem: ErrorProblem, last: Proof, first: Proof) -> str:
    """Empty if both steps hold for the (exact) problem, else what fails."""
    if problem.n < 2:
        return "a cascade needs at least two states"
    reason = check(problem, last, problem.n - 1)
    return reason or check(head_problem(problem, from_text(last.bound)), first)


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
