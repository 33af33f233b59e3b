"""F of the fixed point in floats, and its derivative: for searches; nothing is proven by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import flint
import numpy as np

from certrack.certificates.implemented.drive import UncertainBound
from certrack.certificates.implemented.growing import GrowingBound

#: Relative step of the differences of a bound of w that is a formula.
FORMULA_STEP = 1e-6


@dataclass(frozen=True)
class FloatImage:
    """F(v), v = (X, U): per row, what the inputs' bounds are multiplied with.

    Attributes
    ----------
    outputs : int of each row
    constant : (rows,) array
    by_w : (rows, columns of W) array
    by_v : (rows, m + 1) array
    uncertain : one UncertainBound per column of W
    """

    outputs: np.ndarray
    constant: np.ndarray
    by_w: np.ndarray
    by_v: np.ndarray
    uncertain: Sequence[UncertainBound]

    def values(self, v: np.ndarray) -> np.ndarray:
        """Of all rows."""
        values: np.ndarray = self.constant + self.by_w @ self._sizes(v) + self.by_v @ v
        return values

    def largest_rows(self, v: np.ndarray) -> np.ndarray:
        """For e_1, the states, u and its steps the row with the largest value."""
        values = self.values(v)
        rows = (np.flatnonzero(self.outputs == k) for k in range(len(v) + 2))
        return np.array([these[np.argmax(values[these])] for these in rows])

    def derivative(self, v: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Of the values of some rows by v."""
        total = self.by_v[rows].copy()
        total[:, :-1] += self.by_w[rows] @ self._slopes(v[:-1])
        return total

    def _sizes(self, v: np.ndarray) -> np.ndarray:
        X, (gamma, beta, weights, Delta) = v[:-1], self._numbers
        norm = np.linalg.norm(weights * X, axis=1)
        size = gamma * norm + Delta @ X + beta
        for j, bound in self._growing:
            size[j] = bound.largest_float(X.tolist(), float(norm[j]))
        return size

    def _slopes(self, X: np.ndarray) -> np.ndarray:
        """Of the sizes by X."""
        gamma, _, weights, Delta = self._numbers
        norm = np.linalg.norm(weights * X, axis=1)
        slopes: np.ndarray = Delta + (gamma / np.where(norm > 0, norm, 1.0))[:, None] * (
            weights**2 * X
        )
        for j, bound in self._growing:
            for i, step in enumerate(FORMULA_STEP * X):
                ends = (X + sign * step * (np.arange(len(X)) == i) for sign in (1, -1))
                high, low = (
                    bound.largest_float(end.tolist(), float(np.linalg.norm(weights[j] * end)))
                    for end in ends
                )
                slopes[j, i] = (high - low) / (2 * step) if step else 0.0
        return slopes

    @cached_property
    def _growing(self) -> list[tuple[int, GrowingBound]]:
        entries = ((j, bound.growing) for j, bound in enumerate(self.uncertain))
        return [(j, growing) for j, growing in entries if growing is not None]

    @cached_property
    def _numbers(self) -> tuple[np.ndarray, ...]:
        """gamma, beta, the diagonals of S, and Delta."""
        m = self.by_v.shape[1] - 1
        gamma, beta = (floats([getattr(b, k) for b in self.uncertain]) for k in ("gamma", "beta"))
        weights = floats([b.weights for b in self.uncertain]).reshape(-1, m)
        return gamma, beta, weights, floats([b.Delta for b in self.uncertain]).reshape(-1, m)


def floats(values: Any) -> np.ndarray:
    """Nearest floats of balls or rationals."""
    array = np.array(values, dtype=object)
    flat = [float(v.mid()) if isinstance(v, flint.arb) else float(v) for v in array.ravel()]
    return np.array(flat, dtype=float).reshape(array.shape)
