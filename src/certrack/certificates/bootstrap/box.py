"""What a stage of the bootstrap stands on: a box of the errors, and the ranges of formulas on it.

The box bounds the n + r + 1 errors and, last, one more row: the part of ubar that is linear in
them. All numbers are decimal texts, for they are part of the proof, and exact rationals otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.bootstrap.loop import AdaptiveLoop
from certrack.certificates.exact import from_text

TextPair = tuple[str, str]


@dataclass(frozen=True)
class Region:
    """The box and the ranges, as decimal texts.

    Attributes
    ----------
    box : pairs
        Of e_1 ... e_n, theta_tilde, d: intervals that contain them after some time.
    middle : r texts
        phi_m, values in the middle of the regressor's.
    slope : n texts
        k of h = k x + remainder.
    row : pair
        Of (nu_x - k) Xe e + phi_m^T theta_tilde.
    regressor : r pairs
        Of phi_i.
    drift : pair
        Of h - k x.
    remainder : pair
        Of h - k x + phi^T theta - (phi - phi_m)^T theta_tilde.
    reach : texts
        Bounds of ||S_k x|| of each a-input.
    """

    box: tuple[TextPair, ...]
    middle: tuple[str, ...]
    slope: tuple[str, ...]
    row: TextPair
    regressor: tuple[TextPair, ...]
    drift: TextPair
    remainder: TextPair
    reach: tuple[str, ...]

    def numbers(self) -> RegionNumbers:
        """The same in exact rationals."""
        return RegionNumbers(
            box=_intervals_of(self.box),
            middle=_numbers_of(self.middle),
            slope=_numbers_of(self.slope),
            row=_intervals_of((self.row,))[0],
            regressor=_intervals_of(self.regressor),
            drift=_intervals_of((self.drift,))[0],
            remainder=_intervals_of((self.remainder,))[0],
            reach=_numbers_of(self.reach),
        )


@dataclass(frozen=True)
class RegionNumbers:
    """A :class:`Region` in numbers, exact or floats; intervals are rows of arrays."""

    box: np.ndarray
    middle: np.ndarray
    slope: np.ndarray
    row: np.ndarray
    regressor: np.ndarray
    drift: np.ndarray
    remainder: np.ndarray
    reach: np.ndarray

    def in_floats(self) -> RegionNumbers:
        """The nearest floats."""
        return RegionNumbers(
            **{name: value.astype(float) for name, value in vars(self).items()},
        )

    def linear_row(self, loop: AdaptiveLoop) -> np.ndarray:
        """(nu_x - k) Xe on e, phi_m on theta_tilde, 0 on d."""
        first = (loop.nu_x - self.slope) @ loop.Xe
        return np.concatenate([first, self.middle, [0 * first[0]]])

    def ubar(self, loop: AdaptiveLoop) -> tuple[Any, Any]:
        """Bounds of ubar: the row, what y_d adds, and the remainder."""
        through = [(loop.nu_x - self.slope) @ loop.AB[:, i] for i in range(len(loop.Y) - 1)]
        through.append(0 * loop.Y[-1])
        spread = sum(abs(a + b) * y for a, b, y in zip(through, loop.nu_Y, loop.Y, strict=True))
        return self.row[0] - spread - self.remainder[1], self.row[1] + spread - self.remainder[0]


def _numbers_of(texts: tuple[str, ...]) -> np.ndarray:
    return np.array([from_text(text) for text in texts], dtype=object)


def _intervals_of(texts: tuple[TextPair, ...]) -> np.ndarray:
    rows = [[from_text(low), from_text(high)] for low, high in texts]
    return np.array(rows, dtype=object).reshape(len(rows), 2)


def interval_of(row: np.ndarray, box: np.ndarray) -> tuple[Any, Any]:
    """The interval of a linear function on a box."""
    zero = flint.fmpq(0)
    low = sum((c * box[i, 0 if c > 0 else 1] for i, c in enumerate(row)), zero)
    return low, sum((c * box[i, 1 if c > 0 else 0] for i, c in enumerate(row)), zero)
