"""From a proven box to what a stage stands on, and back: whether the stage stands.

Every interval of a stage is wider than what was proven before, so that after some time the state is
in it and stays there: what was proven is a bound of the limes superior, which the state need not
keep at any time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational, solve
from certrack.certificates.bootstrap.box import Region, RegionNumbers, TextPair, interval_of
from certrack.certificates.bootstrap.loop import AdaptiveLoop
from certrack.certificates.bootstrap.proof import Bounding
from certrack.certificates.bootstrap.ranges import Combination, Ranges, largest_reach
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, float_down, float_up, from_text, root_up

#: By this part of its width, to either side, an interval of a stage is wider than what was proven,
#: and a range is wider than what was enclosed, so that another quadrature of boxes confirms it.
WIDER, LOOSER = 1e-7, 1e-6

#: And by this part of the numbers that it is a difference of, for another one's roundings.
ROUNDING_SHARE = 1e-9

#: And where all of them are zero, for what underflows.
UNDERFLOW_ROOM = 1e-40

#: Digits of the slope k and the middle of phi, which may be any numbers.
FREE_DIGITS = 8

#: Points of the box at which the drift is fitted by a linear function.
FIT_POINTS = 256


@dataclass(frozen=True)
class Reached:
    """What is proven so far, in exact rationals: limsup and liminf of every error.

    Attributes
    ----------
    box : (size, 2) array
    row : array or None
        A linear row of the errors ...
    interval : pair or None
        ... and its bounds.
    """

    box: np.ndarray
    row: np.ndarray | None = None
    interval: tuple[Any, Any] | None = None

    def interval_of(self, row: np.ndarray) -> tuple[Any, Any]:
        """What is known of another row."""
        low, high = interval_of(row, self.box)
        if self.row is None or self.interval is None:
            return low, high
        less, more = interval_of(row - self.row, self.box)
        return max(low, self.interval[0] + less), min(high, self.interval[1] + more)


def _cut_to(ends: Any, side: int, bound: Any) -> tuple[Any, Any]:
    low, high = ends
    return (low, min(high, bound)) if side > 0 else (max(low, -bound), high)


def after(known: Reached, functions: Sequence[Bounding], rows: Sequence[np.ndarray]) -> Reached:
    """What is known with the bounds of a stage; its last row is that of ubar.

    Bounds of other rows are left to whoever stated them.
    """
    box, size = known.box.copy(), len(known.box)
    interval = before = known.interval_of(rows[-1])
    for function in functions:
        for claim in function.claims:
            bound = from_text(claim.bound)
            if claim.error < size:
                box[claim.error] = _cut_to(box[claim.error], claim.side, bound)
            elif claim.error == size:
                interval = _cut_to(interval, claim.side, bound)
    if interval == before:
        return replace(known, box=box)
    return Reached(box, rows[-1], interval)


def rows_of(loop: AdaptiveLoop, numbers: RegionNumbers) -> list[np.ndarray]:
    """The rows that a stage may bound: every error, and the linear row of ubar."""
    return [*(np.eye(loop.size, dtype=object) + rational(0)), numbers.linear_row(loop)]


def first_box(loop: AdaptiveLoop, proof: Proof) -> Reached:
    """The box around the ellipsoid of a proof with the function that the update laws cancel."""
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    square = from_text(proof.bound) ** 2
    inverse = solve(P, np.eye(len(P), dtype=object))
    parts = [inverse[i, i] for i in range(loop.n)]
    parts += [loop.Gamma[i, i] / P[-1, -1] for i in range(loop.r)]
    parts += [loop.gain_rate / (loop.smallest_gain * P[-1, -1])]
    sizes = [from_text(root_up(square * part)) for part in parts]
    return Reached(np.array([[-size, size] for size in sizes], dtype=object))


def next_region(loop: AdaptiveLoop, ranges: Ranges, known: Reached) -> Region:
    """What the next stage stands on."""
    box = tuple(wider_texts(low, high, WIDER) for low, high in known.box)
    exact = np.array([[from_text(v) for v in pair] for pair in box], dtype=object)
    place = box_of_states(loop, exact)
    slope = tuple(f"{v:.{FREE_DIGITS}g}" for v in ranges.fitted_slope(place, FIT_POINTS))
    k, zero = tuple(map(from_text, slope)), rational(0)
    none = tuple(zero for _ in range(loop.r))
    through = np.abs(np.hstack([loop.Xe, loop.AB]).astype(float))
    sizes = [rational_float(v) for v in through @ np.abs(place).max(axis=1)]

    def enclosed(combination: Combination, spread: Any = zero) -> TextPair:
        low, high = (rational_float(v) for v in ranges.bounds(combination, place))
        size = sum((abs(a) * b for a, b in zip(combination.slope, sizes, strict=True)), spread)
        more = rational(ROUNDING_SHARE) * (size + abs(low) + abs(high)) + rational(UNDERFLOW_ROOM)
        return wider_texts(low - spread - more, high + spread + more, LOOSER)

    regressor = tuple(
        enclosed(_single(loop, i)) if value is None else (value, value)
        for i, value in enumerate(ranges.constants)
    )
    drift = enclosed(Combination((rational(1), *none), k, zero))
    middle = tuple(
        f"{float((from_text(low) + from_text(high)) / 2):.{FREE_DIGITS}g}"
        for low, high in regressor
    )
    start = Region(box, middle, slope, ("0", "0"), regressor, drift, ("0", "0"), ())
    numbers = start.numbers()
    combination, spread = remainder_of(loop, numbers)
    row = wider_texts(*known.interval_of(numbers.linear_row(loop)), WIDER)
    reach = tuple(_up(rational_float(v)) for v in largest_reach(loop, place))
    return replace(start, row=row, remainder=enclosed(combination, spread), reach=reach)


def failed_region(loop: AdaptiveLoop, ranges: Ranges, known: Reached, region: Region) -> str:
    """Empty if a stage stands on what is known and its ranges hold, else what is wrong."""
    if reason := failed_shape(loop, region):
        return reason
    numbers = region.numbers()
    row = numbers.linear_row(loop)
    intervals = [*zip(numbers.box, known.box, strict=True), (numbers.row, known.interval_of(row))]
    if not all(new[0] < old[0] and new[1] > old[1] for new, old in intervals):
        return "a stage's box does not hold what was proven before"
    return failed_ranges(loop, ranges, region)


def failed_shape(loop: AdaptiveLoop, region: Region) -> str:
    """Empty if a region has as many numbers as the loop needs."""
    numbers = region.numbers()
    shapes = (len(numbers.box), len(numbers.middle), len(numbers.slope), len(numbers.regressor))
    if shapes != (loop.size, loop.r, loop.n, loop.r) or len(numbers.reach) != len(loop.selections):
        return "a stage does not have the shape of the loop"
    return ""


def failed_ranges(loop: AdaptiveLoop, ranges: Ranges, region: Region) -> str:
    """Empty if the ranges of a region hold on its box, whatever that stands on."""
    numbers = region.numbers()
    place, zero = box_of_states(loop, numbers.box), rational(0)
    if any(not v > 0 for v in numbers.reach) or any(
        v < rational_float(w)
        for v, w in zip(numbers.reach, largest_reach(loop, place), strict=True)
    ):
        return "a stage's bound of ||x|| is smaller than that of its box"
    none = tuple(zero for _ in range(loop.r))
    combination, spread = remainder_of(loop, numbers)
    claims = [
        *(
            (_single(loop, i), pair, zero)
            for i, pair in enumerate(numbers.regressor)
            if region.regressor[i] != (ranges.constants[i],) * 2
        ),
        (Combination((rational(1), *none), tuple(numbers.slope), zero), numbers.drift, zero),
        (combination, numbers.remainder, spread),
    ]
    for combination, (low, high), spread in claims:
        first, last = float_up(low + spread), float_down(high - spread)
        if not ranges.within(combination, place, first, last):
            return "a range of drift or regressor is not proven on a stage's box"
    return ""


def _single(loop: AdaptiveLoop, i: int) -> Combination:
    zero = rational(0)
    weights = tuple(rational(int(j == i + 1)) for j in range(loop.r + 1))
    return Combination(weights, (zero,) * loop.n, zero)


def remainder_of(loop: AdaptiveLoop, numbers: RegionNumbers) -> tuple[Combination, Any]:
    """h - k x + phi^T theta - (phi - phi_m)^T theta_tilde: with both in their middles, and more."""
    errors = numbers.box[loop.n : loop.n + loop.r]
    middles = [(low + high) / 2 for low, high in errors]
    weights = [theta - m for theta, m in zip(loop.theta_middle, middles, strict=True)]
    zero = rational(0)
    constant = sum((p * m for p, m in zip(numbers.middle, middles, strict=True)), zero)
    spread = zero
    for i, (low, high) in enumerate(numbers.regressor):
        off = max(abs(low - numbers.middle[i]), abs(high - numbers.middle[i]))
        spread += off * (errors[i][1] - errors[i][0]) / 2
        spread += max(abs(low), abs(high)) * loop.theta_radius[i]
    return Combination((rational(1), *weights), tuple(numbers.slope), constant), spread


def box_of_states(loop: AdaptiveLoop, box: np.ndarray) -> np.ndarray:
    """Floats around the box of e and y_d ... y_d^(q)."""
    rows = [(float_down(low), float_up(high)) for low, high in box[: loop.n]]
    rows += [(float_down(-y), float_up(y)) for y in loop.Y[:-1]]
    return np.array(rows)


def rational_float(value: float) -> Any:
    """The exact value of a float."""
    if not np.isfinite(value):
        raise NoCertificate("drift or regressor have no bounds on the set")
    return rational(float(value))


def wider_texts(low: Any, high: Any, part: float) -> TextPair:
    """Texts of an interval that is strictly wider."""
    more = rational(part) * (high - low)
    return _minus(_up(more - low)), _up(high + more)


def _minus(text: str) -> str:
    return text[1:] if text.startswith("-") else f"-{text}"


def _up(value: Any) -> str:
    """A decimal of 13 digits that is above a rational."""
    near = float_up(value)
    step = max(abs(near) * 1e-12, 1e-300)
    text = f"{near:.13g}"
    while not from_text(text) > value:
        near += step
        text = f"{near:.13g}"
    return text
