"""The tight certificate: the best quadratic Lyapunov function and multipliers, by one SDP.

V = e^T P e / 2 (+ s times the energy of the estimates, where P = blkdiag(Pbar, s) so that the
update laws still cancel). For a given alpha the conditions

    inequality(P, lam, nu, k, alpha) <= 0,   P >= e_1 e_1^T,   lam, nu, k >= 0

are linear and Delta = sum k + sum nu + s q(alpha) is minimised (inputs are scaled to their
bounds). Then V' <= -alpha V + Delta and limsup |e_1| <= sqrt(2 Delta/alpha). A search over alpha
surrounds the program.

Clarabel is called directly: the program is small and a tuner solves it many thousand times, where a
modelling layer (cvxpy with a parameter) takes half as long again and 0.7 s to import (see bench/).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Protocol, TypeVar

import clarabel
import numpy as np
from scipy import sparse
from scipy.optimize import minimize_scalar

from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scaling import Scaling
from certrack.certificates.symmetric import svec, upper_entries

#: The alpha that are tried first, as parts of the fastest: 14 over three decades, a factor of 1.7
#: apart, and one near the end. The bound is flat in alpha but not unimodal at the edges; half as
#: many give the shipped systems the same bounds to seven digits.
ALPHA_GRID = np.append(np.geomspace(1e-3, 0.9, 14), 0.98)

#: log alpha is refined to this width: the bound is flat there, to about its square.
ALPHA_ACCURACY = 2e-3

#: Half the relative step of alpha in the derivative of what the leakage costs.
ALPHA_STEP = 1e-5

#: What a search sees where there is no certificate: it cannot calculate with infinity.
NO_BOUND = 1e30

#: Clarabel needs 10 to 30 iterations; one that needs more does not converge.
MAX_ITERATIONS = 100


@dataclass(frozen=True)
class Solution:
    """A point of the program, in unscaled coordinates.

    `lam_unit` is what a lam of 1 in the scaled ones is here, for each a-input.
    """

    alpha: float
    P: np.ndarray
    lam: np.ndarray
    nu: np.ndarray
    k: np.ndarray
    delta: float
    lam_unit: np.ndarray

    @property
    def bound(self) -> float:
        """limsup |e_1| in floating point, not yet verified."""
        return math.sqrt(max(0.0, 2 * self.delta / self.alpha))


@dataclass(frozen=True)
class ProgramPoint:
    """The minimiser of a program and its dual, in scaled units.

    Attributes
    ----------
    x : variables
        The free entries of P, then lam, nu, k.
    z : dual variables
        Of the matrix inequality first, as a vector in Clarabel's convention.
    cost : of each variable
        Up to a common factor.
    """

    x: np.ndarray
    z: np.ndarray
    cost: np.ndarray


class SemidefiniteProgram:
    """The semidefinite program of one :class:`ErrorProblem`, built once and solved for many alpha.

    Parameters
    ----------
    problem : ErrorProblem
        In floats.
    target : int
        Which e_i is to be bounded (from 0): P >= e_i e_i^T.
    scaling : Scaling, optional
        The natural one if left out.

    Attributes
    ----------
    entries : pairs (i, j)
        The entries of P that may be nonzero: the first variables. Then come lam, nu, k.
    inequality : two arrays
        Columns of the matrix inequality (as vectors) without alpha, and their slope in alpha.
    floor : array and vector
        Columns and right side of P >= e_i e_i^T.
    """

    def __init__(
        self,
        problem: ErrorProblem,
        target: int = 0,
        scaling: Scaling | None = None,
    ) -> None:
        self.problem, self.target = problem, target
        self.scaling = scaling or Scaling.of(problem)
        self._scaled = self.scaling.applied(problem)
        n = problem.n
        self._na, self._nb, self._ny = problem.counts
        self.entries = self._free_entries(n)
        size = self._size = n + sum(problem.counts)
        units = self._units()
        base, slope = self.inequality = self._columns(units)
        identity = np.eye(len(self.entries) + sum(problem.counts))
        least = self._least(target)
        floor = np.zeros((n * (n + 1) // 2, len(identity)))
        floor[:, : len(units)] = -svec(units).T
        self.floor = floor, least
        multipliers = -identity[len(self.entries) :]
        self._base = np.vstack([base, floor, multipliers])
        self._slope = np.vstack([slope, np.zeros((len(floor) + len(multipliers), len(identity)))])
        self._right = np.concatenate(
            [np.zeros(size * (size + 1) // 2), least, np.zeros(len(multipliers))]
        )
        self._cones = [clarabel.PSDTriangleConeT(size), clarabel.PSDTriangleConeT(n)]
        if len(multipliers):
            self._cones.append(clarabel.NonnegativeConeT(len(multipliers)))

    def aimed_at(self, target: int) -> SemidefiniteProgram:
        """The program of the same problem that bounds another e_i: it has most of its parts."""
        other, least = copy(self), self._least(target)
        other.target, other.floor = target, (self.floor[0], least)
        first = self._size * (self._size + 1) // 2
        other._right = self._right.copy()
        other._right[first : first + len(least)] = least
        return other

    def _least(self, target: int) -> np.ndarray:
        """The right side of P >= e_i e_i^T."""
        unit = np.zeros((self.problem.n, self.problem.n))
        unit[target, target] = 1.0
        return -svec(unit)

    def _free_entries(self, n: int) -> list[tuple[int, int]]:
        """Entries (i <= j) of P that may be nonzero."""
        entries = upper_entries(n)
        if self.problem.adaptation is None:
            return entries
        return [(i, j) for i, j in entries if j < n - 1 or i == j]

    def _units(self) -> np.ndarray:
        """A symmetric matrix with ones in its place for each free entry of P."""
        units = np.zeros((len(self.entries), self.problem.n, self.problem.n))
        every = np.arange(len(units))
        rows, columns = np.array(self.entries).T
        units[every, rows, columns] = units[every, columns, rows] = 1.0
        return units

    def _columns(self, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """svec of the inequality for each variable: the part without alpha and its slope."""
        scaled, n, na = self._scaled, self.problem.n, self._na
        base = np.zeros((len(units) + sum(self.problem.counts), self._size, self._size))
        slope = np.zeros_like(base)
        of_P, of_lam = base[: len(units)], base[len(units) :][:na]
        through_M = units @ scaled.M
        of_P[:, :n, :n] = (through_M + through_M.transpose(0, 2, 1)) / 2
        of_P[:, :n, n:] = units @ np.hstack([scaled.Ua, scaled.Ub, scaled.Uy]) / 2
        slope[: len(units), :n, :n] = units / 2  # alpha/2 P
        no_P, no_nu, no_k = np.zeros((n, n)), np.zeros(self._nb), np.zeros(self._ny)
        for column, lam in zip(of_lam, np.eye(na), strict=True):
            column[:] = scaled.inequality(no_P, lam, no_nu, no_k, 0.0)
        alone = np.arange(n + na, self._size)  # each nu and k in its own place
        base[len(units) + na + np.arange(len(alone)), alone, alone] = -1.0
        return svec(base).T, svec(slope).T

    @property
    def slowest_pole(self) -> float:
        """Rate of the slowest pole of the error system, 1/s."""
        return 1 / self.scaling.time

    @cached_property
    def fastest(self) -> float:
        """Supremum of the alpha for which there may be a certificate, 1/s."""
        return fastest_rate(self.problem)

    def solve(self, alpha: float) -> Solution | None:
        """The solution of least bound with this decay rate (1/s); None if there is none."""
        point = self.point(alpha)
        return None if point is None else self.solution(point, alpha)

    def point(self, alpha: float) -> ProgramPoint | None:
        """The same with its dual, in scaled units."""
        numbers = self.numbers(alpha)
        if numbers is None:
            return None
        cost, matrix, _ = numbers
        cost /= cost.max() or 1.0  # the weight of the leakage can be any power of ten
        return self._call(cost, matrix)

    def numbers(self, alpha: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The c, G and h of min c . x with h - G x in the cones; None if it has no leakage."""
        leak = self.problem.leakage(alpha)
        if leak is None:
            return None
        matrix = self._base + self.scaling.rate(alpha) * self._slope
        return self.cost(leak), matrix, self._right

    def by_log_alpha(self, point: ProgramPoint, alpha: float) -> float:
        """Derivative of log bound^2 by log alpha at a point of this alpha, by its dual.

        With dDelta = z . dG x + dc . x; it holds where the dual is unique.
        """
        value = float(point.cost @ point.x)
        if not value > 0:
            return 0.0
        change = float(self.scaling.rate(alpha) * (point.z @ (self._slope @ point.x)))
        leak = self.problem.leakage(alpha)
        if leak:
            up, down = (self.problem.leakage(alpha * (1 + h)) for h in (ALPHA_STEP, -ALPHA_STEP))
            if up is None:
                return math.inf
            last = len(self.entries) - 1
            by_leak = float(point.x[last] * point.cost[last] / leak)
            change += by_leak * float(up - down) / (2 * ALPHA_STEP)
        return change / value - 1

    def lagrangian(self, point: ProgramPoint, alpha: float) -> Callable[[ErrorProblem], float]:
        """z . G x + c . x at a point, as another problem has it, but for what does not change.

        Its derivatives by numbers of the problem are those of the optimum.
        """
        P, (lam, nu, k) = self.parts(point.x)
        Z = point.z[: self._size * (self._size + 1) // 2]
        rate, last = self.scaling.rate(alpha), len(self.entries) - 1
        leak_unit = float(point.x[last] * point.cost[last] / (self.problem.leakage(alpha) or 1.0))

        def at(other: ErrorProblem) -> float:
            Q = self.scaling.applied(other).inequality(P, lam, nu, k, rate)
            leak = other.leakage(alpha)
            return math.inf if leak is None else float(Z @ svec(Q) + leak * leak_unit)

        return at

    def cost(self, leak: Any) -> np.ndarray:
        """What each variable costs."""
        cost = np.zeros(self._base.shape[1])
        cost[len(self.entries) + self._na :] = 1.0  # nu and k; the lam cost nothing
        if self.problem.adaptation is not None:
            cost[len(self.entries) - 1] = self.scaling.leak_cost(leak)
        return cost

    def solution(self, point: ProgramPoint, alpha: float) -> Solution:
        """A point in unscaled coordinates."""
        return self._unscaled(point.x, alpha, self.problem.leakage(alpha))

    def _call(self, cost: np.ndarray, matrix: np.ndarray) -> ProgramPoint | None:
        """Clarabel's minimiser of cost . x with right - matrix x in the cones, or None."""
        numbers = cost, matrix, self._right, self._cones
        result = _clarabel(*numbers, equilibrate=self.scaling.equilibrate)
        if result is None and not self.scaling.equilibrate:
            result = _clarabel(*numbers)
        if result is None:
            return None
        return ProgramPoint(np.array(result.x), np.array(result.z), cost)

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """The scaled P, and the multipliers lam, nu, k, of the program's variables."""
        n, count = self.problem.n, len(self.entries)
        P = np.zeros((n, n))
        for (i, j), value in zip(self.entries, x[:count], strict=True):
            P[i, j] = P[j, i] = value
        return P, np.split(x[count:], [self._na, self._na + self._nb])

    def _unscaled(self, x: np.ndarray, alpha: float, leak: Any) -> Solution:
        count = len(self.entries)
        P = self.scaling.unscaled_P(self.entries, x[:count], self.target)
        lam, nu, k = self.scaling.unscaled_multipliers(self.problem, x[count:], self.target)
        lam_unit = self.scaling.lam_units(self.problem, self.target)
        delta = float(nu.sum() + k.sum())
        if self.problem.adaptation is not None:
            delta += float(P[-1, -1] * leak)
        return Solution(alpha, P, lam, nu, k, delta, lam_unit)


def minimiser(
    cost: np.ndarray, matrix: np.ndarray, right: np.ndarray, size: int
) -> np.ndarray | None:
    """The x of least cost . x with right - matrix x, as a vector, positive semidefinite; or None.

    Parameters
    ----------
    cost, matrix, right : arrays
    size : int
        Of the semidefinite matrix.
    """
    result = _clarabel(cost, matrix, right, [clarabel.PSDTriangleConeT(size)])
    return None if result is None else np.array(result.x)


def _clarabel(
    cost: np.ndarray,
    matrix: np.ndarray,
    right: np.ndarray,
    cones: list[Any],
    *,
    equilibrate: bool = True,
) -> Any | None:
    """What Clarabel returns, if it is usable."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = MAX_ITERATIONS
    settings.equilibrate_enable = equilibrate
    columns = sparse.csc_matrix(matrix)
    solver = clarabel.DefaultSolver(_no_quadratic(len(cost)), cost, columns, right, cones, settings)
    result = solver.solve()
    usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    return result if result.status in usable else None


def fastest_rate(problem: ErrorProblem) -> float:
    """Supremum of the alpha for which there may be a certificate, 1/s."""
    rates = [-2.0 * float(np.linalg.eigvals(problem.M).real.max())]
    law = problem.adaptation
    if law is not None:
        rates.append(2 * law.gain_rate * law.leak_gain)
        if len(law.Gamma):
            rates.append(2 * law.leak_theta * float(np.linalg.eigvalsh(law.Gamma).min()))
    return min(rates)


class Bounded(Protocol):
    """What a program of this room returns."""

    @property
    def bound(self) -> float:
        """limsup |e_1| in floating point, not yet verified."""


_Found = TypeVar("_Found", bound=Bounded)
_Out = TypeVar("_Out", bound=Bounded, covariant=True)


class Program(Protocol[_Out]):
    """A program that is solved for one alpha at a time."""

    @property
    def fastest(self) -> float:
        """Supremum of the alpha for which there may be a certificate, 1/s."""

    def solve(self, alpha: float) -> _Out | None:
        """The solution of least bound with this decay rate (1/s); None if there is none."""


def best_solution(program: Program[_Found]) -> _Found | None:
    """The solution of least bound over alpha, None if there is none: a grid, then a refinement.

    Parameters
    ----------
    program : Program
    """
    if not program.fastest > 0:
        return None
    solutions: dict[float, _Found] = {}

    def bound(log_alpha: float) -> float:
        alpha = math.exp(log_alpha)
        solution = program.solve(alpha)
        if solution is None:
            return NO_BOUND
        solutions[alpha] = solution
        return solution.bound

    grid = np.log(program.fastest * ALPHA_GRID)
    values = [bound(v) for v in grid]
    i = int(np.argmin(values))
    if values[i] == NO_BOUND:
        return None
    low, high = grid[max(0, i - 1)], grid[min(len(grid) - 1, i + 1)]
    accuracy = {"xatol": ALPHA_ACCURACY}
    minimize_scalar(bound, bounds=(low, high), method="bounded", options=accuracy)
    return min(solutions.values(), key=lambda solution: solution.bound)


@lru_cache(maxsize=64)
def _no_quadratic(count: int) -> Any:
    """The quadratic cost of a program that has none."""
    return sparse.csc_matrix((count, count))
