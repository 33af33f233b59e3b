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
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize_scalar

from certrack.certificates.problem import ErrorProblem

#: The alpha that are tried first, as parts of the fastest: 14 over three decades, a factor of 1.7
#: apart, and one near the end. The bound is flat in alpha but not unimodal at the edges; half as
#: many give the shipped systems the same bounds to seven digits.
ALPHA_GRID = np.append(np.geomspace(1e-3, 0.9, 14), 0.98)

#: log alpha is refined to this width: the bound is flat there, to about its square.
ALPHA_ACCURACY = 2e-3

#: What a search sees where there is no certificate: it cannot calculate with infinity.
NO_BOUND = 1e30

#: Clarabel needs 10 to 30 iterations; one that needs more does not converge.
MAX_ITERATIONS = 100

#: Part of the inputs' size that is added in every direction when the coordinates are scaled, so
#: that one which no input reaches gets a size, too; and the least square of a size.
SCALING_FLOOR, LEAST_SQUARE = 1e-6, 1e-300


@dataclass(frozen=True)
class Solution:
    """A point of the program, in unscaled coordinates."""

    alpha: float
    P: np.ndarray
    lam: np.ndarray
    nu: np.ndarray
    k: np.ndarray
    delta: float

    @property
    def bound(self) -> float:
        """limsup |e_1| in floating point, not yet verified."""
        return math.sqrt(max(0.0, 2 * self.delta / self.alpha))


class SemidefiniteProgram:
    """The semidefinite program of one :class:`ErrorProblem`, built once and solved for many alpha.

    Parameters
    ----------
    problem : ErrorProblem
        In floats.
    target : int
        Which e_i is to be bounded (from 0): P >= e_i e_i^T.
    scaling : (n,) array and float, optional
        Sizes of the e_i and of the a-inputs; natural ones if left out.

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
        scaling: tuple[np.ndarray, float] | None = None,
    ) -> None:
        self.problem, self.target = problem, target
        self._scale, self._reach = scaling or scaling_of(problem)
        self._scaled = rescaled(problem, self._scale, self._reach)
        n = problem.n
        self._na, self._nb, self._ny = problem.counts
        self.entries = self._free_entries(n)
        base, slope = self.inequality = self._columns()
        size = n + sum(problem.counts)
        self._size = size
        identity = np.eye(len(self.entries) + sum(problem.counts))
        unit = np.zeros((n, n))
        unit[target, target] = 1.0
        floor = np.zeros((n * (n + 1) // 2, len(identity)))
        for column, matrix in enumerate(self._units()):
            floor[:, column] = -svec(matrix)
        self.floor = floor, -svec(unit)
        multipliers = -identity[len(self.entries) :]
        self._base = np.vstack([base, floor, multipliers])
        self._slope = np.vstack([slope, np.zeros((len(floor) + len(multipliers), len(identity)))])
        self._right = np.concatenate(
            [np.zeros(size * (size + 1) // 2), -svec(unit), np.zeros(len(multipliers))]
        )
        self._cones = [clarabel.PSDTriangleConeT(size), clarabel.PSDTriangleConeT(n)]
        if len(multipliers):
            self._cones.append(clarabel.NonnegativeConeT(len(multipliers)))

    def _free_entries(self, n: int) -> list[tuple[int, int]]:
        """Entries (i <= j) of P that may be nonzero."""
        entries = [(i, j) for j in range(n) for i in range(j + 1)]
        if self.problem.adaptation is None:
            return entries
        return [(i, j) for i, j in entries if j < n - 1 or i == j]

    def _units(self) -> list[np.ndarray]:
        """A symmetric matrix with ones in its place for each free entry of P."""
        n, units = self.problem.n, []
        for i, j in self.entries:
            matrix = np.zeros((n, n))
            matrix[i, j] = matrix[j, i] = 1.0
            units.append(matrix)
        return units

    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        """svec of the inequality for each variable: the part without alpha and its slope."""
        na, nb, ny = self._na, self._nb, self._ny
        zero = np.zeros((self.problem.n, self.problem.n))
        lam, nu, k = (np.zeros(count) for count in (na, nb, ny))
        base, slope = [], []
        for matrix in self._units():
            first = self._scaled.inequality(matrix, lam, nu, k, 0.0)
            second = self._scaled.inequality(matrix, lam, nu, k, 1.0)
            base.append(svec(first))
            slope.append(svec(second - first))
        for group, count in enumerate((na, nb, ny)):
            for index in range(count):
                weights = (np.zeros(na), np.zeros(nb), np.zeros(ny))
                weights[group][index] = 1.0
                column = svec(self._scaled.inequality(zero, *weights, 0.0))
                base.append(column)
                slope.append(np.zeros_like(column))
        return np.array(base).T, np.array(slope).T

    @cached_property
    def fastest(self) -> float:
        """Supremum of the alpha for which there may be a certificate, 1/s."""
        rates = [-2.0 * float(np.linalg.eigvals(self.problem.M).real.max())]
        law = self.problem.adaptation
        if law is not None:
            rates.append(2 * law.gain_rate * law.leak_gain)
            if len(law.Gamma):
                rates.append(2 * law.leak_theta * float(np.linalg.eigvalsh(law.Gamma).min()))
        return min(rates)

    def solve(self, alpha: float) -> Solution | None:
        """The solution of least bound with this decay rate (1/s); None if there is none."""
        leak = self.problem.leakage(alpha)
        if leak is None:
            return None
        cost = np.zeros(self._base.shape[1])
        cost[len(self.entries) + self._na :] = 1.0  # nu and k; the lam cost nothing
        if self.problem.adaptation is not None:
            cost[len(self.entries) - 1] = leak / self._scale[-1] ** 2
        cost /= cost.max() or 1.0  # the weight of the leakage can be any power of ten
        variables = self._call(cost, self._base + alpha * self._slope)
        return None if variables is None else self._unscaled(variables, alpha, leak)

    def _call(self, cost: np.ndarray, matrix: np.ndarray) -> np.ndarray | None:
        """Clarabel's minimiser of cost . x with right - matrix x in the cones, or None."""
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = MAX_ITERATIONS
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix((len(cost), len(cost))),
            cost,
            sparse.csc_matrix(matrix),
            self._right,
            self._cones,
            settings,
        )
        result = solver.solve()
        usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        return np.array(result.x) if result.status in usable else None

    def _unscaled(self, x: np.ndarray, alpha: float, leak: Any) -> Solution:
        n, count = self.problem.n, len(self.entries)
        P = np.zeros((n, n))
        x = x * self._scale[self.target] ** 2
        for (i, j), value in zip(self.entries, x[:count], strict=True):
            P[i, j] = P[j, i] = value / (self._scale[i] * self._scale[j])
        lam, nu, k = np.split(np.maximum(x[count:], 0.0), [self._na, self._na + self._nb])
        lam = lam / self._reach**2
        delta = float(nu.sum() + k.sum())
        if self.problem.adaptation is not None:
            delta += float(P[-1, -1] * leak)
        return Solution(alpha, P, lam, nu, k, delta)


