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
from scipy.linalg import lapack, schur
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
#: that one which no input reaches gets a size, too.
SCALING_FLOOR = 1e-6

#: Steps that find the sizes, and by which factor the last may still change them among each other:
#: a step reaches sizes that differ by 1e3.
SCALING_STEPS, SCALED_ENOUGH = 20, 1.5

#: A scaled input below this is none for the solver, whose accuracy is 1e-8.
NEGLIGIBLE = 1e-14

#: So many bits the solver gets of a number, about 12 digits: the program of a system in other
#: units is then the same one, and not one that differs in what the solver's noise grows from.
KEPT_BITS = 42

#: How much larger than the geometric mean of two rates a scaled coupling may be.
COUPLING = 2.0


@dataclass(frozen=True)
class Solution:
    """A point of the program, in unscaled coordinates.

    `lam_unit` is what a lam of 1 in the scaled ones is here.
    """

    alpha: float
    P: np.ndarray
    lam: np.ndarray
    nu: np.ndarray
    k: np.ndarray
    delta: float
    lam_unit: float = 1.0

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
    """

    def __init__(self, problem: ErrorProblem, target: int = 0) -> None:
        self.problem, self.target = problem, target
        self._time = _natural_time(problem)
        timed = _timed(problem, self._time)
        self._scale = _natural_scale(timed)
        self._reach = _reach(problem, self._scale) or 1.0
        self._scaled = _rescaled(timed, self._scale, self._reach)
        n = problem.n
        self._na, self._nb, self._ny = problem.counts
        self._entries = self._free_entries(n)
        base, slope = self._columns()
        size = n + sum(problem.counts)
        self._size = size
        identity = np.eye(len(self._entries) + sum(problem.counts))
        unit = np.zeros((n, n))
        unit[target, target] = 1.0
        floor = np.zeros((n * (n + 1) // 2, len(identity)))
        for column, matrix in enumerate(self._units()):
            floor[:, column] = -_svec(matrix)
        multipliers = -identity[len(self._entries) :]
        self._base = np.vstack([base, floor, multipliers])
        self._slope = np.vstack([slope, np.zeros((len(floor) + len(multipliers), len(identity)))])
        self._right = np.concatenate(
            [np.zeros(size * (size + 1) // 2), -_svec(unit), np.zeros(len(multipliers))]
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
        for i, j in self._entries:
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
            base.append(_svec(first))
            slope.append(_svec(second - first))
        for group, count in enumerate((na, nb, ny)):
            for index in range(count):
                weights = (np.zeros(na), np.zeros(nb), np.zeros(ny))
                weights[group][index] = 1.0
                column = _svec(self._scaled.inequality(zero, *weights, 0.0))
                base.append(column)
                slope.append(np.zeros_like(column))
        return np.array(base).T, np.array(slope).T

    @property
    def slowest_pole(self) -> float:
        """Rate of the slowest pole of the error system, 1/s."""
        return 1 / self._time

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
        cost[len(self._entries) + self._na :] = 1.0  # nu and k; the lam cost nothing
        if self.problem.adaptation is not None:
            cost[len(self._entries) - 1] = _rounded(leak * self._time / self._scale[-1] ** 2)
        cost /= cost.max() or 1.0  # the weight of the leakage can be any power of ten
        variables = self._call(cost, self._base + _rounded(alpha * self._time) * self._slope)
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
        n, count = self.problem.n, len(self._entries)
        P = np.zeros((n, n))
        x = x * self._scale[self.target] ** 2
        for (i, j), value in zip(self._entries, x[:count], strict=True):
            P[i, j] = P[j, i] = value / (self._scale[i] * self._scale[j])
        multipliers = np.maximum(x[count:], 0.0) / self._time
        lam, nu, k = np.split(multipliers, [self._na, self._na + self._nb])
        lam = lam / self._reach**2
        lam_unit = self._scale[self.target] ** 2 / (self._reach**2 * self._time)
        delta = float(nu.sum() + k.sum())
        if self.problem.adaptation is not None:
            delta += float(P[-1, -1] * leak)
        return Solution(alpha, P, lam, nu, k, delta, float(lam_unit))


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


def _natural_time(problem: ErrorProblem) -> float:
    """Time in which the slowest pole of the error system decays: the unit that is calculated in."""
    slowest = -float(np.linalg.eigvals(problem.M).real.max())
    return 1 / slowest if slowest > 0 else 1.0


def _timed(problem: ErrorProblem, unit: float) -> ErrorProblem:
    """The same problem with rates per `unit` seconds; the estimates' part is scaled as a number."""
    rates = {name: getattr(problem, name) * unit for name in ("M", "Ua", "Ub", "Uy")}
    return replace(problem, **rates)


