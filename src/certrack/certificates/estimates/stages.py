"""The cascade in floats: its stages as the proof has them, each begun where it ended before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.cascade import SHIFT_DIGITS, head_problem
from certrack.certificates.centred import CentredProblems
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.search.decay_rate import best_by_slope
from certrack.certificates.search.shift import best_shifts
from certrack.certificates.semidefinite import SemidefiniteProgram, Solution
from certrack.systems.system import System

#: A shift that is known from nearby is tried so much smaller and larger, too.
SHIFT_RATIO = 1.06

#: Digits of the floats that stand for a proof.
STAGE_DIGITS = 13


@dataclass(frozen=True)
class StagesEstimate:
    """The cascade as far as floats tell.

    Attributes
    ----------
    last : Solution
        Of e_n.
    centred : Solution or None
        Of e_n, with V centred elsewhere; None where that is no better.
    head : Solution
        Of e_1.
    problems : pair of ErrorProblem
        That of e_n which counts, and that of e_1.
    shift : float
        kappa of the centred stage; 0 without.
    """

    last: Solution
    centred: Solution | None
    head: Solution
    problems: tuple[ErrorProblem, ErrorProblem]
    shift: float = 0.0

    @property
    def of_last(self) -> Solution:
        """The solution that bounds e_n."""
        return self.last if self.centred is None else self.centred


def estimate_stages(
    system: System, problem: ErrorProblem, near: StagesEstimate | None
) -> StagesEstimate | None:
    """The stages of the cascade; None where one of them has no solution.

    Parameters
    ----------
    system : System
    problem : ErrorProblem
        In floats, of the adaptive law and order 2 or more.
    near : StagesEstimate or None
        Of a system nearby.
    """
    target = problem.n - 1
    last = best_by_slope(
        SemidefiniteProgram(problem, target), None if near is None else near.last.alpha
    )
    if last is None:
        return None
    of_last, shift, centred = problem, 0.0, None
    best_centred = _centred(system, last, target, near)
    if best_centred is not None and best_centred[0].bound < last.bound:
        centred, shift, of_last = best_centred
    limit = last.bound if centred is None else centred.bound
    inner = head_problem(problem, limit)
    head = best_by_slope(SemidefiniteProgram(inner), None if near is None else near.head.alpha)
    if head is None:
        return None
    return StagesEstimate(last, centred, head, (of_last, inner), shift)


def _centred(
    system: System, reached: Solution, target: int, near: StagesEstimate | None
) -> tuple[Solution, float, ErrorProblem] | None:
    """The centred stage: by a full search, or beside the shift that is known from nearby."""
    try:
        exact = error_problem(system, rational)
        problems = CentredProblems.of(system, exact, _as_proof(reached)).in_floats()
    except NoCertificate:
        return None
    if near is None or near.centred is None:
        pairs = best_shifts(problems, reached.alpha, target)[:1]
    else:
        pairs = [(near.shift * r, near.centred.alpha) for r in (1, SHIFT_RATIO, 1 / SHIFT_RATIO)]
    entries = []
    for kappa, alpha in pairs:
        shift = float(f"{kappa:.{SHIFT_DIGITS}g}")
        centred = problems.at(shift)
        solution = best_by_slope(SemidefiniteProgram(centred, target), alpha)
        if solution is not None:
            entries.append((solution, shift, centred))
    return min(entries, key=lambda entry: entry[0].bound, default=None)


def _as_proof(solution: Solution) -> Proof:
    """Floats in the form of a proof, which they are none of."""

    def text(value: float) -> str:
        return f"{float(value):.{STAGE_DIGITS}g}"

    rows = tuple(tuple(map(text, row)) for row in np.asarray(solution.P))
    lam, nu, k = (tuple(map(text, v)) for v in (solution.lam, solution.nu, solution.k))
    return Proof(text(solution.alpha), rows, lam, nu, k, text(solution.bound))
