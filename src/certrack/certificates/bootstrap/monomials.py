"""Polynomials as coefficients of monomials, in any arithmetic.

A monomial is the tuple of its exponents. Coefficients may be floats, rationals, or arrays that say
how a coefficient depends on the unknowns of a program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

Monomial = tuple[int, ...]
Polynomial = Mapping[Monomial, Any]


@lru_cache(maxsize=64)
def monomials(count: int, degree: int) -> tuple[Monomial, ...]:
    """All monomials of `count` variables up to a degree.

    By their degree, and for two variables within it a^2, a b, b^2.
    """
    chosen = (
        entries
        for total in range(degree + 1)
        for entries in combinations_with_replacement(range(count), total)
    )
    return tuple(tuple(entries.count(i) for i in range(count)) for entries in chosen)


def with_coefficients(coefficients: Sequence[Any], count: int, degree: int) -> Polynomial:
    """The polynomial of coefficients in the order of :func:`monomials`."""
    return dict(zip(monomials(count, degree), coefficients, strict=True))


def product_of(first: Monomial, second: Monomial) -> Monomial:
    """The product of two monomials."""
    return tuple(a + b for a, b in zip(first, second, strict=True))


def added(*terms: tuple[Any, Polynomial]) -> Polynomial:
    """The sum of numbers times polynomials."""
    total: dict[Monomial, Any] = {}
    for factor, polynomial in terms:
        for monomial, value in polynomial.items():
            part = factor * value
            total[monomial] = total[monomial] + part if monomial in total else part
    return total


def multiplied(known: Polynomial, other: Polynomial) -> Polynomial:
    """The product; zeros of `known` are left out."""
    total: dict[Monomial, Any] = {}
    for first, factor in known.items():
        if factor == 0:
            continue
        for second, value in other.items():
            monomial, part = product_of(first, second), factor * value
            total[monomial] = total[monomial] + part if monomial in total else part
    return total


def partial_derivative(polynomial: Polynomial, i: int) -> Polynomial:
    """By the i-th variable."""
    return {
        (*monomial[:i], monomial[i] - 1, *monomial[i + 1 :]): monomial[i] * value
        for monomial, value in polynomial.items()
        if monomial[i]
    }


def affine(row: Sequence[Any] | np.ndarray) -> Polynomial:
    """The polynomial row (zeta, 1); zeros are left out."""
    terms = zip(places(len(row) - 1), row, strict=True)
    return {monomial: value for monomial, value in terms if value != 0}


@lru_cache(maxsize=64)
def places(count: int) -> tuple[Monomial, ...]:
    """The monomials zeta_1 ... zeta_count and, last, 1."""
    rows = [tuple(int(i == j) for j in range(count)) for i in range(count)]
    return (*rows, (0,) * count)
