"""The best multipliers and decay rate of a law without estimates, by a quasi-Newton descent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scaling import Scaling
from certrack.certificates.search.descent import quasi_newton
from certrack.certificates.search.riccati_equation import (
    RiccatiEquation,
    RiccatiPoint,
    smallest_solution,
)
from certrack.certificates.semidefinite import Solution, fastest_rate
from certrack.certificates.symmetric import upper_entries

#: Decay rates that a cold start tries, over the fastest.
COLD_SHARES = (0.35, 0.1, 0.03, 0.005)

#: From where the a-inputs' multipliers would balance, a cold start lowers them by this factor until
#: there is an X, so many times.
LOWER, LOWERINGS = 0.2, 9

#: By how much the logarithm of bound^2 may be above the lowest, cold and warm.
COLD_ACCURACY, WARM_ACCURACY = 1e-10, 1e-9

#: A search that ended, at the edge of what exists or after all its steps, further above is none.
NOT_CONVERGED = 1e-6

#: An X_tt below this part of the largest entry of X is rounding.
LEAST_DIAGONAL = 1e-12


@dataclass(frozen=True)
class RiccatiState:
    """Where a search ended: what the next one near it begins from.

    Attributes
    ----------
    scaling : Scaling
    logarithms : array
        Of lam, nu, k and alpha, scaled.
    inverse : array
        About the inverse Hessian.
    """

    scaling: Scaling
    logarithms: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True)
class RiccatiOptimum:
    """The lowest bound that a search reached.

    Attributes
    ----------
    problem : ErrorProblem
        In its own units.
    equation : RiccatiEquation
        In scaled ones.
    point : RiccatiPoint
    state : RiccatiState
    """

    problem: ErrorProblem
    equation: RiccatiEquation
    point: RiccatiPoint
    state: RiccatiState

    @property
    def bound(self) -> float:
        """Of limsup |e_target|, in floats."""
        size = self.state.scaling.sizes[self.equation.target]
        return float(size * math.exp(self.point.value / 2))

    @property
    def alpha(self) -> float:
        """Its decay rate, 1/s."""
        return float(math.exp(self.state.logarithms[-1]) / self.state.scaling.time)

    def solution(self, strictness: float, largest_room: float) -> Solution | None:
        """A point of the semidefinite program, inside at this part of the cost; or None."""
        scaling, target = self.state.scaling, self.equation.target
        try:
            X = self.equation.strict_solution(self.state.logarithms, strictness, largest_room)
            if X is None:
                return None
            P, unit = np.linalg.inv(X), float(X[target, target])
        except np.linalg.LinAlgError:  # something does not move at all
            return None
        entries = upper_entries(self.problem.n)
        scaled_P = np.array([P[i, j] + P[j, i] for i, j in entries]) * (unit / 2)
        multipliers = np.exp(self.state.logarithms[:-1]) * unit
        lam, nu, k = scaling.unscaled_multipliers(self.problem, multipliers, target)
        return Solution(
            self.alpha,
            scaling.unscaled_P(entries, scaled_P, target),
            lam,
            nu,
            k,
            float(nu.sum() + k.sum()),
            scaling.lam_units(self.problem, target),
        )


def riccati_optimum(
    problem: ErrorProblem, warm: RiccatiState | None = None, target: int = 0
) -> RiccatiOptimum | None:
    """The lowest bound of a problem without estimates; None if none is reached from the start.

    Parameters
    ----------
    problem : ErrorProblem
        In floats, with bounded inputs.
    warm : RiccatiState, optional
        Of a problem with the same structure, nearby.
    target : int
        Which e_i is bounded (from 0).
    """
    assert problem.adaptation is None
    if not sum(problem.counts[1:]):
        return None
    if warm is not None:
        optimum = _descended(problem, target, warm)
        if optimum is not None:
            return optimum
    return _descended(problem, target, None)


def _descended(
    problem: ErrorProblem, target: int, warm: RiccatiState | None
) -> RiccatiOptimum | None:
    """What a descent from one start ends with; None if it has none, or does not converge."""
    scaling = Scaling.of(problem) if warm is None else warm.scaling
    scaled = scaling.applied(problem)
    equation = RiccatiEquation(scaled, target)
    if warm is None:
        start = _cold_start(equation, fastest_rate(scaled))
        accuracy, inverse = COLD_ACCURACY, None
    else:
        start = warm.logarithms
        accuracy, inverse = WARM_ACCURACY, warm.inverse
    lowest = None if start is None else quasi_newton(equation.at, start, accuracy, inverse)
    if lowest is None or lowest.left > NOT_CONVERGED:
        return None
    assert isinstance(lowest.point, RiccatiPoint)
    X = lowest.point.X
    if X[target, target] < LEAST_DIAGONAL * np.abs(X).max():
        return None
    state = RiccatiState(scaling, lowest.x, lowest.inverse)
    return RiccatiOptimum(problem, equation, lowest.point, state)


def _cold_start(equation: RiccatiEquation, fastest: float) -> np.ndarray | None:
    """Multipliers and a rate for which there is an X; None if there are none.

    With nu and k of 1 and small lam the a-inputs count only with themselves; from where theirs
    would balance without that, lam is lowered until there is an X.
    """
    na, nb, _ = equation.counts
    if not fastest > 0:
        return None
    for share in COLD_SHARES:
        alpha = share * fastest
        lam = _balanced(equation, alpha)
        if lam is None:
            return None
        for _ in range(LOWERINGS if na else 1):
            k = 1 + lam @ equation.reference_weights
            start = np.log(np.concatenate([lam, np.ones(nb), k, [alpha]]))
            if equation.at(start) is not None:
                return start
            lam = lam * LOWER
    return None


def _balanced(equation: RiccatiEquation, alpha: float) -> np.ndarray | None:
    """Each lam where what it costs and what it saves would balance, to first order."""
    p, na = equation.problem, equation.counts[0]
    n = p.n
    if not na:
        return np.ones(0)
    A = p.M + alpha / 2 * np.eye(n)
    B = (p.Ua @ p.Ua.T + p.Ub @ p.Ub.T + p.Uy @ p.Uy.T) / 2
    solved = smallest_solution(A, B + np.finfo(float).eps * np.trace(B) * np.eye(n), 0 * A)
    if solved is None:
        return None
    X, L = solved
    saved = ((p.Ua * (L @ p.Ua)).sum(axis=0)) / 2
    cost = 2 * equation.sizes(X @ L @ X)
    tiny = np.finfo(float).eps ** 2 * (saved.max() + cost.max() + 1)
    return np.asarray(np.sqrt((saved + tiny) / (cost + tiny)))
