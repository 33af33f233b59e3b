"""Piecewise polynomial references: pieces, their bounds, and their symbols.

On one piece, y_d(t) = sum_k a_k (t - t_0)^k. The closed loop is compiled with t_0 and a_k as
runtime parameters; at a break point the integrator stops, takes the next piece and goes on, so no
step ever crosses a kink.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.keys import set_fields
from certrack.references.base import Bounds, round_up
from certrack.references.extremes import largest_of_rows
from certrack.references.polynomials import (
    DEGREE,
    ROUNDINGS,
    derived,
    evaluate,
    largest_slope,
    stationary,
)

#: Relative to the time or the length of the knots: times closer than this are the same, for the
#: knots of a periodic reference are sums of floats.
SAME_TIME = 1e-12

#: Relative to the largest size of its terms: ends of pieces closer than this are the same value.
SAME_VALUE = 1e-12

#: No law asks for more derivatives.
MAX_PIECE_DEGREE = 52

#: Factor on the extremes of a cubic, whose evaluation is some ten float operations.
EXTREME_ROUNDING = 1 + 1e-13

#: Relative excess over a declared bound that is not refused; points per piece where it is compared.
BOUND_TOLERANCE, BOUND_POINTS = 1e-9, 33


@dataclass(frozen=True)
class PiecewiseReference:
    """A continuous piecewise polynomial.

    Outside the knots the reference repeats with the period, or holds its end values.

    Parameters
    ----------
    knots : m + 1 increasing times, s
    coefficients : m rows of 4 or more numbers
        a_0 ... a_3 ... of each piece, in powers of the time since its knot.
    smoothness : int
        The order: derivatives up to it are bounded, those below it continuous.
    period : float, optional
        Repeat with this period (the length of the knots); otherwise hold.
    fields : pairs
        The keys of the system file that made it, for saving.
    bound : float, optional
        D with |y_d| + |y_d'| <= D (Assumption 2).

    Raises
    ------
    InputError
        If it is not what this says: knots that do not increase by more than times are rounded,
        numbers that are not finite, derivatives below the order that jump.
    """

    knots: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    smoothness: int
    period: float | None = None
    fields: tuple[tuple[str, Any], ...] = ()
    bound: float | None = None

    def __post_init__(self) -> None:
        self._check_numbers()
        self._check_times()
        self._check_continuity()
        if self.bound is None:
            return
        limit = checks.real("reference.bound", self.bound, above=0)
        set_fields(self, bound=limit)
        inside = np.linspace(1e-9, 1 - 1e-9, BOUND_POINTS)
        points = self._knots[:-1, None] + np.diff(self._knots)[:, None] * inside
        total = np.abs(self.values(points.ravel(), 1)).sum(axis=0).max()
        if total > limit * (1 + BOUND_TOLERANCE):
            raise InputError("reference.bound", f"must bound |y_d| + |y_d'|, which is {total:.6g}")

    def _check_numbers(self) -> None:
        knots = checks.finite_array("reference.knots", self.knots, 1)
        if len(knots) < 2:
            raise InputError("reference.knots", "must be at least two times", len(knots))
        table = checks.finite_array("reference.coefficients", self.coefficients, 2)
        if len(table) != len(knots) - 1 or not DEGREE < table.shape[1] <= MAX_PIECE_DEGREE + 1:
            wanted = f"must be {len(knots) - 1} rows of {DEGREE + 1} numbers, one per piece"
            raise InputError("reference.coefficients", wanted, f"shape {table.shape}")
        set_fields(
            self,
            knots=tuple(knots.tolist()),
            coefficients=tuple(map(tuple, table.tolist())),
            smoothness=checks.integer(
                "reference.smoothness", self.smoothness, 1, table.shape[1] - 1
            ),
        )

    def _check_times(self) -> None:
        knots, width = self._knots, np.diff(self._knots)
        if (width < 0).any():
            i = int(np.argmax(width < 0)) + 1
            raise InputError(f"reference.knots[{i}]", "times must increase", self.knots[i])
        first, last = self.knots[0], self.knots[-1]
        rounding = SAME_TIME * max(1.0, abs(first), abs(last), last - first)
        if not (width > rounding).all():
            i = int(np.argmin(width > rounding))
            raise InputError(
                "reference",
                f"must not have a piece too narrow for its time: {width[i]:g} s at t = "
                f"{knots[i]:g} s, where times are the same within {rounding:g} s",
                remedy="Move slower or earlier",
            )
        if self.period is not None:
            set_fields(self, period=checks.real("reference.period", self.period, above=0))
            if abs(self.period - (last - first)) > rounding:
                wanted = f"must be the length of the knots, {last - first:g} s"
                raise InputError("reference.period", wanted, self.period)

    def _check_continuity(self) -> None:
        """Derivatives below the order are continuous, also where it repeats or holds.

        Before t = 0 there is no reference: what begins there may be moving.
        """
        begins = self.knots[0] <= 0
        a, width = np.array(self.coefficients), np.diff(self._knots)
        for i in range(self.smoothness):
            with np.errstate(all="ignore"):
                terms = derived(a, i)
                ends, size = evaluate(terms, width), evaluate(np.abs(terms), width)
                first = terms[0, 0] if self.period or i == 0 or begins else 0.0
                last = first if self.period else (ends[-1] if i == 0 else 0.0)
                jumps = np.abs(np.append(terms[:, 0], last) - np.append(first, ends))
                size = np.maximum(np.append(size, size[0]), np.append(size[-1], size))
            if not np.isfinite(size).all():
                raise InputError("reference", "must not be so large or steep that it overflows")
            allowed = SAME_VALUE * size.max()
            if (jumps > allowed).any():
                at = self._knots[int(np.argmax(jumps > allowed))]
                what = f"the derivative of order {i}" if i else "y_d"
                raise InputError("reference", f"must not jump: {what} does at t = {at:g} s")

    @property
    def declared_bound(self) -> float | None:
        return self.bound

    @property
    def order(self) -> float:
        return float(self.smoothness)

    @cached_property
    def _knots(self) -> np.ndarray:
        return np.array(self.knots)

    @property
    def _degree(self) -> int:
        return len(self.coefficients[0]) - 1

    @cached_property
    def _table(self) -> np.ndarray:
        """Coefficients with a constant piece before and after, a row each."""
        inner = np.array(self.coefficients)
        first, last = np.zeros((2, self._degree + 1))
        first[0] = inner[0, 0]
        last[0] = np.polyval(inner[-1][::-1], self._knots[-1] - self._knots[-2])
        return np.vstack([first, inner, last])

    @cached_property
    def _starts(self) -> np.ndarray:
        """Start of each row of the table; the piece before the first knot begins there too."""
        return np.concatenate([self._knots[:1], self._knots])

    def _locate(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row of the table and start time of the piece that holds each time (right-continuous)."""
        t = np.asarray(t, dtype=float)
        if self.period is None:
            row = np.searchsorted(self._knots, t, side="right")
            return row, self._starts[row]
        turns = np.floor((t - self._knots[0]) / self.period)
        inside = t - turns * self.period
        row = np.clip(np.searchsorted(self._knots, inside, side="right"), 1, len(self.knots) - 1)
        return row, self._starts[row] + turns * self.period

    @property
    def parameter_symbols(self) -> tuple[sympy.Symbol, ...]:
        return ()

    @property
    def parameter_values(self) -> tuple[float, ...]:
        return ()

    @property
    def piece_symbols(self) -> tuple[sympy.Symbol, ...]:
        names = ("piece_start", *(f"piece_a{k}" for k in range(self._degree + 1)))
        return tuple(sympy.Symbol(name, real=True) for name in names)

    def piece_values(self, t: float) -> np.ndarray:
        span = self.period or (self.knots[-1] - self.knots[0])
        row, start = self._locate(np.array(t + SAME_TIME * max(1.0, abs(t), span)))
        return np.concatenate([[float(start)], self._table[int(row)]])

    def breaks(self, start: float, end: float) -> np.ndarray:
        times = self._knots
        if self.period is not None:
            first = math.floor((start - times[0]) / self.period)
            last = math.ceil((end - times[0]) / self.period)
            turns = np.arange(first, last + 1) * self.period
            times = np.unique((turns[:, None] + times[None, :-1]).ravel())
        tiny = SAME_TIME * max(1.0, abs(end))
        return times[(times > start + tiny) & (times < end - tiny)]

    def formulas(self, order: int) -> tuple[sympy.Expr, ...]:
        start, *a = self.piece_symbols
        since = TIME - start
        signal = sum((a[k] * since**k for k in range(1, self._degree + 1)), a[0])
        return tuple(sympy.diff(signal, TIME, i) for i in range(order + 1))

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        row, start = self._locate(t)
        since = np.asarray(t, dtype=float) - start
        a = self._table[row]
        derivatives, count = [], self._degree + 1
        for i in range(order + 1):
            falling = [math.perm(k, i) for k in range(count)]
            terms = (falling[k] * a[..., k] * since ** (k - i) for k in range(i, count))
            derivatives.append(sum(terms, np.zeros_like(since)))
        return np.array(derivatives)

    def bounds(self, order: int) -> Bounds:
        """Exact: extremes at the ends and stationary points of each piece.

        Of cubics up to rounding, which is counted; of higher degrees in rational arithmetic.
        """
        values = self._bounds_to_smoothness[: order + 1]
        values += tuple(self._bound(i) for i in range(len(values), order + 1))
        return Bounds(values, ("exact",) * (order + 1))

    @cached_property
    def _bounds_to_smoothness(self) -> tuple[float, ...]:
        """Once: every cell of every certificate asks for them."""
        return tuple(self._bound(i) for i in range(self.smoothness + 1))

    def _bound(self, i: int) -> float:
        a = np.array(self.coefficients)
        if self._degree > DEGREE:
            held = abs(float(self._table[-1, 0])) if i == 0 else 0.0
            return max(held, largest_of_rows(a, i, self._knots))
        width = np.diff(self._knots)
        points = [np.zeros_like(width), width, *stationary(derived(a, i + 1), width)]
        best = max(float(np.abs(evaluate(derived(a, i), s)).max()) for s in points)
        return round_up(best * EXTREME_ROUNDING)

    def lipschitz_bound(self, order: int, *, between_jumps: bool = False) -> float | None:
        """That of y_d^(order); see :func:`certrack.references.lipschitz_bound`."""
        if order > self.smoothness or (not between_jumps and self.jumps(order) is not None):
            return None
        slope = largest_slope(np.array(self.coefficients), order + 1, np.diff(self._knots))
        return round_up(slope)

    def jumps(self, order: int) -> tuple[float, float] | None:
        """Those of y_d^(order); see :func:`certrack.references.jumps`."""
        if order != self.smoothness:
            return None
        terms, width = derived(np.array(self.coefficients), order), np.diff(self._knots)
        ends, size = evaluate(terms, width), evaluate(np.abs(terms), width)
        if self.period is None:  # it stands still before and after
            before, after, times = np.append(0.0, ends), np.append(terms[:, 0], 0.0), self._knots
            size = np.maximum(np.append(size, 0.0), np.append(0.0, size))
        else:
            before, after, times = np.roll(ends, 1), terms[:, 0], self._knots[:-1]
            size = np.maximum(size, np.roll(size, 1))
        steps = np.abs(after - before)
        jumping = steps > SAME_VALUE * size
        if self.period is None:
            jumping &= times > 0
        if not jumping.any():
            return None
        times = times[jumping]
        if self.period is not None:
            times = np.append(times, times[0] + self.period)
        spacing = float(np.diff(times).min(initial=np.inf)) - SAME_TIME * float(np.ptp(times))
        return round_up(float((steps + ROUNDINGS * size)[jumping].max())), spacing
