"""The best quadratic function on a box, by Clarabel: the smallest bounds of some rows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse

from certrack.certificates.bootstrap.forms import Corner, Forms
from certrack.certificates.bootstrap.inequality import (
    Unknowns,
    corner_form,
    multiplier_counts,
    shared_form,
    target_form,
)
from certrack.certificates.semidefinite import MAX_ITERATIONS

#: The largest entry of F in the program's unit of time.
LARGEST_RATE = 4.0


@dataclass(frozen=True)
class Minimiser:
    """The best function with some alpha, and what it bounds.

    Attributes
    ----------
    bounds, sizes : arrays
        sizes_j (W + bounds_j) is above row j.
    slope : float
        Derivative of the sum of the bounds, each in units of its row, by log alpha.
    unknowns : Unknowns
    """

    bounds: np.ndarray
    sizes: np.ndarray
    slope: float
    unknowns: Unknowns


class BootstrapProgram:
    """The program of one box, built once and solved for many rows and alpha.

    Parameters
    ----------
    forms : Forms
        In floats.
    targets : int
        Rows that one function bounds.
    """

    def __init__(self, forms: Forms, targets: int) -> None:
        self.targets = targets
        self._speed = max(np.abs(c.F).max() for c in forms.corners) / LARGEST_RATE
        self._relation = max(np.linalg.norm(c.relation) for c in forms.corners)
        scaled = (Corner(c.F / self._speed, c.relation / self._relation) for c in forms.corners)
        self.forms = forms = replace(forms, corners=tuple(scaled))
        size, width = forms.size, forms.width
        counts, kinds = multiplier_counts(forms), len(forms.products)
        self._entries = [(i, j) for j in range(size + 1) for i in range(j + 1)]
        free, signed = len(self._entries), sum(counts[:3])
        self._free, self._parts = free, np.cumsum(counts[:-1])
        self._count = free + sum(counts) + targets  # the bounds are the last
        units = [self._unknowns(row) for row in np.eye(self._count)]
        shared = [shared_form(forms, unit) for unit in units]
        self._slopes = np.array([self._padded(unit.G) for unit in units])
        blocks = [
            np.array(
                [s + corner_form(forms, corner, u) for s, u in zip(shared, units, strict=True)]
            )
            for corner in forms.corners
        ]
        zero = np.zeros(size + 1)
        above = [
            _vectors(
                -np.array([target_form(u.G, zero, v) for u, v in zip(units, last, strict=True)])
            )
            for last in np.eye(self._count)[-targets:]
        ]
        scales = [_vectors(-np.array([u.scale(i) for u in units])) for i in range(kinds)]
        signs = -np.eye(self._count)[free : free + signed]
        base = [_vectors(block) for block in blocks]
        slope = _vectors(self._slopes)
        self._base = sparse.csc_matrix(np.vstack([*base, *above, *scales, signs]))
        nothing = np.zeros((self._base.shape[0] - len(base) * len(slope), self._count))
        self._slope = sparse.csc_matrix(np.vstack([slope] * len(base) + [nothing]))
        self._right = np.zeros(self._base.shape[0])
        begin = len(base) * len(slope)
        self._target_rows = slice(begin, begin + targets * len(above[0]))
        self._cones = [clarabel.PSDTriangleConeT(width)] * len(blocks)
        self._cones += [clarabel.PSDTriangleConeT(size + 1)] * targets
        self._cones += [clarabel.PSDTriangleConeT(3)] * kinds + [clarabel.NonnegativeConeT(signed)]

    def solve(self, alpha: float, rows: np.ndarray) -> Minimiser | None:
        """The smallest bounds of rows (zeta, 1) with this decay rate; None if there are none.

        The bounds are of one function; their sum is minimised, each in units of its row.
        """
        sizes = np.linalg.norm(rows[:, :-1], axis=1)
        right = self._right.copy()
        zero = np.zeros((rows.shape[1], rows.shape[1]))
        forms = np.array([target_form(zero, row, 0.0) for row in rows / sizes[:, None]])
        right[self._target_rows] = _vectors(forms).T.reshape(-1)
        cost = np.zeros(self._count)
        cost[-self.targets :] = 1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = MAX_ITERATIONS
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix((self._count, self._count)),
            cost,
            sparse.csc_matrix(self._base + alpha / self._speed * self._slope),
            right,
            self._cones,
            settings,
        )
        result = solver.solve()
        usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        if result.status not in usable:
            return None
        x, z = np.array(result.x), np.array(result.z)
        slope = alpha / self._speed * float(z @ (self._slope @ x))
        scaled = vars(self._unknowns(x))
        values = {name: value * self._speed for name, value in scaled.items() if name != "G"}
        values |= {"alpha": alpha, "mu": values["mu"] / self._relation}
        return Minimiser(x[-self.targets :], sizes, slope, replace(self._unknowns(x), **values))

    def _unknowns(self, x: np.ndarray, alpha: float = 0.0) -> Unknowns:
        G = np.zeros((self.forms.size + 1, self.forms.size + 1))
        for (i, j), value in zip(self._entries, x[: self._free], strict=True):
            G[i, j] = G[j, i] = value
        squares, inputs, sectors, mu, scales, turns = np.split(
            x[self._free : -self.targets], self._parts
        )
        return Unknowns(alpha, G, squares, inputs, sectors, mu, scales, turns)

    def _padded(self, G: np.ndarray) -> np.ndarray:
        more = self.forms.width - len(G)
        return np.pad(G, ((0, more), (0, more)))


def _vectors(matrices: np.ndarray) -> np.ndarray:
    """Upper triangles as columns, in Clarabel's convention."""
    rows, columns = np.tril_indices(matrices.shape[1])
    entries: np.ndarray = matrices[:, columns, rows].copy()
    entries[:, rows != columns] *= math.sqrt(2)
    return entries.T
