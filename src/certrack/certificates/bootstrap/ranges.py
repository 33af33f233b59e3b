"""Bounds of formulas of x on a box of e and y_d ... y_d^(q), rounded outward.

x = Xe e + AB Y follows y_d, so its entries are not independent, and a box of x would be far too
large. On a part of the box of (e, Y), with its middle m and its half widths w,

    f in f(x(m)) +- sum_i |(grad f(x-box of the part) (Xe | AB))_i| w_i

by the mean value theorem, in ball arithmetic, unless f may jump there (sign, atan2, a pole inside),
or the value of f on the x-box. The part whose bound
is the largest is halved until the largest is near to a value that f takes.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import flint
import numpy as np
import sympy

from certrack.certificates.arithmetic import rational
from certrack.certificates.bootstrap.loop import AdaptiveLoop, Formulas
from certrack.certificates.bootstrap.tape import Tape
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text
from certrack.core.kinks import JUMPING

#: The search stops when the bound exceeds a value by this part of the range, or at so many parts.
ENOUGH, MOST_PARTS = 0.02, 400

#: Floats of x from floats of e and Y are wrong by less than this part of the sum of magnitudes.
FLOAT_SUM = 1e-12

#: Corners that are looked at for the largest ||S x||; beyond, each entry is bounded by itself.
MOST_BOX_CORNERS = 2**13

#: Slopes smaller than this part of the largest are noise.
FIT_NOISE = 1e-9

#: Corners of a box at which a formula is computed first.
SAMPLES = 32

#: Middles and half widths are rounded to floats; this covers it.
FLOAT_SHARE, FLOAT_WIDENING = 1e-15, 1 + 1e-15

#: Where sums of balls begin.
ZERO_BALL = flint.arb(0)

#: A checker may halve so often until all parts are within a stated bound.
MOST_PARTS_TO_CHECK = 10_000


@dataclass(frozen=True)
class Combination:
    """weights . (h, phi) - slope . x + constant, in exact rationals."""

    weights: tuple[Any, ...]
    slope: tuple[Any, ...]
    constant: Any

    @cached_property
    def balls(self) -> tuple[list[tuple[int, Any]], list[Any], Any]:
        """The weights that are not zero with their places, the slope and the constant as balls."""
        weights = [(i, flint.arb(w)) for i, w in enumerate(self.weights) if w != 0]
        return weights, [flint.arb(k) for k in self.slope], flint.arb(self.constant)


class Ranges:
    """Drift and regressor on boxes of (e, y_d ... y_d^(q)).

    Parameters
    ----------
    formulas : Formulas
    loop : AdaptiveLoop
        In exact rationals.

    Raises
    ------
    NoCertificate
        If a formula has no rule of ball arithmetic.
    """

    def __init__(self, formulas: Formulas, loop: AdaptiveLoop) -> None:
        exact = np.hstack([loop.Xe, loop.AB])
        self._through = exact.astype(float)
        self._reach = np.abs(self._through).sum(axis=0)
        self._balls = flint.arb_mat([[flint.arb(v) for v in row] for row in exact])
        known = (formulas.drift, *formulas.regressor)
        self.constants = tuple(map(_decimal_of, formulas.regressor))
        try:
            self._values = Tape(known, formulas.states)
        except ValueError as problem:
            raise NoCertificate(f"no bounds of the drift or regressor: {problem}") from None
        self._slopes = [_slopes(formula, formulas.states) for formula in known]

    def _states(self, balls: list[Any]) -> list[Any]:
        """Balls of x for balls of (e, Y)."""
        x: list[Any] = (self._balls * flint.arb_mat([[ball] for ball in balls])).entries()
        return x

    def _value(self, chosen: Combination, x: list[Any]) -> Any:
        """The ball of a combination for balls of x."""
        values, (weights, slope, total) = self._values(x), chosen.balls
        for i, w in weights:
            total = total + w * values[i]
        for k, v in zip(slope, x, strict=True):
            total = total - k * v
        return total

    def _middle_value(self, chosen: Combination, point: np.ndarray) -> float:
        """The value at a point of (e, Y), as far as floats tell; nan where it has none."""
        ball = self._value(chosen, self._states(list(map(flint.arb, point.tolist()))))
        return float(ball.mid()) if ball.is_finite() else np.nan

    def _on(
        self, chosen: Combination, middle: np.ndarray, width: np.ndarray
    ) -> tuple[float, float, float, np.ndarray]:
        """Bounds on a part, a value in its middle, and what each direction adds."""
        middles, widths = middle.tolist(), width.tolist()
        box = self._states(list(map(flint.arb, middles, widths)))
        weights, slope, _ = chosen.balls
        centre = self._value(chosen, self._states(list(map(flint.arb, middles))))
        on_part = self._value(chosen, box)
        low, high = _float_ends(on_part)
        share = self._reach * width
        bounded = centre.is_finite() and on_part.is_finite()  # no pole inside, so it is continuous
        if bounded and all(self._slopes[i] is not None for i, _ in weights):
            gradient = [-k for k in slope]
            for i, w in weights:
                tape = self._slopes[i]
                assert tape is not None
                gradient = [g + w * v for g, v in zip(gradient, tape(box), strict=True)]
            through = (flint.arb_mat([gradient]) * self._balls).entries()
            parts = [abs(g) * w for g, w in zip(through, map(flint.arb, widths), strict=True)]
            total = sum(parts, ZERO_BALL)
            if total.is_finite():
                share = np.array([float(part.abs_upper()) for part in parts])
                below, above = _float_ends(centre + flint.arb(0, 1) * total.abs_upper())
                low, high = max(low, below), min(high, above)
        return low, high, float(centre.mid()) if centre.is_finite() else np.nan, share

    def bounds(self, chosen: Combination, box: np.ndarray) -> tuple[float, float]:
        """Lower and upper bound on a box, rows (low, high) of (e, Y) as floats."""
        middle, width = _middle_and_width(box)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (SAMPLES, len(box)))
        values = [self._middle_value(chosen, middle + sign * width) for sign in signs]
        first, last = float(np.nanmin(values)), float(np.nanmax(values))
        near = ENOUGH * (last - first)
        low = self._end(chosen, box, -1.0, -first + near, MOST_PARTS)
        return -low, self._end(chosen, box, 1.0, last + near, MOST_PARTS)

    def fitted_slope(self, box: np.ndarray, count: int) -> np.ndarray:
        """k of the linear function k x + constant that is near to the drift on a box."""
        points = np.random.default_rng(1).uniform(box[:, 0], box[:, 1], (count, len(box)))
        x = points @ self._through.T
        values = [self._values([flint.arb(float(v)) for v in row])[0] for row in x]
        known = np.array([float(v.mid()) if v.is_finite() else np.nan for v in values])
        rows, known = x[np.isfinite(known)], known[np.isfinite(known)]
        fit = np.hstack([rows, np.ones((len(rows), 1))])
        slope: np.ndarray = np.linalg.lstsq(fit, known)[0][:-1]
        return np.where(np.abs(slope) > FIT_NOISE * np.abs(slope).max(initial=0.0), slope, 0.0)

    def within(self, chosen: Combination, box: np.ndarray, low: float, high: float) -> bool:
        """Whether the formula is proven to stay between two floats on the box."""
        most = MOST_PARTS_TO_CHECK
        above = self._end(chosen, box, 1.0, high, most)
        return above <= high and self._end(chosen, box, -1.0, -low, most) <= -low

    def _end(
        self, chosen: Combination, box: np.ndarray, sign: float, target: float, most: int
    ) -> float:
        """An upper bound of sign times the formula; the search stops where it is the target's."""
        fixed, count, best = most == MOST_PARTS_TO_CHECK, 0, -np.inf

        def part(middle: np.ndarray, width: np.ndarray) -> tuple[float, int, Any, Any, Any]:
            nonlocal count, best
            low, high, value, share = self._on(chosen, middle, width)
            count += 1
            if value == value:
                best = max(best, sign * value)
            return (-high if sign > 0 else low), count, middle, width, share

        parts = [part(*_middle_and_width(box))]
        while count < most and -parts[0][0] > (target if fixed else max(target, best)):
            if fixed and best > target:
                break  # it is attained
            _, _, middle, width, share = parts[0]
            i = int(np.argmax(share))
            if not share[i] > 0:
                break
            heapq.heappop(parts)
            half, shift = width.copy(), np.zeros(len(width))
            shift[i] = width[i] / 2
            half[i] = np.nextafter(
                width[i] / 2 * FLOAT_WIDENING + abs(middle[i]) * FLOAT_SHARE, np.inf
            )
            for at in (middle - shift, middle + shift):
                heapq.heappush(parts, part(at, half))
        return -parts[0][0]


