"""The best polynomial function on a box, by Clarabel: the smallest bound of one row."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from certrack.certificates.bootstrap.conditions import (
    Layout,
    Polynomials,
    SumOfSquares,
    sums_of_squares,
)
from certrack.certificates.bootstrap.forms import Corner, Forms
from certrack.certificates.bootstrap.gram import gram_pattern
from certrack.certificates.bootstrap.monomials import (
    affine,
    monomials,
    places,
    with_coefficients,
)
from certrack.certificates.bootstrap.program import LARGEST_RATE
from certrack.certificates.semidefinite import MAX_ITERATIONS
from certrack.certificates.symmetric import upper_entries

#: Below the smallest eigenvalue of every Gram matrix, so that its rounding leaves it definite.
MARGIN = 3e-6


@dataclass(frozen=True)
class PolynomialMinimiser:
    """A minimiser.

    Attributes
    ----------
    bounds : array
        scale (W + bounds_j) is above row j.
    scales : array
    slope : float
        Derivative of the sum of the bounds by log alpha.
    alpha : float, 1/s
    parts : arrays of coefficients, by the name of :class:`Polynomials`
    grams : arrays of the free entries of each Gram matrix
    """

    bounds: np.ndarray
    scales: np.ndarray
    slope: float
    alpha: float
    parts: dict[str, list[np.ndarray]]
    grams: list[np.ndarray]


class PolynomialProgram:
    """The program of one box, built once and solved for many rows and alpha.

    Parameters
    ----------
    forms : Forms
        In floats.
    layout : Layout
        Of the same forms in rationals.
    """

    def __init__(self, forms: Forms, layout: Layout) -> None:
        self.layout = layout
        self._speed = max(np.abs(c.F).max() for c in forms.corners) / LARGEST_RATE
        self._relation = max(np.linalg.norm(c.relation) for c in forms.corners)
        scaled = (Corner(c.F / self._speed, c.relation / self._relation) for c in forms.corners)
        forms = replace(forms, corners=tuple(scaled))
        self._sizes = [
            (name, len(monomials(layout.count, degree)), number, degree)
            for name, number, degree in layout.shapes
        ]
        shared = sum(length * number for _, length, number, _ in self._sizes) + layout.claims
        unknowns, bounds = self._unknowns(np.eye(shared))
        claims = [{places(layout.count)[-1]: bound} for bound in bounds]
        at_zero, at_one = (
            sums_of_squares(forms, layout, unknowns, alpha, claims) for alpha in (0.0, 1.0)
        )
        frees = np.cumsum([0] + [len(gram_pattern(c.basis).free) for c in at_zero]) + shared
        self._count, self._frees = int(frees[-1]), frees
        blocks = [
            _gram_block(condition, int(first), shared, self._count)
            for condition, first in zip(at_zero, frees[:-1], strict=True)
        ]
        more = [
            _gram_block(one, 0, shared, self._count, with_free=False)
            - _gram_block(zero, 0, shared, self._count, with_free=False)
            for one, zero in zip(at_one, at_zero, strict=True)
        ]
        self._base, self._slope = (sparse.csc_matrix(sparse.vstack(p)) for p in (blocks, more))
        self._margin = np.concatenate([_vector_of_unit(len(c.basis)) for c in at_zero])
        self._cones = [clarabel.PSDTriangleConeT(len(c.basis)) for c in at_zero]
        lengths = [len(upper_entries(len(c.basis))) for c in at_zero]
        begins = np.cumsum([0, *lengths])
        self._claim_begins = [int(v) for v in begins[-1 - layout.claims : -1]]
        self._claim_pattern = gram_pattern(at_zero[-1].basis)
        self._conditions = len(at_zero)

    def solve(self, alpha: float, rows: np.ndarray) -> PolynomialMinimiser | None:
        """The smallest bounds of rows (variables, 1); None if there are none."""
        scales = np.linalg.norm(rows[:, :-1], axis=1)
        right = -MARGIN * self._margin
        for begin, row in zip(self._claim_begins, rows / scales[:, None], strict=True):
            for monomial, value in affine(row).items():
                entry, times = self._claim_pattern.first[monomial]
                right[begin + entry] -= value / times * (1.0 if times == 1 else math.sqrt(2))
        cost = np.zeros(self._count)
        shared = int(self._frees[0])
        cost[shared - len(rows) : shared] = 1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = MAX_ITERATIONS
        matrix = -(self._base + alpha / self._speed * self._slope)
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix((self._count, self._count)),
            cost,
            sparse.csc_matrix(matrix),
            right,
            self._cones,
            settings,
        )
        result = solver.solve()
        if result.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            return None
        x, z = np.array(result.x), np.array(result.z)
        slope = -alpha / self._speed * float(z @ (self._slope @ x))
        return self._in_units(x, alpha, scales, slope)

    def _in_units(
        self, x: np.ndarray, alpha: float, scales: np.ndarray, slope: float
    ) -> PolynomialMinimiser:
        """In the units of the loop."""
        parts, bounds = self._split(x[: self._frees[0]])
        for name in ("mu", "squares", "inputs", "sectors", "majorants"):
            parts[name] = [self._speed * value for value in parts[name]]
        parts["mu"] = [value / self._relation for value in parts["mu"]]
        grams = np.split(x, self._frees)[1:-1]
        claims, holds = self.layout.claims, self.layout.claims * self.layout.sectors
        multipliers = 2 * self.layout.squares + self.layout.sectors
        still = {*range(multipliers, multipliers + holds)}
        still |= {*range(self._conditions - claims, self._conditions)}
        grams = [g if i in still else self._speed * g for i, g in enumerate(grams)]
        return PolynomialMinimiser(bounds, scales, slope, alpha, parts, grams)

    def _split(self, values: np.ndarray) -> tuple[dict[str, list[Any]], np.ndarray]:
        parts, at = {}, 0
        for name, length, number, _ in self._sizes:
            parts[name] = [values[at + i * length : at + (i + 1) * length] for i in range(number)]
            at += number * length
        return parts, values[at:]

    def _unknowns(self, unit: np.ndarray) -> tuple[Polynomials, np.ndarray]:
        """Polynomials whose coefficients are rows of `unit`."""
        parts, bounds = self._split(unit)
        degrees = {name: degree for name, _, _, degree in self._sizes}
        built = {
            name: tuple(with_coefficients(v, self.layout.count, degrees[name]) for v in values)
            for name, values in parts.items()
        }
        return Polynomials(**built), bounds


def _gram_block(
    condition: SumOfSquares, first: int, shared: int, count: int, *, with_free: bool = True
) -> sparse.csr_matrix:
    """The vector of the Gram matrix as a linear function of the unknowns."""
    pattern = gram_pattern(condition.basis)
    length = len(upper_entries(pattern.size))
    dense = np.zeros((length, shared))
    for monomial, value in condition.polynomial.items():
        if np.any(value):
            entry, times = pattern.first[monomial]
            dense[entry] = value / times
    matrix = sparse.lil_matrix((length, count))
    rows, columns = np.nonzero(dense)
    matrix = sparse.coo_matrix((dense[rows, columns], (rows, columns)), (length, count))
    if with_free:
        entries = []
        for i, (entry, times, monomial) in enumerate(pattern.free):
            other, less = pattern.first[monomial]
            entries += [(1.0, entry, first + i), (-times / less, other, first + i)]
        if entries:
            values, at, to = zip(*entries, strict=True)
            matrix = matrix + sparse.coo_matrix((values, (at, to)), (length, count))
    scale = [1.0 if i == j else math.sqrt(2) for i, j in upper_entries(pattern.size)]
    return sparse.csr_matrix(sparse.diags(scale) @ matrix)


def _vector_of_unit(size: int) -> np.ndarray:
    return np.array([float(i == j) for i, j in upper_entries(size)])
