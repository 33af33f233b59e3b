"""The largest common scale of tau with a certificate, by one semidefinite program.

Where all a-inputs are bounded by ||x||, their multipliers count in the upper left block with their
sum alone, which the scale of V makes 1. With kappa_i = lam_i/strength^2 the inequality

    [ (P M + M^T P + alpha P)/2 + Xe^T Xe   P Ua/2       ]
    [ Ua^T P/2                             -diag(kappa)  ]  <= 0

is linear in P and kappa, and sum kappa = 1/strength^2 is minimised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scaling import Scaling
from certrack.certificates.search.riccati_equation import smallest_solution
from certrack.certificates.semidefinite import SemidefiniteProgram, Solution, minimiser
from certrack.certificates.symmetric import svec, upper_entries

#: By how much more than needed P exceeds e_1 e_1^T.
ABOVE_THE_FLOOR = 1.01

#: A program is solved again in the units of its result where that is further from 1 than by this
#: factor, so many times at most.
NEAR_ONE, MAX_RESCALINGS = 3.0, 6

#: The edge of existence of a Riccati equation is found to this part.
EXISTENCE_ACCURACY = 1e-5

#: A smaller strength, in scaled units, is none.
SMALLEST_STRENGTH = 1e-12


@dataclass(frozen=True)
class Strongest:
    """The largest strength, as far as floats tell, and what holds at every smaller one.

    Attributes
    ----------
    strength : float
    solution : Solution
    """

    strength: float
    solution: Solution


def largest_strength(problem: ErrorProblem, alpha: float) -> Strongest | None:
    """The largest strength of a problem that has only a-inputs, all bounded by ||x||.

    None where the program is not solved, or does not cover the problem.

    Parameters
    ----------
    problem : ErrorProblem
        In floats, with a strength of 1.
    alpha : float, 1/s
    """
    if any(part is not None for part in problem.selections):
        return None
    if problem.adaptation is None and problem.counts[0] == 1:
        return _edge_of_existence(problem, alpha)
    unit, strongest = _guess(problem), None
    for _ in range(MAX_RESCALINGS):
        strongest = _largest_strength(problem.homogeneous(unit), alpha)
        if strongest is None:
            return None
        if max(strongest.strength, 1 / strongest.strength) < NEAR_ONE:
            break
        unit *= strongest.strength
    return None if strongest is None else replace(strongest, strength=unit * strongest.strength)


def _edge_of_existence(problem: ErrorProblem, alpha: float) -> Strongest | None:
    """Of one a-input of a law without estimates: the edge of existence of a Riccati equation.

    P is then more accurate than a program's, which matters at large orders.
    """
    scaling = Scaling.of(problem)
    scaled, n = scaling.applied(problem), problem.n
    A = scaled.M + scaling.rate(alpha) / 2 * np.eye(n)
    B, C = scaled.Ua @ scaled.Ua.T / 2, 2 * scaled.Xe.T @ scaled.Xe

    # without C the equation is linear in what drives it
    alone, roomy = (smallest_solution(A, drive, 0 * C) for drive in (B, np.eye(n)))
    if roomy is None:
        return None
    by_input = np.zeros(n) if alone is None else np.diagonal(alone[0])

    def solved(strength: float, room: float) -> np.ndarray | None:
        free = strength**2 * by_input + room * np.diagonal(roomy[0])
        exists = smallest_solution(A, strength**2 * B + room * np.diag(free), C)
        return None if exists is None else exists[0]

    low, high = 0.0, _guess(scaled) * (1 + EXISTENCE_ACCURACY)
    while high - low > EXISTENCE_ACCURACY * high:
        middle = math.sqrt(low * high) if low else high / 2
        if solved(middle, EXISTENCE_ACCURACY**2) is None:
            high = middle
        else:
            low = middle
        if high < SMALLEST_STRENGTH:
            return None
    low *= 1 - EXISTENCE_ACCURACY
    X = solved(low, EXISTENCE_ACCURACY**2)
    if X is None:
        return None
    entries = upper_entries(n)
    P = np.linalg.inv(X)
    floor = float(X[0, 0]) * ABOVE_THE_FLOOR
    lam, nu, k = scaling.unscaled_multipliers(problem, np.array([floor]), 0)
    scaled_P = floor * np.array([(P[i, j] + P[j, i]) / 2 for i, j in entries])
    solution = Solution(
        alpha,
        scaling.unscaled_P(entries, scaled_P, 0),
        lam,
        nu,
        k,
        0.0,
        scaling.lam_units(problem, 0),
    )
    return Strongest(low, solution)


def _guess(problem: ErrorProblem) -> float:
    """The strength from the gain of the loop at rest."""
    gain = float(np.linalg.norm(problem.Xe @ np.linalg.solve(problem.M, problem.Ua), 2))
    return 1 / gain if 0 < gain < math.inf else 1.0


def _largest_strength(problem: ErrorProblem, alpha: float) -> Strongest | None:
    """The same in units in which the strength is about 1, as the solver's accuracy asks."""
    program = SemidefiniteProgram(problem)
    n, na, count = problem.n, problem.counts[0], len(program.entries)
    base, slope = program.inequality
    units = [svec(np.diag([0.0] * (n + i) + [1.0] + [0.0] * (na - 1 - i))) for i in range(na)]
    through = base[:, count] + units[0]  # of the first lam, without its own entry
    matrix = np.hstack(
        [base[:, :count] + program.scaling.rate(alpha) * slope[:, :count], -np.array(units).T]
    )
    cost = np.concatenate([np.zeros(count), np.ones(na)])
    point = minimiser(cost, matrix, -through, n + na)
    if point is None:
        return None
    kappa = np.maximum(point[count:], 0.0)
    inverse = float(kappa.sum())
    P, _ = program.parts(np.concatenate([point[:count], kappa]))
    try:
        floor = float(np.linalg.inv(P)[0, 0]) * ABOVE_THE_FLOOR
    except np.linalg.LinAlgError:
        return None
    if not (inverse > 0 and floor > 0):
        return None
    target = program.target
    lam, nu, k = program.scaling.unscaled_multipliers(problem, floor * kappa / inverse, target)
    solution = Solution(
        alpha,
        program.scaling.unscaled_P(program.entries, floor * point[:count], target),
        lam,
        nu,
        k,
        0.0,
        program.scaling.lam_units(problem, target),
    )
    strength = 1 / math.sqrt(inverse)
    return Strongest(strength, solution)
