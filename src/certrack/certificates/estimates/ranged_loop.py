"""The loop at the corners of the ranges of constants, in plant coordinates, for any gains.

The law knows the nominal constants, and at a corner p, with rho = g_n(p)/g_n(p_0), only

    x_n' = F_n(p) x + rho (nu_x x + nu_Y Y') + ...

depends on its gains. With xi = x - Pi Y, where no gain moves Pi = A^-1 B, the formulas of the
constants are evaluated once for all designs:

    xi' = M xi + (Ecl + (M Pi | 0) - (0 | Pi)) Y' + ...,      Y' = (y_d ... y_d^(q+1))
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.formulation import columns_of
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.ranges.cells import corners_of
from certrack.certificates.ranges.loop import RangedLoop
from certrack.certificates.ranges.rational import RationalVector
from certrack.laws.backstepping import ErrorCoordinates


@dataclass(frozen=True)
class CornerLoop:
    """The loops with one set of constants.

    Attributes
    ----------
    problem : ErrorProblem
        In plant coordinates; of some design.
    ratio : float
        rho.
    row : (n,) array
        F_n(p).
    Pi : (n, q + 1) array
    sizes : (q + 2,) array
        Bounds of y_d ... y_d^(q+1).
    """

    problem: ErrorProblem
    ratio: float
    row: np.ndarray
    Pi: np.ndarray
    sizes: np.ndarray

    def with_design(self, design: ErrorCoordinates) -> ErrorProblem:
        """The problem of another design."""
        return self.with_feedback(design.nu_x, design.nu_Y)

    def with_feedback(self, nu_x: np.ndarray, nu_Y: np.ndarray) -> ErrorProblem:
        """The problem of nu = nu_x x + nu_Y Y'."""
        M, Uy, count = self.problem.M.copy(), self.problem.Uy.copy(), len(self.sizes)
        M[-1] = self.row + self.ratio * nu_x
        Uy[-1, :count] = self._last_row(M[-1], self.ratio * nu_Y) * self.sizes
        return replace(self.problem, M=M, Uy=Uy)

    def _last_row(self, row: np.ndarray, from_Y: np.ndarray) -> np.ndarray:
        total = np.array(from_Y, dtype=float)
        total[:-1] += row @ self.Pi
        total[1:] -= self.Pi[-1]
        return total


def corner_loops(loop: RangedLoop) -> tuple[CornerLoop, ...]:
    """The loops at the corners of the ranges.

    Raises
    ------
    NoCertificate
        If a denominator vanishes there.
    """
    return tuple(_corner_loop(loop, corner) for corner in corners_of(loop.box))


def _corner_loop(loop: RangedLoop, corner: tuple[Any, ...]) -> CornerLoop:
    c, n, count = loop.coordinates, loop.n, loop.coordinates.q + 2
    point = [(value, value) for value in corner]
    matrix, brackets = loop.unpacked(loop.entries.points(point)[0])
    rho = RationalVector.of([loop.gain_ratio], loop.symbols).points(point)[0][0]
    Pi, sizes, inputs = loop.Xe @ c.B, np.array(loop.Y, dtype=object), loop.uncertain
    by_Y = matrix[:, n : n + count].copy()
    by_Y[:, :-1] = by_Y[:, :-1] + matrix[:, :n] @ Pi
    by_Y[:, 1:] = by_Y[:, 1:] - Pi
    last = np.zeros((n, len(brackets)), dtype=object)
    last[-1] = brackets * np.array(loop.sizes, dtype=object)
    Ua, Ub = columns_of(inputs.a, n), columns_of(inputs.b, n)
    problem = ErrorProblem(
        M=matrix[:, :n],
        Ua=loop.Xe @ Ua,
        Ub=np.hstack([loop.Xe @ Ub, last]),
        Uy=np.column_stack([by_Y * sizes, matrix[:, -1]]),
        Xe=np.eye(n),
        Xy=np.column_stack([Pi * sizes[:-1], np.zeros((n, 2))]),
        states=inputs.states,
        derivatives=tuple(range(count + 1)),
        adaptation=None,
        selections=inputs.selections,
    ).in_floats()
    row = matrix[-1, :n] - rho * c.nu_x
    return CornerLoop(problem, float(rho), *(v.astype(float) for v in (row, Pi, sizes)))
