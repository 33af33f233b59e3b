"""A point of the semidefinite program to nine digits: solved again in the units of its solution.

The solver's accuracy is one of its numbers. Where P has a condition of 1e3 and more, or multipliers
differ by as much, the point that it returns costs 1e-5 more than the least (at n = 6 a few per
cent), although its residuals and its gap are small, and the dual is worse. With P = T^-T T^-1 and
the multipliers w of that point, the coordinates e = T e~, and inputs over the roots of w, make the
same program one whose solution is about P~ = I, w~ = 1: a congruence of each of its matrices, and
a change of its variables. That is done until the solution is about its own centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from certrack.certificates.estimates.last_digits import (
    matrices,
    optimality_residual,
    vectors,
    with_last_digits,
)
from certrack.certificates.semidefinite import (
    MAX_ITERATIONS,
    ProgramPoint,
    SemidefiniteProgram,
)

#: Eigenvalues of P, and multipliers, count as no smaller than this part of the largest.
CENTRE_FLOOR = 1e-8

#: What the solver is asked for in these units; beyond, it stops for its roundings.
SOLVER_ACCURACY = 1e-10

#: A point counts whose optimality has no larger residual in these units. Where many P are optimal,
#: solutions wander over them from round to round, and in the units of one far out the solver stops
#: as solved at 1e3 and more, with a bound that is 5 % too large. Those that count have 1e-5.
LARGEST_RESIDUAL = 1.0

#: Rounds at most, and how far P~ may be from I after the last.
MOST_ROUNDS, NEAR_CENTRE = 3, 0.1


def recentred_point(program: SemidefiniteProgram, alpha: float) -> ProgramPoint | None:
    """The minimiser of a program and its dual, to what floats allow; None if there is none.

    Parameters
    ----------
    program : SemidefiniteProgram
    alpha : float, 1/s
    """
    point = program.point(alpha)
    return None if point is None else about_itself(program, point, alpha)


def about_itself(program: SemidefiniteProgram, point: ProgramPoint, alpha: float) -> ProgramPoint:
    """The same from a point, for the cost that it has; the last that is better than it."""
    for _ in range(MOST_ROUNDS):
        better = _Centre.of(program, point).solved(program, point, alpha)
        if better is None:
            break
        point, moved = better
        if moved < NEAR_CENTRE:
            break
    return point


@dataclass(frozen=True)
class _Centre:
    """Units in which a point is P = I and multipliers of one.

    Attributes
    ----------
    T : (n, n) array
        Of the coordinates of e, with T^T P T = I.
    weights : array
        The multipliers.
    """

    T: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, program: SemidefiniteProgram, point: ProgramPoint) -> _Centre:
        """Those of a point of a program; T has the zeros that P has by its structure."""
        P, multipliers = program.parts(point.x)
        weights = np.concatenate(multipliers)
        if program.problem.adaptation is None:
            T = inverse_root(P)
        else:
            T = np.zeros_like(P)
            T[:-1, :-1], T[-1:, -1:] = inverse_root(P[:-1, :-1]), inverse_root(P[-1:, -1:])
        least = CENTRE_FLOOR * weights.max(initial=np.finfo(float).tiny)
        return cls(T, np.maximum(weights, least))

    def solved(
        self, program: SemidefiniteProgram, point: ProgramPoint, alpha: float
    ) -> tuple[ProgramPoint, float] | None:
        """The program's solution, found in these units, and how far it is from the centre."""
        n, count = len(self.T), len(program.entries)
        R = np.diag(np.concatenate([np.ones(n), 1 / np.sqrt(self.weights)]))
        R[:n, :n] = self.T
        variables = self._variables(program.entries)
        base, slope = program.inequality
        columns, right = program.floor
        decay = (base + program.scaling.rate(alpha) * slope) @ variables
        floor = np.column_stack([columns @ variables, right])
        decay, floor = _congruent(decay, R), _congruent(floor, self.T)
        signs = np.eye(len(variables))[count:]
        matrix = np.vstack([decay, floor[:, :-1], -signs])
        ends = np.concatenate([np.zeros(len(decay)), floor[:, -1], np.zeros(len(signs))])
        cost = variables.T @ point.cost
        unit = float(np.abs(cost).max()) or 1.0
        result = _minimised(cost / unit, matrix, ends, (len(R), n, len(signs)))
        if result is None:
            return None
        x, z = result[0], result[1] * unit
        dual = np.concatenate(
            [
                _congruent(z[: len(decay), None], R.T)[:, 0],
                _congruent(z[len(decay) : len(matrix) - len(signs), None], self.T.T)[:, 0],
                z[len(matrix) - len(signs) :] / self.weights,
            ]
        )
        moved = max(abs(v - (i == j)) for (i, j), v in zip(program.entries, x[:count], strict=True))
        return ProgramPoint(variables @ x, dual, point.cost), float(moved)

    def _variables(self, entries: list[tuple[int, int]]) -> np.ndarray:
        """The program's variables, from those of the same program in these units."""
        back, count = np.linalg.inv(self.T), len(entries)
        matrix = np.diag(np.concatenate([np.zeros(count), self.weights]))
        units = np.zeros((count, *back.shape))
        for unit, (i, j) in zip(units, entries, strict=True):
            unit[i, j] = unit[j, i] = 1.0
        rows, columns = np.array(entries).T
        matrix[:count, :count] = (back.T @ units @ back)[:, rows, columns].T
        return matrix


def inverse_root(P: np.ndarray) -> np.ndarray:
    """T with T^T P T = I, as far as P is not below its floor."""
    values, vectors = np.linalg.eigh(P)
    least = CENTRE_FLOOR * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    return np.asarray(vectors / np.sqrt(np.maximum(values, least)))


def _congruent(columns: np.ndarray, R: np.ndarray) -> np.ndarray:
    """R^T Q R of each symmetric matrix Q, which are columns in Clarabel's convention."""
    return vectors(R.T @ matrices(columns, len(R)) @ R)


def _minimised(
    cost: np.ndarray, matrix: np.ndarray, right: np.ndarray, sizes: tuple[int, int, int]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Clarabel's x and z for the cones of these sizes, without units of its own; or None."""
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, MAX_ITERATIONS
    settings.equilibrate_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = SOLVER_ACCURACY
    cones = [clarabel.PSDTriangleConeT(sizes[0]), clarabel.PSDTriangleConeT(sizes[1])]
    if sizes[2]:
        cones.append(clarabel.NonnegativeConeT(sizes[2]))
    quadratic = sparse.csc_matrix((len(cost), len(cost)))
    columns = sparse.csc_matrix(matrix)
    result = clarabel.DefaultSolver(quadratic, cost, columns, right, cones, settings).solve()
    usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    if result.status not in usable:
        return None
    program = cost, matrix, right
    x, z = with_last_digits(program, sizes[:2], np.array(result.x), np.array(result.z))
    left = np.linalg.norm(optimality_residual(program, sizes[:2], x, z))
    return (x, z) if left <= LARGEST_RESIDUAL else None
