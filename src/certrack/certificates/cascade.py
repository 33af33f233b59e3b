"""The cascade: a tighter bound for the adaptive law, in two linear steps.

In one program the slow leakage of the estimates limits alpha, although e_1 ... e_{n-1} settle much
faster and never see the estimates: only the last row of the error system does. So

1. bound the last coordinate, limsup |e_n| <= E, by the semidefinite program with P >= e_n e_n^T;
2. treat e_n as one more bounded input of the first n - 1 rows, a problem without estimates, and
   bound e_1 there, with any alpha the fast rows allow.

Once |e_n| <= E (1 + eps), the second inequality, which is strict, still holds for small eps; so
limsup |e_1| is at most its bound. Both steps are verified exactly. A stage between the two, centred
on better virtual parameters (:mod:`certrack.certificates.centred`), makes E smaller where it helps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.centred import CentredProblems, centred_problem
from certrack.certificates.certificate import Certificate, NoCertificate, missing, within_floats
from certrack.certificates.exact import Proof, failed_condition, from_text, proven
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.search.best_proof import best_proof
from certrack.certificates.search.shift import best_shifts
from certrack.systems.system import System


def certify_cascade(system: System) -> tuple[Certificate, tuple[Proof, ...] | None]:
    """The cascade of `system`, and its two or three proven stages."""
    try:
        with within_floats():
            exact = error_problem(system, rational)
            if exact.adaptation is None or exact.n < 2:
                raise NoCertificate("the cascade helps the adaptive law of order 2 and more only")
            stages = [_prove_stage(exact, exact.n - 1)]
            centred = _centred_stage(system, exact, stages[0])
            stages += [] if centred is None else [centred]
            head = _prove_stage(head_problem(exact, from_text(stages[-1].bound)), 0)
    except NoCertificate as problem:
        return missing("cascade", str(problem)), None
    return proven("cascade", system, head), (*stages, head)


def check_cascade(system: System, problem: ErrorProblem, stages: Sequence[Proof]) -> str:
    """Empty if every stage holds for the (exact) problem, else what fails."""
    if problem.n < 2 or problem.adaptation is None:
        return "a cascade needs the adaptive law and at least two states"
    *inner, head = stages
    reason = failed_condition(problem, inner[0], problem.n - 1)
    if not reason and len(inner) == 2:
        kappa = from_text(inner[1].shift)
        reason = failed_condition(
            centred_problem(system, problem, inner[0], kappa), inner[1], problem.n - 1
        )
    return reason or failed_condition(head_problem(problem, from_text(inner[-1].bound)), head)


#: kappa is written with this many digits, for it is part of the proof.
SHIFT_DIGITS = 6


def _centred_stage(system: System, exact: ErrorProblem, reached: Proof) -> Proof | None:
    """A proven bound on e_n, smaller than `reached`, with V centred elsewhere; or None."""
    target = exact.n - 1
    try:
        centred = CentredProblems.of(system, exact, reached)
    except NoCertificate:
        return None
    rate, bound = (float(from_text(text)) for text in (reached.alpha, reached.bound))
    for kappa, alpha in best_shifts(centred.in_floats(), rate, target, bound):
        text = f"{kappa:.{SHIFT_DIGITS}g}"
        proof = best_proof(centred.at(from_text(text)), target, near=alpha).proof
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


def _prove_stage(exact: ErrorProblem, target: int) -> Proof:
    """A proven bound on limsup |e_target| (from 0) of the problem."""
    proof = best_proof(exact, target).proof
    if proof is None:
        raise NoCertificate("no cascade found; lower tau, raise c, or use fewer damping terms")
    return proof
