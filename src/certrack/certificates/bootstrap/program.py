"""The best quadratic function on a box, by Clarabel: the smallest bound of one row."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from certrack.certificates.bootstrap.forms import Forms
from certrack.certificates.bootstrap.inequality import (
    Unknowns,
    corner_form,
    shared_form,
    target_form,
)
from certrack.certificates.semidefinite import MAX_ITERATIONS


@dataclass(frozen=True)
class Found:
    """A minimiser.

    Attributes
    ----------
    bound : float
        Of the row.
    slope : float
        Derivative of the bound by log alpha.
    unknowns : Unknowns
    """

    bound: float
    slope: float
    unknowns: Unknowns


class BootstrapProgram:
    """The program of one box, built once and solved for many rows and alpha.

    Parameters
    ----------
    forms : Forms
        In floats.
    """

    def __init__(self, forms: Forms) -> None:
        self.forms = forms
        size, width = forms.size, forms.width
        self._counts = (len(forms.squares), width - size - 1, len(forms.sectors))
        self._entries = [(i, j) for j in range(size + 1) for i in range(j + 1)]
        free, signed = len(self._entries), sum(self._counts)
        self._free, self._count = free, free + signed + width + 1  # the bound is the last
        units = [self._unknowns(row) for row in np.eye(self._count)]
        shared = [shared_form(forms, unit) for unit in units]
        self._slopes = np.array([self._padded(unit.G) for unit in units])
        blocks = [
            np.array([s + corner_form(forms, corner, u) for s, u in zip(shared, units, strict=True)])
            for corner in forms.corners
        ]
        zero = np.zeros(size + 1)
        target = np.array(
            [target_form(u.G, zero, b[-1]) for u, b in zip(units, np.eye(self._count), strict=True)]
        )
        signs = -np.eye(self._count)[free : free + signed]
        base = [_vectors(block) for block in blocks]
        slope = _vectors(self._slopes)
        self._base = sparse.csc_matrix(np.vstack([*base, -_vectors(target), signs]))
        rest = np.zeros((self._base.shape[0] - len(base) * len(slope), self._count))
        self._slope = sparse.csc_matrix(np.vstack([slope] * len(base) + [rest]))
        self._right = np.zeros(self._base.shape[0])
        begin = len(base) * len(slope)
        self._target_rows = slice(begin, begin + len(target[0]) * (len(target[0]) + 1) // 2)
        self._cones = [clarabel.PSDTriangleConeT(width)] * len(blocks)
        self._cones += [clarabel.PSDTriangleConeT(size + 1), clarabel.NonnegativeConeT(signed)]

    def solve(self, alpha: float, row: np.ndarray) -> Found | None:
        """The smallest bound of row (zeta, 1) with this decay rate; None if there is none."""
        right = self._right.copy()
        zero = np.zeros((len(row), len(row)))
        right[self._target_rows] = _vectors(target_form(zero, row, 0.0)[None])[:, 0]
        cost = np.zeros(self._count)
        cost[-1] = 1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = MAX_ITERATIONS
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix((self._count, self._count)),
            cost,
            sparse.csc_matrix(self._base + alpha * self._slope),
            right,
            self._cones,
            settings,
        )
        result = solver.solve()
        usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        if result.status not in usable:
            return None
        x, z = np.array(result.x), np.array(result.z)
        slope = alpha * float(z @ (self._slope @ x))
        return Found(float(x[-1]), slope, self._unknowns(x, alpha))

    def _unknowns(self, x: np.ndarray, alpha: float = 0.0) -> Unknowns:
        G = np.zeros((self.forms.size + 1, self.forms.size + 1))
        for (i, j), value in zip(self._entries, x[: self._free], strict=True):
            G[i, j] = G[j, i] = value
        ends = self._free + np.cumsum(self._counts)
        squares, inputs, sectors, mu = np.split(x[self._free : -1], ends - self._free)
        return Unknowns(alpha, G, squares, inputs, sectors, mu)

    def _padded(self, G: np.ndarray) -> np.ndarray:
        more = self.forms.width - len(G)
        return np.pad(G, ((0, more), (0, more)))


def _vectors(matrices: np.ndarray) -> np.ndarray:
    """Upper triangles as columns, in Clarabel's convention."""
    rows, columns = np.tril_indices(matrices.shape[1])
    entries: np.ndarray = matrices[:, columns, rows].copy()
    entries[:, rows != columns] *= math.sqrt(2)
    return entries.T
