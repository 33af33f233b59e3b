"""Piecewise polynomial references: triangle, trapezoid, limited steps, samples.

On one piece, y_d(t) = sum_k a_k (t - t_0)^k. The closed loop is compiled with t_0 and a_k as
runtime parameters; at a break point the integrator stops, takes the next piece and goes on, so no
step ever crosses a kink.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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

#: Of every piece: enough for a cubic interpolant.
DEGREE = 3

#: More samples than this fill the memory of a small machine while the coefficients are computed.
MAX_REFERENCE_SAMPLES = 1_000_000

#: Relative to the time or the length of the knots: times closer than this are the same, for the
#: knots of a periodic reference are sums of floats.
SAME_TIME = 1e-12

#: Factor on the extremes of a piece, whose evaluation is some ten float operations.
EXTREME_ROUNDING = 1 + 1e-13

#: Relative excess over a declared bound that is not refused; points per piece where it is compared.
BOUND_TOLERANCE, BOUND_POINTS = 1e-9, 33


@dataclass(frozen=True)
class PiecewiseReference:
    """A continuous piecewise polynomial of degree at most 3.

    Outside the knots the reference repeats with the period, or holds its end values.

    Parameters
    ----------
    knots : m + 1 increasing times, s
    coefficients : m rows of 4 numbers
        a_0 ... a_3 of each piece, in powers of the time since its knot.
    smoothness : int
        The order: derivatives up to it are bounded, those below it continuous.
    period : float, optional
        Repeat with this period (the length of the knots); otherwise hold.
    fields : pairs
        The keys of the system file that made it, for saving.
    bound : float, optional
        D with |y_d| + |y_d'| <= D (Assumption 2).
    """

    knots: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    smoothness: int
    period: float | None = None
    fields: tuple[tuple[str, Any], ...] = ()
    bound: float | None = None

    def __post_init__(self) -> None:
        if self.bound is None:
            return
        limit = checks.real("reference.bound", self.bound, above=0)
        set_fields(self, bound=limit)
        inside = np.linspace(1e-9, 1 - 1e-9, BOUND_POINTS)
        points = self._knots[:-1, None] + np.diff(self._knots)[:, None] * inside
        total = np.abs(self.values(points.ravel(), 1)).sum(axis=0).max()
        if total > limit * (1 + BOUND_TOLERANCE):
            raise InputError("reference.bound", f"must bound |y_d| + |y_d'|, which is {total:.6g}")

    @property
    def declared_bound(self) -> float | None:
        return self.bound

    @property
    def order(self) -> float:
        return float(self.smoothness)

    @cached_property
    def _knots(self) -> np.ndarray:
        return np.array(self.knots)

    @cached_property
    def _table(self) -> np.ndarray:
        """Coefficients with a constant piece before and after, shape (m + 2, 4)."""
        inner = np.array(self.coefficients)
        first, last = np.zeros((2, DEGREE + 1))
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
        names = ("piece_start", *(f"piece_a{k}" for k in range(DEGREE + 1)))
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
        signal = sum((a[k] * since**k for k in range(1, DEGREE + 1)), a[0])
        return tuple(sympy.diff(signal, TIME, i) for i in range(order + 1))

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        row, start = self._locate(t)
        since = np.asarray(t, dtype=float) - start
        a = self._table[row]
        derivatives = []
        for i in range(order + 1):
            falling = [math.perm(k, i) for k in range(DEGREE + 1)]
            terms = (falling[k] * a[..., k] * since ** (k - i) for k in range(i, DEGREE + 1))
            derivatives.append(sum(terms, np.zeros_like(since)))
        return np.array(derivatives)

    def bounds(self, order: int) -> Bounds:
        """Exact up to rounding: extremes at the ends and stationary points of each piece."""
        a = np.array(self.coefficients)
        width = np.diff(self._knots)
        values = []
        for i in range(order + 1):
            points = [np.zeros_like(width), width, *_stationary(_derived(a, i + 1), width)]
            best = max(float(np.abs(_evaluate(_derived(a, i), s)).max()) for s in points)
            values.append(round_up(best * EXTREME_ROUNDING))
        return Bounds(tuple(values), ("exact",) * (order + 1))


def _derived(a: np.ndarray, i: int) -> np.ndarray:
    """Coefficient rows of the i-th derivative, padded with zeros."""
    derived = np.zeros_like(a)
    for k in range(i, DEGREE + 1):
        derived[:, k - i] = math.perm(k, i) * a[:, k]
    return derived


def _evaluate(a: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Value of each row's polynomial at its own s."""
    value = np.zeros_like(s)
    for k in range(DEGREE, -1, -1):
        value = value * s + a[:, k]
    return value