def _natural_scale(problem: ErrorProblem) -> np.ndarray:
    """Typical size of each e_i under inputs of full size: root of the Gramian's diagonal.

    How large the a-inputs are, which are bounded by ||x||, shows from the size that the others give
    to x; where there are no others, any size will do.
    """
    bounded = np.hstack([problem.Ub, problem.Uy])
    size = _size_under(problem, bounded) if bounded.any() else np.zeros(problem.n)
    reach = _reach(problem, size) or 1.0
    return _size_under(problem, np.hstack([bounded, problem.Ua * reach]))


def _reach(problem: ErrorProblem, scale: np.ndarray) -> float:
    """Typical ||x|| where the e_i have these sizes and the y_i are 1."""
    return math.hypot(float(np.linalg.norm(problem.Xe * scale)), float(np.linalg.norm(problem.Xy)))


def _size_under(problem: ErrorProblem, inputs: np.ndarray) -> np.ndarray:
    """The sizes, found step by step in units of the last ones.

    In one step an e_i that is 1e8 times smaller than another would drown in the roundings.
    """
    size = np.ones(problem.n)
    if np.linalg.eigvals(problem.M).real.max() >= 0:
        return size
    for _ in range(SCALING_STEPS):
        rates, drive = problem.M / size[:, None] * size, inputs / size[:, None]
        drive = drive @ drive.T
        if not np.isfinite(drive).all():
            raise OverflowError("the squares of the inputs overflow")
        weight = float(np.trace(drive)) or 1.0
        gramian = _gramian_diagonal(rates, drive + SCALING_FLOOR * weight * np.eye(problem.n))
        if not (np.isfinite(gramian).all() and gramian.min() > 0):
            break
        change = np.sqrt(gramian)
        size = _not_slaved(problem.M, size * change)
        if change.max() < SCALED_ENOUGH * change.min():
            break
    return size


def _gramian_diagonal(M: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Diagonal of the solution X of M X + X M^T = -drive, by the real Schur form."""
    form, basis = schur(M)
    solution, scale, _ = lapack.dtrsyl(form, form, -basis.T @ drive @ basis, tranb="T")
    diagonal: np.ndarray = np.diag(basis @ solution @ basis.T) * scale
    return diagonal


def _not_slaved(M: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The sizes, raised where an e_i only follows another: P, which is near one, must damp both.

    Their coupling must not be much larger than the geometric mean of their rates; where it is so
    in any unit, nothing helps, and their sizes are made equal.
    """
    rates = np.abs(np.diag(M))
    coupling = np.abs(M - np.diag(np.diag(M)))
    limit = np.maximum(COUPLING * np.sqrt(np.outer(rates, rates)), coupling)
    ratio = np.where(coupling > 0, coupling / np.where(limit > 0, limit, 1.0), 0.0)
    for _ in range(len(size)):
        size = np.maximum(size, (ratio * size).max(axis=1))
    return size


def _rescaled(problem: ErrorProblem, scale: np.ndarray, reach: float) -> ErrorProblem:
    """The same problem in e_i = scale_i e^_i and a_k = reach a^_k, all of order one.

    A can have entries of 1e5; without this the solver sees nothing but the largest. Inputs that
    are lost in its roundings are left out, and the last digits of all numbers: they depend on the
    units. The exact proof has them, and room for them.
    """
    numbers = {
        "M": problem.M / scale[:, None] * scale[None, :],
        "Ua": problem.Ua * reach / scale[:, None],
        "Ub": problem.Ub / scale[:, None],
        "Uy": problem.Uy / scale[:, None],
        "Xe": problem.Xe * scale[None, :] / reach,
        "Xy": problem.Xy / reach,
    }
    numbers = {name: _rounded(values) for name, values in numbers.items()}
    for name in ("Ua", "Ub", "Uy", "Xy"):
        numbers[name] = np.where(np.abs(numbers[name]) < NEGLIGIBLE, 0.0, numbers[name])
    return replace(problem, **numbers)


def _rounded(values: Any) -> np.ndarray:
    """The numbers without their last bits."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2.0**KEPT_BITS) / 2.0**KEPT_BITS, exponent)


def _svec(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle, column by column, off-diagonals times sqrt 2 (Clarabel's convention)."""
    rows, columns = np.tril_indices(len(matrix))  # (j, i) of the upper triangle, by columns
    entries: np.ndarray = matrix[columns, rows].copy()
    entries[rows != columns] *= math.sqrt(2)
    return entries
