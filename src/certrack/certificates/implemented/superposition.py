"""What the errors of sensors do to the loop, apart from what moves slowly.

Errors of sensors and converter move the input, and with it x', but x only little. So a w_k that is
as fast as the states is not as fast as x' if it is a function of them, but for a small part. Let

    w_k = s_k(t, x) + f_k,    |f_k| <= fast_k,    |s_k(t, x)| <= b_k(|x|) - fast_k,
    |s_k(t, x) - s_k(t', x')| <= rate_k |t - t'| + sum_j Delta_rate_kj |x_j - x'_j|

for all t and x (if for those in a box only, that x keeps, then for s_k(t, Px) with the nearest
point Px of the box). The loop is linear in all that acts, so x = x_s + x_f. On x_s acts the
reference, s_k(t, x_s), and of other terms the slow part as it is; it is the whole of what begins at
x(0). On x_f acts the rest: errors of sensors and converter, f_k, terms of unknown rate, and

    |s_k(t, x) - s_k(t, x_s)| <= min(sum_j Delta_rate_kj |x_f,j|, b_k(|x|) + b_k(|x_s|) - 2 fast_k).

Each part has an F as the whole has in :mod:`.fixed_point`, for it is driven in the same loop: F_s,
in which the sizes of other terms are those at X of the whole, is homogeneous but for a constant,
and F_f is no larger at f v than f F_f(v), f >= 1. So v > F(v) proves limsup |x_s| <= X_s and
limsup |x_f| <= X_f as there. X is above F_s(X), and X + X_s above F_f(X + X_s): from there the
search goes down. Then w_k = s_k(t, x_s) + rest with

    |s_k(t, x_s)| <= b_k(X_s) - fast_k,  rate at most rate_k + sum_j Delta_rate_kj |x_s,j'|,
    |rest| <= fast_k + min(...),

in the place of a w_k whose rate is that of x. Terms with jumps keep theirs: they may jump at other
times on x_s than on x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text
from certrack.certificates.implemented.drive import UncertainBound
from certrack.certificates.implemented.fixed_point import (
    FIXED_POINT_MARGIN,
    SMALLEST_BOUND,
    OutputBounds,
    uncertain_size,
)

#: Steps of the search down, and by how much a step must lower a bound to be worth another.
MOST_STEPS_DOWN, WORTH_A_STEP = 40, 1e-4

#: Digits of the bounds in a file.
SPLIT_DIGITS = 13

#: Bounds of the states, and of the input behind them.
PartBounds = list[Any]


@dataclass(frozen=True)
class TwoParts:
    """w in two parts: |slow| <= size, |slow'| <= speed, |the other| <= remainder."""

    size: Any
    speed: Any
    remainder: Any


def is_split(bound: UncertainBound) -> bool:
    """Whether a slow part is taken for a function of the states."""
    slow = bound.slow
    return slow is not None and any(slow.by_states) and slow.dwell is None


def speed_of(bound: UncertainBound, rates: Sequence[Any]) -> Any:
    """Bound of the slow part's rate, where |x'| <= rates."""
    slow = bound.slow
    assert slow is not None
    by_states = zip(slow.by_states, rates, strict=False)
    return sum((flint.arb(c) * v for c, v in by_states), flint.arb(slow.rate))


def speeds_of_states(bounds: OutputBounds, values: np.ndarray, sizes: Sequence[Any]) -> list[Any]:
    """Bounds of |x_i'|: of the rows of x_i' - W_i w, and |W_i| |w|."""
    drive, n = bounds.drive, bounds.drive.n
    rates = []
    for i, row in enumerate(bounds.largest(values, range(n + 3, 2 * n + 3))):
        direct = sum((abs(drive.W[i, j]) * size for j, size in enumerate(sizes)), flint.arb(0))
        rates.append(flint.arb((row + direct).upper()))
    return rates