def _stationary(slope: np.ndarray, width: np.ndarray) -> list[np.ndarray]:
    """Roots of each row's quadratic, moved into the piece (any point of it is admissible)."""
    # in units of the piece's width and height, so that nothing under- or overflows
    scaled = slope[:, :3] * width[:, None] ** np.arange(3)
    scaled = scaled / np.maximum(np.abs(scaled).max(axis=1, keepdims=True), 1e-300)
    c0, c1, c2 = scaled[:, 0], scaled[:, 1], scaled[:, 2]
    with np.errstate(all="ignore"):
        half = -(c1 + np.copysign(np.sqrt(np.maximum(c1**2 - 4 * c0 * c2, 0.0)), c1)) / 2
        roots = (half / c2, c0 / half)
    finite = (np.nan_to_num(root, nan=0.0, posinf=0.0, neginf=0.0) for root in roots)
    return [width * np.clip(root, 0.0, 1.0) for root in finite]


def trapezoid(
    amplitude: float,
    period: float,
    rise: float,
    offset: float = 0.0,
    start: float = 0.0,
    bound: float | None = None,
    *,
    fields: tuple[tuple[str, Any], ...] | None = None,
) -> PiecewiseReference:
    """Periodic trapezoid between offset - amplitude and offset + amplitude.

    It rises during [start, start + rise], holds, falls during an equal time, and holds.

    Parameters
    ----------
    amplitude : float
        Half the peak-to-peak swing, unit of the output.
    period, rise : float, s
        0 < rise <= period / 2; with rise = period / 2 it is a triangle.
    offset : float
        Mean value, unit of the output.
    start : float, s
        A time at which a rise begins.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    PiecewiseReference

    Examples
    --------
    >>> import certrack
    >>> certrack.trapezoid(amplitude=1, period=4, rise=1).order
    1.0
    """
    if fields is None:
        fields = _fields(
            "trapezoid", amplitude=amplitude, period=period, rise=rise, offset=offset, start=start
        )
    amplitude = checks.real("reference.amplitude", amplitude, nonzero=True)
    period = checks.real("reference.period", period, above=0)
    rise = checks.real("reference.rise", rise, above=0)
    offset = checks.real("reference.offset", offset)
    start = checks.real("reference.start", start)
    if rise > period / 2:
        raise InputError("reference.rise", f"must not exceed period/2 = {period / 2:g}", rise)
    low, high, slope = offset - amplitude, offset + amplitude, 2 * amplitude / rise
    hold = period / 2 - rise
    pieces = [(rise, low, slope), (hold, high, 0.0), (rise, high, -slope), (hold, low, 0.0)]
    pieces = [piece for piece in pieces if piece[0] > SAME_TIME * period]
    knots = start + np.concatenate([[0.0], np.cumsum([width for width, _, _ in pieces])])
    knots[-1] = start + period
    rows = tuple((float(a0), float(a1), 0.0, 0.0) for _, a0, a1 in pieces)
    return PiecewiseReference(tuple(knots.tolist()), rows, 1, period, fields, bound)


def triangle(
    amplitude: float,
    period: float,
    offset: float = 0.0,
    start: float = 0.0,
    bound: float | None = None,
) -> PiecewiseReference:
    """Periodic triangle: a :func:`trapezoid` that never holds.

    Parameters
    ----------
    amplitude : float
        Half the peak-to-peak swing, unit of the output.
    period : float, s
    offset : float
        Mean value, unit of the output.
    start : float, s
        A time at which a rise begins.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    PiecewiseReference

    Examples
    --------
    >>> import certrack
    >>> certrack.triangle(amplitude=1, period=4).breaks(0, 8)
    array([2., 4., 6.])
    """
    fields = _fields("triangle", amplitude=amplitude, period=period, offset=offset, start=start)
    period = checks.real("reference.period", period, above=0)
    return trapezoid(amplitude, period, period / 2, offset, start, bound, fields=fields)


