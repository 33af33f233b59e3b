"""The best alpha of a semidefinite program by the derivative of its optimum: a few programs."""

from __future__ import annotations

import math

from certrack.certificates.semidefinite import SemidefiniteProgram, Solution, best_solution

#: Decay rates that a cold start tries, over the fastest.
FIRST_SHARES = (0.35, 0.1, 0.03)

#: Parts of the fastest rate between which alpha is searched, as of the grid.
LEAST_SHARE, LARGEST_SHARE = 1e-3, 0.98

#: What log bound^2 may be above the lowest; where a search that every move of a gain repeats
#: begins near its end, less will do.
SLOPE_ACCURACY, NEARBY_SLOPE_ACCURACY = 1e-8, 1e-6

#: The second derivative of log bound^2 by log alpha that a first step assumes; the longest step.
FIRST_CURVATURE, LONGEST_MOVE = 1.0, 1.0

#: A step between two slopes of different sign stays off the ends by this part.
OFF_THE_ENDS = 0.05

#: Programs that are solved at most.
MAX_PROGRAMS = 16


def best_by_slope(
    program: SemidefiniteProgram, near: float | None = None, accuracy: float = SLOPE_ACCURACY
) -> Solution | None:
    """The solution of least bound over alpha; None if there is none.

    The slope of its logarithm is zero there, and found by secants; where no program of the first
    rates has a solution, the grid is tried.

    Parameters
    ----------
    program : SemidefiniteProgram
    near : float, optional, 1/s
        The best alpha of a program nearby.
    accuracy : float
        What log bound^2 may be above the lowest.
    """
    fastest = program.fastest
    if not fastest > 0:
        return None
    lowest, highest = (math.log(share * fastest) for share in (LEAST_SHARE, LARGEST_SHARE))
    solutions: list[Solution] = []

    def slope_at(log_alpha: float) -> float:
        """The slope; infinite where there is no solution, which is so for too large an alpha."""
        alpha = math.exp(log_alpha)
        point = program.point(alpha)
        if point is None:
            return math.inf
        solutions.append(program.solution(point, alpha))
        return program.by_log_alpha(point, alpha)

    starts = [] if near is None else [min(max(math.log(near), lowest), highest)]
    slope = math.inf
    for here in (*starts, *(math.log(share * fastest) for share in FIRST_SHARES)):
        slope = slope_at(here)
        if slope < math.inf:
            break
    else:
        return best_solution(program)
    below: tuple[float, float | None] = (lowest, None)
    above: tuple[float, float | None] = (highest, None)
    if slope < 0:
        below = (here, slope)
    else:
        above = (here, slope)
    curvature = FIRST_CURVATURE
    for _ in range(MAX_PROGRAMS):
        if slope**2 < 2 * curvature * accuracy:
            break
        step = -slope / curvature
        there = here + max(-LONGEST_MOVE, min(step, LONGEST_MOVE))
        there = _off_the_ends(there, below, above)
        if abs(there - here) < accuracy:
            break
        new = slope_at(there)
        if new < math.inf:
            secant = (new - slope) / (there - here)
            curvature = secant if secant > 0 else FIRST_CURVATURE
            here, slope = there, new
            if slope < 0:
                below = (here, slope)
            else:
                above = (here, slope)
        else:
            above = (there, None)
            curvature *= 4
    return min(solutions, key=lambda solution: solution.bound)


def _off_the_ends(
    there: float, below: tuple[float, float | None], above: tuple[float, float | None]
) -> float:
    """The point, off the ends of an interval where the slope is known at both."""
    low, high = below[0], above[0]
    room = OFF_THE_ENDS * (high - low) if below[1] is not None or above[1] is not None else 0.0
    return min(max(there, low + room * (below[1] is not None)), high - room)
