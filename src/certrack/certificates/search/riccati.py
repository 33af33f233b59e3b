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
from certrack.certificates.semidefinite import Solution, fastest_rate, upper_entries

#: Decay rates that a cold start tries, over the fastest.
COLD_SHARES = (0.35, 0.1, 0.03, 0.005)

#: From where the a-inputs' multipliers would balance, a cold start lowers them by this factor until
#: there is an X, so many times.
LOWER, LOWERINGS = 0.2, 9

#: By how much the logarithm of bound^2 may be above the lowest, cold and warm.
COLD_ACCURACY, WARM_ACCURACY = 1e-10, 1e-9

#: A search that ended, at the edge of what exists or after all its steps, further above is none.
NOT_CONVERGED = 1e-6

#: A warm start that has no X gets smaller lam, and then a smaller alpha: these parts of both.
WARM_SHARES = ((1.0, 1.0), (0.4, 1.0), (0.4, 0.7), (0.2, 0.4), (0.05, 0.2), (0.01, 0.05))

#: Where a search begins: logarithms, and the point there.
SearchStart = tuple[np.ndarray, RiccatiPoint]


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

    def strict_solution(self, strictness: float, largest_room: float) -> Solution | None:
        """A point of the semidefinite program, inside at this part of the cost; or None."""
        X = self.equation.strict_solution(self.state.logarithms, strictness, largest_room)
        return None if X is None else self._solution(X)

    @property
    def solution(self) -> Solution:
        """The point of the semidefinite program with this bound: at the edge of what is allowed."""
        return self._solution(self.point.X)

    def _solution(self, X: np.ndarray) -> Solution:
        scaling, target = self.state.scaling, self.equation.target
        P, unit = np.linalg.inv(X), float(X[target, target])
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
    scaling = Scaling.of(problem) if warm is None else warm.scaling
    scaled = scaling.applied(problem)
    equation = RiccatiEquation(scaled, target)
    if warm is None:
        start = _cold_start(equation, fastest_rate(scaled))
        accuracy, inverse = COLD_ACCURACY, None
    else:
        start = _existing(equation, warm.logarithms)
        accuracy, inverse = WARM_ACCURACY, warm.inverse
    if start is None:
        return None
    logarithms, point = start
    lowest = quasi_newton(equation.at, logarithms, accuracy, inverse, here=point)
    if lowest is None or lowest.left > NOT_CONVERGED:
        return None
    assert isinstance(lowest.point, RiccatiPoint)
    state = RiccatiState(scaling, lowest.x, lowest.inverse)
    return RiccatiOptimum(problem, equation, lowest.point, state)


def _existing(equation: RiccatiEquation, begin: np.ndarray) -> SearchStart | None:
    """The first point near these logarithms for which there is an X."""
    na = equation.counts[0]
    for of_lam, of_alpha in WARM_SHARES:
        logarithms = begin.copy()
        logarithms[:na] += math.log(of_lam)
        logarithms[-1] += math.log(of_alpha)
        point = equation.at(logarithms)
        if point is not None:
            return logarithms, point
    return None


def _cold_start(equation: RiccatiEquation, fastest: float) -> SearchStart | None:
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
            logarithms = np.log(np.concatenate([lam, np.ones(nb), k, [alpha]]))
            point = equation.at(logarithms)
            if point is not None:
                return logarithms, point
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
