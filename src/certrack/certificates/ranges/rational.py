"""Rational functions of the ranged constants, and exact hulls of their values over a box.

A vector T(p) = N(p)/D(p) of rational functions with one denominator is, with the Bernstein
polynomials b_I >= 0, sum b_I = 1, of the box,

    T = sum_I b_I N_I / sum_I b_I D_I = sum_I (b_I D_I / D) (N_I/D_I)

so where all the coefficients D_I have one sign, T(box) lies in the hull of the points N_I/D_I. For
constants that enter as p or as 1/p these are the values at the corners; where p and 1/p occur
together, the third point is where the end tangents of the arc meet. For higher degrees the hull is
larger than T(box), and shrinks to it with the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import flint
import numpy as np
import sympy

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate

#: Points of a hull: more take too long to prove.
MAX_HULL_POINTS = 256

#: Exact interval of a constant.
Interval = tuple[Any, Any]


@dataclass(frozen=True)
class RationalVector:
    """A vector of rational functions with one denominator.

    Attributes
    ----------
    symbols : m symbols
    numerators : (count, d_1 + 1, ..., d_m + 1) array of rationals
        Coefficients of the powers.
    denominator : (d_1 + 1, ..., d_m + 1) array of rationals
    """

    symbols: tuple[sympy.Symbol, ...]
    numerators: np.ndarray
    denominator: np.ndarray

    @classmethod
    def of(cls, entries: Sequence[sympy.Expr], symbols: Sequence[sympy.Symbol]) -> RationalVector:
        """The vector of some formulas.

        Raises
        ------
        NoCertificate
            If one of them is no rational function of the symbols.
        """
        symbols = tuple(symbols)
        fractions = [sympy.fraction(sympy.cancel(sympy.together(entry))) for entry in entries]
        common: sympy.Expr = sympy.S.One
        for _, denominator in fractions:
            common = sympy.lcm(common, denominator)
        tops = [sympy.cancel(top * (common / bottom)) for top, bottom in fractions]
        if not symbols:
            bottom = rational(common)
            values = [rational(top) / bottom for top in tops]
            return cls((), np.array(values, dtype=object), np.array(flint.fmpq(1), dtype=object))
        polynomials = [_polynomial(part, symbols) for part in (*tops, common)]
        degrees = [max(p.degree(s) for p in polynomials if not p.is_zero) for s in symbols]
        tensors = [_tensor(p, degrees) for p in polynomials]
        return cls(symbols, np.array(tensors[:-1], dtype=object), tensors[-1])

    @cached_property
    def count(self) -> int:
        """Number of points of a hull."""
        return math.prod(self.denominator.shape)

    def points(self, box: Sequence[Interval]) -> list[np.ndarray]:
        """Points whose hull contains the values over a box.

        Raises
        ------
        NoCertificate
            If a denominator may vanish on the box, or there are too many points.
        """
        if self.count > MAX_HULL_POINTS:
            raise NoCertificate(
                f"{len(self.symbols)} ranges have a hull of {self.count} points, more than "
                f"{MAX_HULL_POINTS}; leave some of them out"
            )
        numerators, denominator = self.numerators, self.denominator
        for axis, (low, high) in enumerate(box):
            change = _bernstein(denominator.shape[axis] - 1, low, high)
            change = change if low < high else change[:1]  # a value alone: all points are one
            denominator = _along(change, denominator, axis)
            numerators = _along(change, numerators, axis + 1)
        bottom = denominator.ravel()
        if not (all(v > 0 for v in bottom) or all(v < 0 for v in bottom)):
            raise NoCertificate("a denominator of the loop may vanish in plant.ranges; narrow them")
        table = numerators.reshape(len(numerators), -1)
        return [table[:, i] / bottom[i] for i in range(len(bottom))]

    def ends(self, box: Sequence[Interval]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of every entry over a box."""
        points = np.array(self.points(box), dtype=object)
        return points.min(axis=0), points.max(axis=0)

    def at(self, point: Sequence[Any]) -> np.ndarray:
        """Exact values at one point."""
        numerators, denominator = self.numerators, self.denominator
        for value in point:
            powers = [value**d for d in range(denominator.shape[0])]
            denominator = np.tensordot(powers, denominator, axes=(0, 0))
            numerators = np.tensordot(numerators, powers, axes=(1, 0))
        bottom = np.asarray(denominator, dtype=object).item()
        if bottom == 0:
            raise NoCertificate("a denominator of the loop vanishes in plant.ranges; narrow them")
        return numerators / bottom


def _polynomial(expr: sympy.Expr, symbols: tuple[sympy.Symbol, ...]) -> sympy.Poly:
    try:
        polynomial = sympy.Poly(expr, *symbols, domain="QQ")
    except sympy.PolynomialError:
        raise NoCertificate(
            f"{expr} is no rational function of the constants with a range"
        ) from None
    return polynomial


def _tensor(polynomial: sympy.Poly, degrees: Sequence[int]) -> np.ndarray:
    tensor = np.empty([d + 1 for d in degrees], dtype=object)
    tensor[...] = flint.fmpq(0)
    for powers, value in polynomial.terms():
        tensor[powers] = rational(value)
    return tensor


def _bernstein(degree: int, low: Any, high: Any) -> np.ndarray:
    """Bernstein coefficients (rows) on [low, high] of the powers 1, p ... p^degree (columns)."""
    change = np.empty((degree + 1, degree + 1), dtype=object)
    for i, j in product(range(degree + 1), repeat=2):
        total = flint.fmpq(0)
        for k in range(max(0, i + j - degree), min(i, j) + 1):
            total += math.comb(i, k) * math.comb(degree - i, j - k) * high**k * low ** (j - k)
        change[i, j] = total / math.comb(degree, j)
    return change


def _along(change: np.ndarray, tensor: np.ndarray, axis: int) -> np.ndarray:
    """A matrix applied along one axis."""
    moved = np.tensordot(change, tensor, axes=(1, axis))
    return np.moveaxis(moved, 0, axis)
