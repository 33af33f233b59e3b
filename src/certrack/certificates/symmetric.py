"""Symmetric matrices as vectors of their upper triangle."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np


def upper_entries(n: int) -> list[tuple[int, int]]:
    """The entries (i, j), i <= j, of a symmetric matrix, column by column."""
    return [(i, j) for j in range(n) for i in range(j + 1)]


def svec(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle, column by column, off-diagonals times sqrt 2 (Clarabel's convention).

    Of a matrix, or of each one of an array of them.
    """
    *count, size, _ = matrix.shape
    places, weights = _triangle(size)
    entries: np.ndarray = matrix.reshape(*count, -1)[..., places] * weights
    return entries


@lru_cache(maxsize=64)
def _triangle(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of the upper triangle's entries, column by column, and their weights in svec."""
    rows, columns = np.tril_indices(size)  # (j, i) of the upper triangle, by columns
    places, weights = columns * size + rows, np.where(rows == columns, 1.0, math.sqrt(2))
    places.flags.writeable = weights.flags.writeable = False
    return places, weights
