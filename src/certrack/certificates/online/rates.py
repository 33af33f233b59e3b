"""Gains that move at a bounded speed: V = xi^T ((1 - w) P_0 + w P_1) xi/2 with |w'| <= rate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import clarabel
import flint
import numpy as np
from scipy import sparse

from certrack.certificates.arithmetic import positive_definite
from certrack.certificates.exact import (
    BACK_OFF,
    MULTIPLIER_FLOOR,
    Proof,
    decimal_text,
    from_text,
    root_up,
)
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scaling import Scaling
from certrack.certificates.semidefinite import MAX_ITERATIONS, SemidefiniteProgram
from certrack.certificates.symmetric import svec

#: Multipliers (lam, nu, k) of one end.
Multipliers = tuple[np.ndarray, np.ndarray, np.ndarray]


def rate_inequalities(
    problems: Sequence[ErrorProblem],
    P: Sequence[np.ndarray],
    multipliers: Sequence[Multipliers],
    alpha: Any,
    rate: Any,
) -> Iterator[np.ndarray]:
    """The matrices that must be negative definite: Q_00, Q_11 and Q_01 + Q_10 for both signs.

    Parameters
    ----------
    problems, P, multipliers : of both ends
    alpha : number, 1/s
    rate : number, 1/s
        The largest |w'|.
    """
    n = problems[0].n

    def Q(i: int, j: int, speed: Any) -> np.ndarray:
        form = problems[j].inequality(P[i], *multipliers[j], alpha)
        form[:n, :n] = form[:n, :n] + speed * (P[1] - P[0]) / 2
        return form

    for speed in (rate, -rate):
        yield Q(0, 0, speed)
        yield Q(1, 1, speed)
        yield Q(0, 1, speed) + Q(1, 0, speed)


@dataclass(frozen=True)
class RateSolution:
    """A point of the program, in unscaled coordinates, for both ends."""

    alpha: float
    P: tuple[np.ndarray, ...]
    multipliers: tuple[Multipliers, ...]
    lam_units: tuple[np.ndarray, ...]
    delta: float

    @property
    def bound(self) -> float:
        """limsup |e_1| in floating point, not yet verified."""
        return math.sqrt(max(0.0, 2 * self.delta / self.alpha))


class RateProgram:
    """The semidefinite program of two ends, solved for many alpha.

    Parameters
    ----------
    problems : ErrorProblem of both ends
        In floats.
    rate : float, 1/s
    """

    def __init__(self, problems: Sequence[ErrorProblem], rate: float) -> None:
        self.problems, self._rate = problems, rate
        self._scaling = Scaling.of(problems[0])
        self._scaled = [self._scaling.applied(problem) for problem in problems]
        self._parts = [SemidefiniteProgram(p, 0, self._scaling) for p in problems]
        self._entries = self._parts[0].entries
        self._counts = problems[0].counts
        zero = self._forms(np.zeros(self._size), 0.0)
        assert all(not form.any() for form in zero)
        self._base = self._columns(0.0)
        self._slope = self._columns(1.0) - self._base

    @property
    def _size(self) -> int:
        """Variables: P_0, P_1, the multipliers of both ends, then Delta."""
        return 2 * (len(self._entries) + sum(self._counts)) + 1

    @property
    def fastest(self) -> float:
        """Supremum of the alpha for which there may be a certificate, 1/s."""
        return min(part.fastest for part in self._parts)

    def _split(self, x: np.ndarray) -> tuple[list[np.ndarray], list[Multipliers]]:
        count, wide = len(self._entries), sum(self._counts)
        both = [
            self._parts[i].parts(
                np.concatenate(
                    [
                        x[i * count : (i + 1) * count],
                        x[2 * count + i * wide : 2 * count + (i + 1) * wide],
                    ]
                )
            )
            for i in (0, 1)
        ]
        return [P for P, _ in both], [(parts[0], parts[1], parts[2]) for _, parts in both]

    def _forms(self, x: np.ndarray, alpha: float) -> list[np.ndarray]:
        P, multipliers = self._split(x)
        speed = self._scaling.rate(self._rate)
        return list(rate_inequalities(self._scaled, P, multipliers, alpha, speed))

    def _columns(self, alpha: float) -> np.ndarray:
        """The inequalities, then P >= e_1 e_1^T, signs, and Delta above the cost of each end."""
        columns = []
        count, wide, na = len(self._entries), sum(self._counts), self._counts[0]
        for unit in np.eye(self._size):
            rows = [svec(form) for form in self._forms(unit, alpha)]
            P, _ = self._split(unit)
            rows += [-svec(matrix) for matrix in P]
            weights = unit[2 * count : 2 * count + 2 * wide].reshape(2, wide)
            rows += [-weights.ravel(), weights[:, na:].sum(axis=1) - unit[-1]]
            columns.append(np.concatenate(rows))
        return np.array(columns).T

    def solve(self, alpha: float) -> RateSolution | None:
        """The solution of least bound with this decay rate (1/s); None if there is none."""
        n, wide = self.problems[0].n, sum(self._counts)
        unit = np.zeros((n, n))
        unit[0, 0] = 1.0
        size = n + wide
        right = np.concatenate(
            [
                np.zeros(6 * (size * (size + 1) // 2)),
                -svec(unit),
                -svec(unit),
                np.zeros(2 * wide + 2),
            ]
        )
        cones = [
            *[clarabel.PSDTriangleConeT(size)] * 6,
            *[clarabel.PSDTriangleConeT(n)] * 2,
            clarabel.NonnegativeConeT(2 * wide + 2),
        ]
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter = False, MAX_ITERATIONS
        cost = np.zeros(self._size)
        cost[-1] = 1.0
        matrix = sparse.csc_matrix(self._base + self._scaling.rate(alpha) * self._slope)
        nothing = sparse.csc_matrix((self._size, self._size))
        result = clarabel.DefaultSolver(nothing, cost, matrix, right, cones, settings).solve()
        if result.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            return None
        return self._unscaled(np.array(result.x), alpha)

    def _unscaled(self, x: np.ndarray, alpha: float) -> RateSolution:
        scaling, count, wide = self._scaling, len(self._entries), sum(self._counts)
        P = [scaling.unscaled_P(self._entries, x[i * count : (i + 1) * count], 0) for i in (0, 1)]
        weights = x[2 * count : 2 * count + 2 * wide].reshape(2, wide)
        multipliers = [
            scaling.unscaled_multipliers(problem, row, 0)
            for problem, row in zip(self.problems, weights, strict=True)
        ]
        units = [scaling.lam_units(problem, 0) for problem in self.problems]
        delta = float(x[-1] * scaling.sizes[0] ** 2 / scaling.time)
        return RateSolution(alpha, tuple(P), tuple(multipliers), tuple(units), delta)


def prove_rates(
    problems: Sequence[ErrorProblem], solution: RateSolution, rate: Any
) -> tuple[Proof, ...] | None:
    """Round a solution so that exact arithmetic confirms it; None if it does not.

    Returns
    -------
    one Proof per end
        They share alpha and the bound.
    """
    for slack in BACK_OFF:
        scale, extra = 1 + slack, slack * solution.delta
        alpha = decimal_text(solution.alpha * (1 - slack))
        proofs = []
        for P, (lam, nu, k), unit in zip(
            solution.P, solution.multipliers, solution.lam_units, strict=True
        ):
            rows = tuple(tuple(decimal_text(v) for v in row) for row in scale * (P + P.T) / 2)
            least = MULTIPLIER_FLOOR * unit
            lams, nus, ks = (
                tuple(decimal_text(v) for v in group)
                for group in (lam * scale + least, nu * scale**2 + extra, k * scale**2 + extra)
            )
            proofs.append(Proof(alpha, rows, lams, nus, ks, "0"))
        square = squared_rate_bound(problems, proofs, rate)
        if square is not None:
            bound = root_up(square)
            return tuple(replace(proof, bound=bound) for proof in proofs)
    return None


def squared_rate_bound(problems: Sequence[ErrorProblem], proofs: Sequence[Proof], rate: Any) -> Any:
    """2 Delta/alpha as an exact rational, or None if a condition fails."""
    P, multipliers, alphas = [], [], []
    for problem, proof in zip(problems, proofs, strict=True):
        matrix = _matrix(proof.P)
        if matrix.shape != (problem.n, problem.n) or not (matrix == matrix.T).all():
            return None
        groups = [
            np.array([from_text(v) for v in group], dtype=object)
            for group in (proof.lam, proof.nu, proof.k)
        ]
        if tuple(map(len, groups)) != problem.counts or any(v < 0 for g in groups for v in g):
            return None
        floor = matrix.copy()
        floor[0, 0] -= 1
        if not positive_definite(floor):
            return None
        P.append(matrix)
        multipliers.append((groups[0], groups[1], groups[2]))
        alphas.append(from_text(proof.alpha))
    if alphas[0] != alphas[1] or not alphas[0] > 0:
        return None
    forms = rate_inequalities(problems, P, multipliers, alphas[0], rate)
    if not all(positive_definite(-form) for form in forms):
        return None
    costs = [sum(nu, flint.fmpq(0)) + sum(k, flint.fmpq(0)) for _, nu, k in multipliers]
    return 2 * max(costs) / alphas[0]


def _matrix(rows: Sequence[Sequence[str]]) -> np.ndarray:
    """A matrix of decimal texts; empty where they are none."""
    entries = [[from_text(v) for v in row] for row in rows]
    if any(len(row) != len(entries) for row in entries):
        return np.zeros((0, 0), dtype=object)
    return np.array(entries, dtype=object).reshape(len(entries), len(entries))