def steps(
    times: tuple[float, ...],
    levels: tuple[float, ...],
    slope: float,
    bound: float | None = None,
) -> PiecewiseReference:
    """Moves from level to level with limited slope.

    Parameters
    ----------
    times : m increasing times, s
        When each move begins.
    levels : m + 1 numbers
        The level before the first move, then after each move; unit of the output.
    slope : float
        Speed of a move, unit of the output per second.
    bound : float, optional
        D of Assumption 2.
    """
    times = checks.reals("reference.times", times, None, "times of the moves, s")
    if not times:
        raise InputError("reference.times", "must be a list of at least one time")
    levels = checks.reals("reference.levels", levels, len(times) + 1, "one more than times")
    slope = checks.real("reference.slope", slope, above=0)
    knots: list[float] = []
    rows: list[tuple[float, ...]] = []
    for i, (begin, a, b) in enumerate(zip(times, levels[:-1], levels[1:], strict=True)):
        if knots and abs(begin - knots[-1]) <= 1e-9 * max(1.0, abs(begin)):
            begin = knots[-1]  # contiguous moves, up to rounding
        if knots and begin < knots[-1]:
            raise InputError(
                f"reference.times[{i}]",
                f"must not be before the end of the previous move at t = {knots[-1]:g}",
                begin,
                "Raise slope or move later",
            )
        if a == b:
            raise InputError(f"reference.levels[{i + 1}]", "must differ from the level before", b)
        if knots and begin > knots[-1]:
            rows.append((a, 0.0, 0.0, 0.0))
        if not knots or begin > knots[-1]:
            knots.append(begin)
        rows.append((a, math.copysign(slope, b - a), 0.0, 0.0))
        knots.append(begin + abs(b - a) / slope)
    fields = _fields("steps", times=list(times), levels=list(levels), slope=slope)
    return PiecewiseReference(tuple(knots), tuple(rows), 1, None, fields, bound)


def samples(
    times: tuple[float, ...],
    values: tuple[float, ...],
    interpolation: str = "monotone",
    bound: float | None = None,
) -> PiecewiseReference:
    """Interpolated samples, held before the first and after the last.

    Parameters
    ----------
    times : m >= 2 increasing times, s
    values : m numbers
        y_d at these times, unit of the output.
    interpolation : {"monotone", "cubic"}
        Monotone never overshoots the data; cubic has a continuous second derivative inside. Both
        start and end with zero slope, so that holding keeps y_d' continuous (order 2).
    bound : float, optional
        D of Assumption 2.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    checks.choice("reference.interpolation", interpolation, ("monotone", "cubic"))
    times = checks.reals("reference.times", times, None, "sample times, s")
    values = checks.reals("reference.values", values, len(times), "one value per time")
    if not 2 <= len(times) <= MAX_REFERENCE_SAMPLES:
        raise InputError(
            "reference.times", f"must be 2 to {MAX_REFERENCE_SAMPLES} samples", len(times)
        )
    t, y = np.array(times), np.array(values)
    late = np.flatnonzero(np.diff(t) <= 0)
    if late.size:
        i = int(late[0]) + 1
        raise InputError(f"reference.times[{i}]", "times must increase", times[i])
    if interpolation == "cubic":
        slopes = _slopes(lambda: CubicSpline(t, y, bc_type="clamped")(t, 1))
    else:
        slopes = _slopes(lambda: PchipInterpolator(t, y)(t, 1))
        slopes[[0, -1]] = 0.0
    width, rise = np.diff(t), np.diff(y)
    a1, b1 = slopes[:-1], slopes[1:]
    a2 = (3 * rise / width - 2 * a1 - b1) / width  # cubic Hermite
    a3 = (a1 + b1 - 2 * rise / width) / width**2
    if not all(np.isfinite(part).all() for part in (a1, a2, a3)):
        raise InputError("reference.times", "must not be so close that the slopes overflow")
    rows = tuple(map(tuple, np.column_stack([y[:-1], a1, a2, a3]).tolist()))
    fields = _fields("samples", times=list(times), values=list(values), interpolation=interpolation)
    return PiecewiseReference(times, rows, 2, None, fields, bound)


def _slopes(compute: Callable[[], np.ndarray]) -> np.ndarray:
    try:
        with np.errstate(all="ignore"):
            return np.array(compute())
    except (ValueError, ArithmeticError):
        raise InputError(
            "reference.times", "must not be so close that the slopes overflow"
        ) from None


def _fields(kind: str, **values: Any) -> tuple[tuple[str, Any], ...]:
    def plain(value: Any) -> Any:
        return tuple(value) if isinstance(value, list) else value

    return (("kind", kind), *((name, plain(value)) for name, value in values.items()))