def best_solution(program: SemidefiniteProgram) -> Solution | None:
    """The solution of least bound over alpha, None if there is none: a grid, then a refinement."""
    if not program.fastest > 0:
        return None
    solutions: dict[float, Solution] = {}

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


def scaling_of(problem: ErrorProblem) -> tuple[np.ndarray, float]:
    """Sizes of the e_i and of the a-inputs by which a program is scaled."""
    scale = natural_scale(problem)
    return scale, float(np.linalg.norm(problem.Xe * scale)) or 1.0


def natural_scale(problem: ErrorProblem) -> np.ndarray:
    """Typical size of each e_i under unit inputs: root of the Gramian's diagonal."""
    inputs = np.hstack([problem.Ua, problem.Ub, problem.Uy])
    drive = inputs @ inputs.T
    if not np.isfinite(drive).all():
        raise OverflowError("the squares of the inputs overflow")
    weight = float(np.trace(drive)) or 1.0
    drive = drive + SCALING_FLOOR * weight * np.eye(problem.n)
    if np.linalg.eigvals(problem.M).real.max() >= 0:
        return np.ones(problem.n)
    gramian = solve_continuous_lyapunov(problem.M, -drive)
    size: np.ndarray = np.sqrt(np.maximum(np.diag(gramian), LEAST_SQUARE))
    return size


def rescaled(problem: ErrorProblem, scale: np.ndarray, reach: float) -> ErrorProblem:
    """The same problem in e_i = scale_i e^_i and a_k = reach a^_k, all of order one.

    A can have entries of 1e5; without this the solver sees nothing but the largest.
    """
    return replace(
        problem,
        M=problem.M / scale[:, None] * scale[None, :],
        Ua=problem.Ua * reach / scale[:, None],
        Ub=problem.Ub / scale[:, None],
        Uy=problem.Uy / scale[:, None],
        Xe=problem.Xe * scale[None, :] / reach,
        Xy=problem.Xy / reach,
        selections=tuple(
            None if part is None else (part[0], None if part[1] is None else part[1] / reach)
            for part in problem.selections
        ),
    )


def svec(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle, column by column, off-diagonals times sqrt 2 (Clarabel's convention)."""
    rows, columns = np.tril_indices(len(matrix))  # (j, i) of the upper triangle, by columns
    entries: np.ndarray = matrix[columns, rows].copy()
    entries[rows != columns] *= math.sqrt(2)
    return entries
