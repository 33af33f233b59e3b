"""Shapes of piecewise polynomials: triangle, trapezoid, limited steps, profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references.piecewise import MAX_PIECE_DEGREE, SAME_TIME, PiecewiseReference
from certrack.references.polynomials import DEGREE

#: More times of a profile than this fill the memory of a small machine.
MAX_PROFILE_TIMES = 1_000_000


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
    """Periodic trapezoid of the position between offset - amplitude and offset + amplitude.

    It rises at a constant speed during [start, start + rise], holds, falls during an equal time,
    and holds; the speed jumps at its corners. Where the *speed* is to be a trapezoid, take
    :func:`~certrack.references.profiles.moves.velocity`.

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
    shape = {"amplitude": amplitude, "period": period, "rise": rise, "offset": offset}
    fields = fields or _fields("trapezoid", **shape, start=start)
    amplitude = checks.real("reference.amplitude", amplitude, nonzero=True)
    period = checks.real("reference.period", period, above=0)
    rise = checks.real("reference.rise", rise, above=0)
    offset = checks.real("reference.offset", offset)
    start = checks.real("reference.start", start)
    if rise > period / 2:
        raise InputError("reference.rise", f"must not exceed period/2 = {period / 2:g}", rise)
    low, high, hold = offset - amplitude, offset + amplitude, period / 2 - rise
    if hold <= SAME_TIME * period:  # a triangle, but for rounding
        rise, hold = period / 2, 0.0
    corners = [(0.0, low), (rise, high), (rise + hold, high), (2 * rise + hold, low), (period, low)]
    if not hold:
        del corners[2], corners[-2]
    knots = [start + time for time, _ in corners]
    rows = _ramps(knots, [level for _, level in corners])
    return PiecewiseReference(tuple(knots), rows, 1, period, fields, bound)


def _ramps(knots: list[float], levels: list[float]) -> tuple[tuple[float, ...], ...]:
    """Straight lines between the levels at the knots.

    Their slopes are those between the knots as they are rounded, so that no line misses its end.
    """
    with np.errstate(all="ignore"):
        slopes = np.diff(levels) / np.diff(knots)
    if np.isinf(slopes[np.diff(knots) > 0]).any():
        raise InputError("reference", "must not be so steep that its slope overflows")
    slopes = np.where(np.diff(knots) > 0, slopes, 0.0)  # the reference refuses such knots itself
    return tuple((a, slope, 0.0, 0.0) for a, slope in zip(levels, slopes.tolist(), strict=False))


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
    heights: list[float] = []
    for i, (begin, a, b) in enumerate(zip(times, levels[:-1], levels[1:], strict=True)):
        if knots and abs(begin - knots[-1]) <= 1e-9 * max(1.0, abs(begin)):
            begin = knots[-1]  # contiguous moves, up to rounding
        if knots and begin < knots[-1]:
            wanted = f"must not be before the end of the previous move at t = {knots[-1]:g}"
            raise InputError(f"reference.times[{i}]", wanted, begin, "Raise slope or move later")
        if a == b:
            raise InputError(f"reference.levels[{i + 1}]", "must differ from the level before", b)
        if not knots or begin > knots[-1]:
            knots.append(begin)
            heights.append(a)
        knots.append(begin + abs(b - a) / slope)
        heights.append(b)
    fields = _fields("steps", times=list(times), levels=list(levels), slope=slope)
    rows = _ramps(knots, heights)
    return PiecewiseReference(tuple(knots), rows, 1, None, fields, bound)


def profile(
    times: tuple[float, ...],
    start: tuple[float, ...],
    highest: tuple[float, ...],
    bound: float | None = None,
) -> PiecewiseReference:
    """A motion profile: its highest derivative is constant between times.

    With two numbers in `start` the acceleration is piecewise constant, with three the jerk. It
    begins at the first time, at or before t = 0 or from rest, and ends at rest.

    Parameters
    ----------
    times : m + 1 increasing times, s
    start : d numbers
        y_d ... y_d^(d-1) at the first time.
    highest : m numbers
        y_d^(d) on each piece.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    PiecewiseReference

    Examples
    --------
    >>> from certrack.references import profile
    >>> profile(times=(0, 1, 3, 4), start=(0, 0), highest=(2, 0, -2)).bounds(2).values[1] >= 2
    True
    """
    times = checks.reals("reference.times", times, None, "times between the pieces, s")
    start = checks.reals("reference.start", start, None, "y_d, y_d' ... at the first time")
    if not 2 <= len(times) <= MAX_PROFILE_TIMES:
        wanted = f"must be 2 to {MAX_PROFILE_TIMES} times"
        raise InputError("reference.times", wanted, len(times))
    if not 1 <= len(start) <= MAX_PIECE_DEGREE:
        raise InputError("reference.start", f"must be 1 to {MAX_PIECE_DEGREE} numbers", len(start))
    highest = checks.reals("reference.highest", highest, len(times) - 1, "one per piece")
    order, factorials = len(start), [math.factorial(k) for k in range(len(start) + 1)]
    for i, width in enumerate(np.diff(times)):
        if width <= 0:
            raise InputError(f"reference.times[{i + 1}]", "times must increase", times[i + 1])
    rows = tuple(
        tuple([v / f for v, f in zip((*values, top), factorials, strict=True)])
        + (0.0,) * (DEGREE - order)
        for values, top in zip(derivatives_between(times, start, highest), highest, strict=False)
    )
    fields = _fields("profile", times=list(times), start=list(start), highest=list(highest))
    return PiecewiseReference(tuple(times), rows, order, None, fields, bound)


def derivatives_between(
    times: Sequence[float], start: Sequence[float], highest: Sequence[float]
) -> list[tuple[float, ...]]:
    """y_d ... y_d^(d-1) of a profile at all of its times."""
    order, values = len(start), tuple(start)
    rows = [values]
    for top, begin, end in zip(highest, times, times[1:], strict=False):
        every, powers = (*values, top), [1.0]
        for j in range(order):
            powers.append(powers[-1] * (end - begin) / (j + 1))
        values = tuple(
            sum(every[j] * powers[j - k] for j in range(k, order + 1)) for k in range(order)
        )
        rows.append(values)
    return rows


def _fields(kind: str, **values: Any) -> tuple[tuple[str, Any], ...]:
    plain = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return (("kind", kind), *plain.items())