def _middle_and_width(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half widths that hold the box in spite of their roundings."""
    middle, width = box.mean(axis=1), (box[:, 1] - box[:, 0]) / 2
    return middle, width * FLOAT_WIDENING + np.abs(box).max(axis=1) * FLOAT_SHARE


def _decimal_of(formula: sympy.Expr) -> str | None:
    """The text of a formula that is a short decimal; None for all others."""
    if not formula.is_Rational:
        return None
    text = f"{float(formula):.13g}"
    return text if from_text(text) == rational(formula) else None


def _slopes(formula: sympy.Expr, states: Sequence[sympy.Symbol]) -> Tape | None:
    """The gradient of a formula without jumps, if all of it has rules."""
    if formula.has(*JUMPING):
        return None
    try:
        return Tape([formula.diff(state) for state in states], states)
    except ValueError:
        return None


def largest_reach(loop: AdaptiveLoop, box: np.ndarray) -> list[float]:
    """Bounds of ||S_k x|| of each a-input, for (e, Y) in a box of floats.

    The norm is convex, so it is largest at a corner; with too many of them each entry of S_k x is
    bounded by itself.
    """
    through = np.hstack([loop.Xe, loop.AB]).astype(float)
    limits = []
    for S in loop.selections:
        rows = S.astype(float) @ through
        middle, width = _middle_and_width(box)
        if 2 ** len(box) <= MOST_BOX_CORNERS:
            signs = np.array(list(product((-1.0, 1.0), repeat=len(box))))
            largest = float(np.linalg.norm((middle + signs * width) @ rows.T, axis=1).max())
        else:
            largest = float(np.linalg.norm(np.abs(rows @ middle) + np.abs(rows) @ width))
        wide = np.abs(S.astype(float)) @ np.abs(through) @ (np.abs(middle) + width)
        limits.append(largest + FLOAT_SUM * float(np.linalg.norm(wide)) + FLOAT_SUM * largest)
    return limits


def _float_ends(ball: Any) -> tuple[float, float]:
    """Floats below and above a ball; infinite where nothing is known."""
    if not ball.is_finite():
        return -np.inf, np.inf
    return (
        float(np.nextafter(float(ball.lower()), -np.inf)),
        float(np.nextafter(float(ball.upper()), np.inf)),
    )