@dataclass(frozen=True)
class SplitLoop:
    """F_s and F_f of the module's text, where the whole loop is within X.

    Attributes
    ----------
    bounds : OutputBounds
        With the rows of x'.
    X : n balls
    sensors, others : (rows,) arrays of balls
        The rows' constant parts: by the errors of sensors and converter, and the others.
    """

    bounds: OutputBounds
    X: Sequence[Any]
    sensors: np.ndarray
    others: np.ndarray

    @classmethod
    def of(cls, bounds: OutputBounds, X: Sequence[Any]) -> SplitLoop:
        """Of a loop that is bounded."""
        drive, gains = bounds.drive, bounds.gains
        each = np.hstack([gains.noise, gains.step[:, None]])
        errors = np.array([*drive.mu, drive.eta], dtype=object)
        sensors = np.vectorize(flint.arb, otypes=[object])(each) @ errors
        return cls(bounds, list(X), sensors, bounds.constant - sensors)

    def of_slow(self, v: PartBounds) -> list[Any]:
        """Bounds of what acts on x_s of each w, where |x_s| and |u_s| are within v."""
        sizes = []
        for bound in self.bounds.drive.uncertain:
            at = v[:-1] if is_split(bound) else self.X
            slow = bound.slow
            sizes.append(flint.arb(0) if slow is None else uncertain_size(bound, at) - slow.fast)
        return sizes

    def of_fast(self, slow: PartBounds, v: PartBounds) -> list[Any]:
        """Bounds of what acts on x_f of each w, where the parts are within `slow` and v."""
        sizes = []
        for bound, of_slow in zip(self.bounds.drive.uncertain, self.of_slow(slow), strict=True):
            if bound.slow is None:
                size = uncertain_size(bound, self.X)
            elif is_split(bound):
                moved = zip(bound.slow.by_states, v[:-1], strict=False)
                by_states = sum((flint.arb(c) * x for c, x in moved), flint.arb(bound.slow.fast))
                both = uncertain_size(bound, self.X) + of_slow
                size = min(flint.arb(by_states.upper()), flint.arb(both.upper()))
            else:
                size = flint.arb(bound.slow.fast)
            sizes.append(size)
        return sizes

    def slow_image(self, v: PartBounds) -> PartBounds:
        """F_s."""
        return self._image(self.others, self.of_slow(v), v)

    def fast_image(self, slow: PartBounds, v: PartBounds) -> PartBounds:
        """F_f."""
        return self._image(self.sensors, self.of_fast(slow, v), v)

    def _image(self, constant: np.ndarray, sizes: Sequence[Any], v: PartBounds) -> PartBounds:
        values = self.bounds.values(constant, sizes, v[:-1], v[-1])
        return self.bounds.largest(values, range(1, self.bounds.drive.n + 2))

    def parts(self, slow: PartBounds, fast: PartBounds) -> dict[int, TwoParts]:
        """Each w that is split, in its two parts."""
        drive, of_slow = self.bounds.drive, self.of_slow(slow)
        values = self.bounds.values(self.others, of_slow, slow[:-1], slow[-1])
        rates = speeds_of_states(self.bounds, values, of_slow)
        of_fast = self.of_fast(slow, fast)
        return {
            j: TwoParts(of_slow[j], speed_of(bound, rates), of_fast[j])
            for j, bound in enumerate(drive.uncertain)
            if is_split(bound)
        }


def _may_split(bounds: OutputBounds) -> bool:
    """Whether a term is split, and none has a formula for its bound, which may grow too fast."""
    uncertain = bounds.drive.uncertain
    return any(map(is_split, uncertain)) and all(bound.growing is None for bound in uncertain)


def split_from(
    bounds: OutputBounds, X: Sequence[Any], texts: Sequence[Sequence[str]]
) -> dict[int, TwoParts]:
    """Each w that is split, in its two parts, from the bounds of both in a file.

    Raises
    ------
    NoCertificate
        If there is nothing to split, or v > F(v) does not hold for one of them.
    """
    drive = bounds.drive
    if not _may_split(bounds):
        raise NoCertificate("the proof splits the loop where no term is a function of the states")
    if len(texts) != 2 or any(len(entries) != drive.n + 1 for entries in texts):
        raise NoCertificate("split must have two bounds of all states and of the input")
    slow, fast = ([flint.arb(from_text(text)) for text in entries] for entries in texts)
    if any(v < 0 for v in (*slow, *fast)):
        raise NoCertificate("a bound of a part of the loop is negative")
    loop = SplitLoop.of(bounds, X)
    for v, image in ((slow, loop.slow_image(slow)), (fast, loop.fast_image(slow, fast))):
        if not all(entry > value for entry, value in zip(v, image, strict=True)):
            raise NoCertificate("a bound of a part of the loop is not above what follows from all")
    return loop.parts(slow, fast)


def search_split(bounds: OutputBounds, X: Sequence[Any], U: Any) -> tuple[tuple[str, ...], ...]:
    """Bounds of both parts for :func:`split_from`, down from those of the whole; or none."""
    if not _may_split(bounds):
        return ()
    loop, unsplit = SplitLoop.of(bounds, X), [flint.arb(v) for v in (*X, U)]
    slow = _down(loop.slow_image, unsplit)
    both = [a + b for a, b in zip(unsplit, slow, strict=True)]
    fast = _down(lambda v: loop.fast_image(slow, v), both)
    return tuple(tuple(f"{float(v):.{SPLIT_DIGITS}g}" for v in part) for part in (slow, fast))


def _down(image: Any, v: PartBounds) -> PartBounds:
    """F(v), F(F(v)) ... with a margin each: v stays above F(v) as long as it falls."""
    for _ in range(MOST_STEPS_DOWN):
        widened = (float(value) * (1 + FIXED_POINT_MARGIN) + SMALLEST_BOUND for value in image(v))
        after = [flint.arb(float(f"{value:.{SPLIT_DIGITS}g}")) for value in widened]
        if not all(a <= b for a, b in zip(after, v, strict=True)):
            break
        worth = any(a < b * (1 - WORTH_A_STEP) for a, b in zip(after, v, strict=True))
        v = after
        if not worth:
            break
    return v
