"""Value and gradient of the semidefinite certificate from one program: its dual gives both.

For a decay rate alpha the program is  Delta = min c.x  with  G x + s = h, s in K. Where a number
of the problem changes, so does the optimum, by the dual z of the same solve:

    dDelta = z . dG x + dc . x = <Z, dQ> + x_s dq

with Q the matrix of the inequality at the optimal P and multipliers, and q the leakage's cost; only
Q of the changed problem is computed, no program. The bound is sqrt(2 Delta/alpha). With alpha a
share of the fastest rate,

    d log bound = dDelta/(2 Delta) + (alpha Delta_alpha/(2 Delta) - 1/2) d log alpha

The scaling stays that of the point. It holds where the dual is unique. The point is solved for
again about itself (:mod:`.recentred`): the solver's first one is too far off for a gradient.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from certrack.certificates.estimates.recentred import recentred_point
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.semidefinite import ProgramPoint, SemidefiniteProgram, fastest_rate


@dataclass(frozen=True)
class SemidefiniteEstimate:
    """The semidefinite bound for one share of the fastest rate, and its gradient.

    Attributes
    ----------
    bound : float
        Of limsup |e_target|.
    log_gradient : array
        Derivatives of log bound, one for each pair of changed problems.
    by_log_share : float
        Its derivative by the logarithm of the share.
    program, point, alpha
        What was solved, for this decay rate (1/s), and its solution.
    """

    bound: float
    log_gradient: np.ndarray
    by_log_share: float
    program: SemidefiniteProgram = field(repr=False)
    point: ProgramPoint = field(repr=False)
    alpha: float


def semidefinite_estimate(
    problem: ErrorProblem,
    share: float,
    changed: Sequence[tuple[ErrorProblem, ErrorProblem]] = (),
    step: float = 1.0,
    target: int = 0,
) -> SemidefiniteEstimate | None:
    """The bound with alpha = share times the fastest rate; None if there is none.

    Parameters
    ----------
    problem : ErrorProblem
        In floats.
    share : float
        Below 1.
    changed : pairs of ErrorProblem
        With each parameter a step above and below.
    step : float
        Of these.
    target : int
        Which e_i is bounded.
    """
    fastest = fastest_rate(problem)
    if not fastest > 0:
        return None
    alpha = share * fastest
    program = SemidefiniteProgram(problem, target)
    point = recentred_point(program, alpha)
    if point is None:
        return None
    solution = program.solution(point, alpha)
    if not solution.bound > 0:
        return None
    value = float(point.cost @ point.x)
    lagrangian = program.lagrangian(point, alpha)
    by_log_share = program.by_log_alpha(point, alpha) / 2
    slopes = []
    for above, below in changed:
        direct = (lagrangian(above) - lagrangian(below)) / (2 * step)
        rates = math.log(fastest_rate(above) / fastest_rate(below)) / (2 * step)
        slopes.append(direct / (2 * value) + by_log_share * rates)
    gradient = np.nan_to_num(np.array(slopes))
    by_share = float(np.nan_to_num(by_log_share))
    return SemidefiniteEstimate(solution.bound, gradient, by_share, program, point, alpha)
