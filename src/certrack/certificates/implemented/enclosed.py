"""Floats that stand for balls, with what they may be off by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import flint
import numpy as np

#: What a float may be off by that was taken from the middle of a ball, relatively and absolutely,
#: and by how much a radius may be rounded down.
CONVERSION, SMALLEST_ROUNDING, RADIUS_ROUNDING = 2.0**-51, 1e-300, 1 + 1e-9

#: Unit roundoff of floats.
ROUNDOFF = 2.0**-53


@dataclass(frozen=True)
class Enclosed:
    """Numbers within `error` of `value`, entry by entry.

    Attributes
    ----------
    value, error : arrays of one shape
    """

    value: np.ndarray
    error: np.ndarray

    @classmethod
    def of(cls, balls: flint.arb_mat) -> Enclosed:
        """The entries of a ball matrix."""
        entries, shape = balls.entries(), (balls.nrows(), balls.ncols())
        value = np.array(list(map(float, entries)), dtype=float).reshape(shape)  # of the middles
        radius = np.array([float(v.rad()) for v in entries], dtype=float).reshape(shape)
        return cls(value, radius * RADIUS_ROUNDING + CONVERSION * np.abs(value) + SMALLEST_ROUNDING)

    @classmethod
    def of_blocks(cls, blocks: Sequence[flint.arb_mat], axis: int) -> Enclosed:
        """Ball matrices, one above the other (axis 0) or side by side (axis 1).

        Each radius counts as the sum of those of its row, which takes no number of its own: at the
        precision of the balls that is far below the rounding of a float.
        """
        parts = [_of_rows(block) for block in blocks]
        value, error = (np.concatenate(tables, axis=axis) for tables in zip(*parts, strict=True))
        return cls(value, error)

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the magnitudes."""
        return widened(np.abs(self.value) + self.error)


def _of_rows(balls: flint.arb_mat) -> tuple[np.ndarray, np.ndarray]:
    """The entries of a ball matrix, and what they are off by, with one radius for each row."""
    shape = balls.nrows(), balls.ncols()
    value = np.array(list(map(float, balls.entries())), dtype=float).reshape(shape)
    ones = flint.arb_mat(shape[1], 1, [1] * shape[1])
    radii = ((balls - balls.mid()) * ones).entries()
    radius = np.array([float(v.abs_upper()) for v in radii], dtype=float).reshape(-1, 1)
    off = radius * RADIUS_ROUNDING + CONVERSION * np.abs(value) + SMALLEST_ROUNDING
    return value, off


def widened(values: np.ndarray, roundings: int = 8) -> np.ndarray:
    """Not below the exact results of so many roundings of sums, products and quotients >= 0.

    Below about 2^-1022 a float has fewer digits, which the smallest addition makes good.
    """
    return values * (1 + 2 * (roundings + 4) * ROUNDOFF) + SMALLEST_ROUNDING
