"""Samples of a reference, interpolated by a monotone curve or by a spline of any odd degree."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references.piecewise import PiecewiseReference

#: Units of time in which samples may be given, s.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}

#: More samples than this fill the memory of a small machine while the coefficients are computed.
MAX_REFERENCE_SAMPLES = 1_000_000

#: What lies between the samples, and the degrees of a spline that is told by its degree.
INTERPOLATIONS, SPLINE_DEGREES = ("monotone", "cubic", "spline"), (3, 5, 7, 9)

TOO_CLOSE = ("reference.times", "must not be so close that the slopes overflow")


def samples(
    times: tuple[float, ...],
    values: tuple[float, ...],
    interpolation: str = "monotone",
    bound: float | None = None,
    time_unit: str = "s",
    degree: int | None = None,
    repeat: bool = False,
) -> PiecewiseReference:
    """Interpolated samples, held before the first and after the last, or repeated.

    Parameters
    ----------
    times : m >= 2 increasing times, in the unit of time
    values : m numbers
        y_d at these times, unit of the output.
    interpolation : {"monotone", "cubic", "spline"}
        Monotone never overshoots the data; cubic has a continuous second derivative inside. Both
        start and end with zero slope, so that holding keeps y_d' continuous (order 2). A spline of
        degree 2q + 1 starts and ends with q derivatives that are zero (order q + 1).
    bound : float, optional
        D of Assumption 2.
    time_unit : {"s", "ms", "us", "min"}
        Of the times.
    degree : {3, 5, 7, 9}, optional
        Of a spline, 5 if left out.
    repeat : bool
        Whether the last sample is the first of the next turn: it must have its value. Of splines.

    Returns
    -------
    PiecewiseReference

    Examples
    --------
    >>> from certrack.references import samples
    >>> samples((0, 1, 2), (0, 0.5, 0), interpolation="spline", degree=7).order
    4.0
    """
    checks.choice("reference.interpolation", interpolation, INTERPOLATIONS)
    times = checks.reals("reference.times", times, None, "sample times, s")
    values = checks.reals("reference.values", values, len(times), "one value per time")
    if not 2 <= len(times) <= MAX_REFERENCE_SAMPLES:
        wanted = f"must be 2 to {MAX_REFERENCE_SAMPLES} samples"
        raise InputError("reference.times", wanted, len(times))
    unit = TIME_UNITS[checks.choice("reference.time_unit", time_unit, TIME_UNITS)]
    t, y = np.array(times) * unit, np.array(values)
    late = np.flatnonzero(np.diff(t) <= 0)
    if late.size:
        i = int(late[0]) + 1
        raise InputError(f"reference.times[{i}]", "times must increase", times[i])
    q = _zero_derivatives(interpolation, degree)
    _check_repeat(repeat, interpolation, values)
    rows = _hermite(t, _derivatives(t, y, interpolation, q, repeat))
    written: dict[str, Any] = {"times": times, "values": values, "interpolation": interpolation}
    written |= {"time_unit": time_unit} if time_unit != "s" else {}
    written |= {"degree": 2 * q + 1} if interpolation == "spline" else {}
    written |= {"repeat": True} if repeat else {}
    knots = tuple(t.tolist())
    period = knots[-1] - knots[0] if repeat else None
    fields = (("kind", "samples"), *written.items())
    return PiecewiseReference(knots, rows, q + 1, period, fields, bound)


def _zero_derivatives(interpolation: str, degree: Any) -> int:
    """q: how many derivatives are zero at the ends."""
    if interpolation != "spline":
        if degree is not None:
            remedy = 'State interpolation = "spline"'
            raise InputError("reference.degree", "is that of a spline", degree, remedy)
        return 1
    degree = 5 if degree is None else degree
    if degree not in SPLINE_DEGREES or isinstance(degree, bool):
        wanted = "must be " + " or ".join(map(str, SPLINE_DEGREES))
        raise InputError("reference.degree", wanted, checks.as_written(degree))
    return (int(degree) - 1) // 2


def _check_repeat(repeat: Any, interpolation: str, values: tuple[float, ...]) -> None:
    if not isinstance(repeat, bool):
        raise InputError("reference.repeat", "must be true or false", repeat)
    if not repeat:
        return
    if interpolation == "monotone":
        remedy = 'State interpolation = "cubic" or "spline"'
        raise InputError("reference.repeat", "is for splines", interpolation, remedy)
    if values[0] != values[-1]:
        what = f"must be the first value, {values[0]:g}, where it repeats"
        raise InputError(f"reference.values[{len(values) - 1}]", what, values[-1])
    if len(values) < 3:
        raise InputError("reference.times", "must be 3 samples or more to repeat", len(values))


def _derivatives(t: np.ndarray, y: np.ndarray, kind: str, q: int, repeat: bool) -> np.ndarray:
    """y and its first q derivatives at all samples, a row each."""
    from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

    def curve() -> Callable[..., np.ndarray]:
        if kind == "monotone":
            return PchipInterpolator(t, y)
        if q == 1:
            return CubicSpline(t, y, bc_type="periodic" if repeat else "clamped")
        ends = [(k, 0.0) for k in range(1, q + 1)]
        condition = "periodic" if repeat else (ends, ends)
        return make_interp_spline(t, y, k=2 * q + 1, bc_type=condition)

    try:
        with np.errstate(all="ignore"):
            spline = curve()
            slopes = [np.array(spline(t, k)) for k in range(1, q + 1)]
    except (ValueError, ArithmeticError):
        raise InputError(*TOO_CLOSE) from None
    table = np.array([y, *slopes])
    if repeat:
        table[:, -1] = table[:, 0]
    else:
        table[1:, [0, -1]] = 0.0
    return table


def _hermite(t: np.ndarray, table: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Polynomials with these derivatives at both ends of every piece, a row each."""
    width, count = np.diff(t), len(table)
    powers = range(2 * count)
    taylor = np.array([[math.perm(j, k) for j in powers] for k in range(count)], dtype=float)
    with np.errstate(all="ignore"):
        scales = width[None] ** np.arange(count)[:, None]
        left, right = table[:, :-1] * scales, table[:, 1:] * scales
        low = left / np.array([math.factorial(k) for k in range(count)], dtype=float)[:, None]
        high = np.linalg.solve(taylor[:, count:], right - taylor[:, :count] @ low)
        rows = np.vstack([low, high]) / width[None] ** np.arange(2 * count)[:, None]
    if not np.isfinite(rows).all():
        raise InputError(*TOO_CLOSE)
    return tuple(map(tuple, rows.T.tolist()))
