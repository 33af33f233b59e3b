"""Semidefinite programs for the energy and the peak of the input, in floats.

    energy   V' + u^2 <= sum nu b^2 + sum k y^2,  P >= 0,     least V(0) + T (sum nu + sum k m)
    peak     V' <= -alpha V + Delta,  P >= row^T row,         least t >= V(0), Delta/alpha

with m_i the mean square of y_i. The ultimate input is the peak without V(0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from certrack.certificates.input_problem import InputProblem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scaling import Scaling
from certrack.certificates.semidefinite import MAX_ITERATIONS
from certrack.certificates.symmetric import svec, upper_entries

#: The units of e grow with the start by this power of its size in them.
START_POWER = 0.75


@dataclass(frozen=True)
class InputSolution:
    """P and multipliers in the units of the problem; alpha is 0 for the energy."""

    alpha: float
    P: np.ndarray
    lam: np.ndarray
    nu: np.ndarray
    k: np.ndarray
    value: float


class InputProgram:
    """The programs of one input.

    Parameters
    ----------
    problem : InputProblem
        In floats.
    starts : arrays e(0)
        None for the long run.
    """

    def __init__(self, problem: InputProblem, starts: Sequence[np.ndarray] = ()) -> None:
        self._input, inner = problem, problem.problem
        scaling = Scaling.of(inner)
        if len(starts):
            far = max(float(np.linalg.norm(e / scaling.sizes)) for e in starts)
            scaling = Scaling(scaling.time, scaling.sizes * max(1.0, far) ** START_POWER)
        self._scaling, self._scaled = scaling, scaling.applied(inner)
        n, self._counts = inner.n, inner.counts
        self._entries = upper_entries(n)
        self._row = problem.over_all.copy()
        self._row[:n] *= scaling.sizes
        self._unit = float(np.linalg.norm(self._row)) or 1.0
        self._row /= self._unit
        self._starts = [np.asarray(e) / scaling.sizes for e in starts]
        self._base = self._columns(0.0)
        self._slope = self._columns(1.0) - self._base

    def energy(self, duration: float, shares: np.ndarray) -> InputSolution | None:
        """Least V(0) + duration (sum nu + sum shares k), the larger V(0) of all starts."""
        time, wide = self._scaling.time, len(self._entries)
        na, nb, _ = self._counts
        cost = np.zeros(self._base.shape[1] + 1)
        cost[wide + na : wide + na + nb] = duration / time
        cost[wide + na + nb : -1] = duration / time * shares
        cost[-1] = 1.0
        n = len(self._row) - sum(self._counts)
        forced = svec(time * np.outer(self._row, self._row))
        return self._solve(0.0, cost, -forced, np.zeros(n * (n + 1) // 2), self._above_starts())

    def peak(self, alpha: float) -> InputSolution | None:
        """Least t >= V(0) and Delta/alpha."""
        wide, (na, _, _) = len(self._entries), self._counts
        cost = np.zeros(self._base.shape[1] + 1)
        cost[-1] = 1.0
        over = np.zeros(len(cost))
        over[wide + na : -1] = 1.0 / self._scaling.rate(alpha)
        over[-1] = -1.0
        n = len(self._row) - sum(self._counts)
        floor = np.outer(self._row[:n], self._row[:n])
        size = len(self._row)
        none = np.zeros(size * (size + 1) // 2)
        return self._solve(alpha, cost, none, -svec(floor), [over, *self._above_starts()])

    def _above_starts(self) -> list[np.ndarray]:
        """Rows of V(0) - t <= 0."""
        rows = []
        for e in self._starts:
            row = np.zeros(self._base.shape[1] + 1)
            for column, (i, j) in enumerate(self._entries):
                row[column] = e[i] * e[j] * (0.5 if i == j else 1.0)
            row[-1] = -1.0
            rows.append(row)
        return rows

    def _columns(self, alpha: float) -> np.ndarray:
        """svec of the inequality for each variable."""
        count = len(self._entries) + sum(self._counts)
        columns = []
        for unit in np.eye(count):
            P, (lam, nu, k) = self._parts(unit)
            columns.append(svec(self._scaled.inequality(P, lam, nu, k, alpha)))
        return np.array(columns).T

    def _parts(self, x: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        n, wide, (na, nb, _) = self._scaled.n, len(self._entries), self._counts
        P = np.zeros((n, n))
        for (i, j), value in zip(self._entries, x[:wide], strict=True):
            P[i, j] = P[j, i] = value
        return P, np.split(x[wide:], [na, na + nb])

    def _solve(
        self,
        alpha: float,
        cost: np.ndarray,
        right: np.ndarray,
        floor: np.ndarray,
        rows: Sequence[np.ndarray],
    ) -> InputSolution | None:
        """The minimiser with the inequality below `right` and P above minus `floor`."""
        problem, wide, count = self._scaled, len(self._entries), len(cost)
        main = np.hstack(
            [self._base + self._scaling.rate(alpha) * self._slope, np.zeros((len(right), 1))]
        )
        P_rows = np.zeros((len(floor), count))
        for column, (i, j) in enumerate(self._entries):
            matrix = np.zeros((problem.n, problem.n))
            matrix[i, j] = matrix[j, i] = 1.0
            P_rows[:, column] = -svec(matrix)
        signs = -np.eye(count)[wide:]
        linear = np.vstack([signs, *[row[None] for row in rows]])
        matrix = sparse.csc_matrix(np.vstack([main, P_rows, linear]))
        limits = np.concatenate([right, floor, np.zeros(len(linear))])
        size = len(self._row)
        cones = [
            clarabel.PSDTriangleConeT(size),
            clarabel.PSDTriangleConeT(problem.n),
            clarabel.NonnegativeConeT(len(linear)),
        ]
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter = False, MAX_ITERATIONS
        nothing = sparse.csc_matrix((count, count))
        result = clarabel.DefaultSolver(nothing, cost, matrix, limits, cones, settings).solve()
        if result.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            return None
        return self._unscaled(np.array(result.x), alpha, self._input.problem)

    def _unscaled(self, x: np.ndarray, alpha: float, problem: ErrorProblem) -> InputSolution:
        scaling, wide = self._scaling, len(self._entries)
        factor = (self._unit / scaling.sizes[0]) ** 2
        P = factor * scaling.unscaled_P(self._entries, x[:wide], 0)
        lam, nu, k = scaling.unscaled_multipliers(problem, x[wide:-1], 0)
        value = float(x[-1]) * self._unit**2
        return InputSolution(alpha, P, factor * lam, factor * nu, factor * k, value)
