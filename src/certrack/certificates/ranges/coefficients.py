"""The loop as a centre and one uncertain number for each function of the constants.

    (Acl | Ecl | o)(p) = N_0 + sum_k r_k(p) N_k,   r_k(p) = mid_k + rad_k delta_k,  |delta_k| <= 1

with different functions r_k, such as K_L/J_L: one constant in two entries is one delta. The middle
of its range goes into the centre, so nothing is lost where the range is not symmetric. N_k is a
sum of products of a column and a row: each is a channel p = delta_k q. A term within a sector,
bracket(p) s, is one function of them all: where the bracket is small, so is its delta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import flint
import numpy as np
import sympy

from certrack.certificates.arithmetic import rational
from certrack.certificates.ranges.loop import RangedLoop
from certrack.certificates.ranges.rational import Interval, RationalVector

#: Brackets whose polynomials are kept from one cell to the next.
KEPT_FUNCTIONS = 64


@dataclass(frozen=True)
class Channels:
    """x' = centre (x, Y', 1) + sum_k columns_k delta_k (rows_k (x, Y', 1)), |delta_k| <= 1.

    Attributes
    ----------
    centre : (n, n + q + 3) array of rationals
    columns : (n, K) array
        Scaled with the radii.
    rows : (K, n + q + 3) array
    """

    centre: np.ndarray
    columns: np.ndarray
    rows: np.ndarray


class Coefficients:
    """The functions of the constants in a loop, and their matrices."""

    def __init__(self, loop: RangedLoop) -> None:
        self.loop = loop
        matrices: dict[sympy.Expr, np.ndarray] = {}
        nothing = np.full(loop.still.shape, flint.fmpq(0), dtype=object)
        for i, j in np.ndindex(*loop.still.shape):
            for function, value in _parts(loop.still[i, j], loop.symbols):
                matrices.setdefault(function, nothing.copy())[i, j] += value
        self._fixed = matrices.pop(sympy.S.One, nothing)
        for j, term in loop.slopes:
            matrices[term] = nothing.copy()
            matrices[term][-1, j] += 1
        self.functions = list(matrices)
        self._matrices = list(matrices.values())
        self._factors = [_factors(matrix) for matrix in self._matrices]

    @cached_property
    def _ranges(self) -> list[RationalVector]:
        return [RationalVector.of([f], self.loop.symbols) for f in self.functions]

    def over(self, box: Sequence[Interval]) -> Channels:
        """Centre and channels over a box of the constants."""
        centre, columns, rows = self._fixed.copy(), [], []
        for ranges, matrix, (left, right) in zip(
            self._ranges, self._matrices, self._factors, strict=True
        ):
            low, high = (end[0] for end in ranges.ends(box))
            centre = centre + matrix * ((low + high) / 2)
            if high > low:
                columns += [column * ((high - low) / 2) for column in left.T]
                rows += list(right)
        n, width = centre.shape
        return Channels(
            centre,
            np.array(columns, dtype=object).reshape(len(columns), n).T,
            np.array(rows, dtype=object).reshape(len(rows), width),
        )


def largest_brackets(loop: RangedLoop, box: Sequence[Interval]) -> np.ndarray:
    """Largest magnitudes of the brackets over a box."""
    values = []
    for bracket in loop.brackets:
        low, high = (end[0] for end in _function(bracket, loop.symbols).ends(box))
        values.append(max(abs(low), abs(high)))
    return np.array(values, dtype=object)


@lru_cache(maxsize=KEPT_FUNCTIONS)
def _function(formula: sympy.Expr, symbols: tuple[sympy.Symbol, ...]) -> RationalVector:
    return RationalVector.of([formula], symbols)


def _parts(entry: sympy.Expr, symbols: Sequence[sympy.Symbol]) -> list[tuple[sympy.Expr, Any]]:
    """The entry as a sum of numbers times functions (with the coefficient 1) of the symbols.

    In lexicographic order of the exponents in the numerator, which a certificate file relies on.
    """
    if not entry.free_symbols:
        return [(sympy.S.One, rational(entry))] if entry != 0 else []
    top, bottom = sympy.fraction(sympy.cancel(sympy.together(entry)))
    factors = []
    for powers, number in sympy.Poly(top, *symbols).terms():
        term = number * sympy.Mul(*(s**k for s, k in zip(symbols, powers, strict=True)))
        value, function = sympy.cancel(term / bottom).as_independent(*symbols, as_Add=False)
        numerator, denominator = sympy.fraction(function)
        content, denominator = sympy.Poly(denominator, *symbols).primitive()
        function = numerator / denominator.as_expr()
        factors.append((function, rational(value) / rational(content)))
    return factors


def _factors(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows whose products sum to the matrix, as few as its rank."""
    exact = flint.fmpq_mat(matrix.tolist())
    reduced, rank = exact.rref()
    rows = np.array(reduced.tolist(), dtype=object)[:rank]
    pivots = [next(j for j, v in enumerate(row) if v != 0) for row in rows]
    return matrix[:, pivots], rows
