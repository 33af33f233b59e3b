"""Gram matrices: p = m^T Q m with Q > 0 is a sum of squares, for a vector m of monomials.

Several pairs (i, j) have the same product m_i m_j. The entry of the first one, column by column, is
what makes the identity hold; the others are free. So nothing needs to be rounded to satisfy an
equation: whatever the free entries are, the identity is exact, and only Q > 0 is to be shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from certrack.certificates.bootstrap.monomials import Monomial, Polynomial, product_of
from certrack.certificates.symmetric import upper_entries


@dataclass(frozen=True)
class GramPattern:
    """Which entries of the upper triangle, column by column, make which monomial.

    Attributes
    ----------
    size : int
    first : monomial -> (entry, how often it counts)
    free : tuples (entry, how often it counts, its monomial)
    """

    size: int
    first: dict[Monomial, tuple[int, int]]
    free: tuple[tuple[int, int, Monomial], ...]


@lru_cache(maxsize=64)
def gram_pattern(basis: tuple[Monomial, ...]) -> GramPattern:
    """The pattern of a vector of monomials."""
    first: dict[Monomial, tuple[int, int]] = {}
    free = []
    for entry, (i, j) in enumerate(upper_entries(len(basis))):
        monomial, times = product_of(basis[i], basis[j]), 1 if i == j else 2
        if monomial in first:
            free.append((entry, times, monomial))
        else:
            first[monomial] = (entry, times)
    return GramPattern(len(basis), first, tuple(free))


def gram_matrix(
    polynomial: Polynomial, basis: tuple[Monomial, ...], free: Sequence[Any]
) -> np.ndarray | None:
    """The exact Q with these free entries; None if a monomial is no product of two of the basis."""
    pattern = gram_pattern(basis)
    remaining = {monomial: 0 * value for monomial in pattern.first for value in free[:1]}
    remaining |= {monomial: value for monomial, value in polynomial.items() if value != 0}
    if not remaining.keys() <= pattern.first.keys():
        return None
    zero = next((0 * value for value in (*free, *remaining.values())), 0)
    values = [zero] * len(upper_entries(pattern.size))
    for value, (entry, times, monomial) in zip(free, pattern.free, strict=True):
        values[entry] = value
        remaining[monomial] = remaining[monomial] - times * value
    for monomial, value in remaining.items():
        entry, times = pattern.first[monomial]
        values[entry] = value / times
    matrix = np.full((pattern.size, pattern.size), zero, dtype=object)
    for value, (i, j) in zip(values, upper_entries(pattern.size), strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix
