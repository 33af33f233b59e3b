"""The best centre of V for a centred stage, and its decay rate, by derivatives of the optimum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certrack.certificates.centred import CentredProblems
from certrack.certificates.scaling import Scaling
from certrack.certificates.search.descent import quasi_newton
from certrack.certificates.semidefinite import ProgramPoint, SemidefiniteProgram, Solution

#: Values of kappa that are tried, of either sign. They are close enough for the descent below to
#: reach whatever lies between two of them; with (0.01, 0.1) Example 1 gets 0.0824, not 0.0786.
SHIFTS = (0.01, 0.03, 0.1)

#: Half the relative step of kappa's difference; the problem's part in it is nearly linear.
SHIFT_STEP = 1e-4

#: By how much the descent from afar may leave log bound^2 above the lowest.
SHIFT_ACCURACY = 1e-7

#: From nearby a step is not shortened further than this: the lowest point is a kink.
NEARBY_SHORTEST = 0.05

#: About the second derivatives of log bound^2 by log alpha and by log kappa.
ASSUMED_CURVATURE = (1.0, 0.3)


@dataclass(frozen=True)
class _ShiftedPoint:
    """The logarithm of bound^2 and its derivatives by log alpha and log kappa."""

    solution: Solution
    value: float
    gradient: np.ndarray
    curvature: np.ndarray


def best_shifts(
    centred: CentredProblems, alpha: float, target: int, bound: float = math.inf
) -> list[tuple[float, float]]:
    """Pairs of kappa and alpha, the best first; empty where no kappa has a solution.

    Empty also where a bound that falls as kappa goes to zero would end there, as a straight line,
    above the one that needs no centre: such a descent creeps towards zero.

    Parameters
    ----------
    centred : CentredProblems
        In floats.
    alpha : float, 1/s
        Where the search begins, for every kappa.
    target : int
        Which e_i is bounded (from 0).
    bound : float
        Of e_i without a centre.
    """
    if bound <= 0:  # none is better
        return []
    starts = []
    for kappa in (sign * shift for shift in SHIFTS for sign in (1, -1)):
        program, point = _solved(centred, kappa, alpha, target)
        if point is not None:
            starts.append((program.solution(point, alpha).bound, kappa, program, point))
    if not starts:
        return []
    _, first, program, point = min(starts, key=lambda start: start[:2])
    here = _point_with_slopes(centred, first, alpha, program, point)
    if here is not None and 0 < here.gradient[1] < here.value - 2 * math.log(bound):
        return []

    def at(x: np.ndarray) -> _ShiftedPoint | None:
        return _point(centred, first, x, target, program.scaling)

    lowest = quasi_newton(at, np.array([math.log(alpha), 0.0]), SHIFT_ACCURACY)
    if lowest is None:
        return [(first, alpha)]
    return [(first * math.exp(lowest.x[1]), math.exp(lowest.x[0])), (first, alpha)]


def best_shift_nearby(
    centred: CentredProblems,
    kappa: float,
    alpha: float,
    target: int,
    accuracy: float,
    scaling: Scaling,
) -> tuple[float, Solution] | None:
    """The best kappa and its solution, by a descent from those of a design nearby.

    None where these have no solution here, or the descent ends at a kink: there the bound rises to
    both sides, and the best kappa is where two functions meet, which slopes do not tell.

    Parameters
    ----------
    centred : CentredProblems
        In floats.
    kappa : float
        Not 0.
    alpha : float, 1/s
    target : int
        Which e_i is bounded (from 0).
    accuracy : float
        What log bound^2 may be above the lowest.
    scaling : Scaling
        Of the problem without a centre: kappa changes the sizes of its e_i by little.
    """

    def at(x: np.ndarray) -> _ShiftedPoint | None:
        return _point(centred, kappa, x, target, scaling)

    start = np.array([math.log(alpha), 0.0])
    lowest = quasi_newton(at, start, accuracy, shortest=NEARBY_SHORTEST)
    if lowest is None or lowest.left > accuracy:
        return None
    assert isinstance(lowest.point, _ShiftedPoint)
    return kappa * math.exp(lowest.x[1]), lowest.point.solution


def _solved(
    centred: CentredProblems,
    kappa: float,
    alpha: float,
    target: int,
    scaling: Scaling | None = None,
) -> tuple[SemidefiniteProgram, ProgramPoint | None]:
    program = SemidefiniteProgram(centred.at(kappa), target, scaling)
    return program, program.point(alpha) if alpha < program.fastest else None


def _point(
    centred: CentredProblems, first: float, x: np.ndarray, target: int, scaling: Scaling
) -> _ShiftedPoint | None:
    alpha, kappa = math.exp(x[0]), first * math.exp(x[1])
    program, point = _solved(centred, kappa, alpha, target, scaling)
    return None if point is None else _point_with_slopes(centred, kappa, alpha, program, point)


def _point_with_slopes(
    centred: CentredProblems,
    kappa: float,
    alpha: float,
    program: SemidefiniteProgram,
    point: ProgramPoint,
) -> _ShiftedPoint | None:
    solution = program.solution(point, alpha)
    value = float(point.cost @ point.x)
    lagrangian = program.lagrangian(point, alpha)
    above, below = (lagrangian(centred.at(kappa * (1 + h))) for h in (SHIFT_STEP, -SHIFT_STEP))
    by_shift = (above - below) / (2 * SHIFT_STEP) / value
    if not (solution.bound > 0 and math.isfinite(by_shift)):
        return None
    gradient = np.array([program.by_log_alpha(point, alpha), by_shift])
    if not np.isfinite(gradient).all():
        return None
    value = 2 * math.log(solution.bound)
    return _ShiftedPoint(solution, value, gradient, np.array(ASSUMED_CURVATURE))
