"""When the first of several functions of time gets negative on a step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: A step is looked at in this many parts; again in halves, up to `MAX_BISECTIONS` times, while
#: every other sample differs from the cubic through its neighbours by `UNRESOLVED` of the range.
LOOKS_PER_STEP, MAX_BISECTIONS, UNRESOLVED = 16, 8, 0.1

#: Iterations that locate an event; each at least every third halves the interval.
MAX_TRIALS = 120

#: An event's interval is this part of the time at last.
EVENT_TIME_ROUNDING = 4e-16


def first_event(
    holds: Callable[[np.ndarray], np.ndarray],
    length: float,
    rounding: float,
    begin: float = 0.0,
    halvings: int = MAX_BISECTIONS,
) -> tuple[float, int] | None:
    """The first time after which a row is negative, within `rounding`, and the row; or None."""
    since = begin + (length - begin) * np.arange(LOOKS_PER_STEP + 1) / LOOKS_PER_STEP
    values = holds(since)
    if halvings and _unresolved(values):
        middle = (begin + length) / 2
        for a, b in ((begin, middle), (middle, length)):
            event = first_event(holds, b, rounding, a, halvings - 1)
            if event is not None:
                return event
        return None
    earliest: tuple[float, int] | None = None
    for row, samples in enumerate(values):

        def value(at: float, row: int = row) -> float:
            return float(holds(np.array([at]))[row, 0])

        at = first_root(value, since, samples, rounding)
        if at is not None and (earliest is None or at < earliest[0]):
            earliest = at, row
    return earliest


def _unresolved(values: np.ndarray) -> bool:
    """Whether samples vary too much between their neighbours to be trusted."""
    middle = values[:, 3:-3:2]
    cubic = (9 * (values[:, 2:-4:2] + values[:, 4:-2:2]) - values[:, :-6:2] - values[:, 6::2]) / 16
    span = values.max(axis=1) - values.min(axis=1)
    with np.errstate(all="ignore"):
        excess = np.abs(middle - cubic).max(axis=1) > UNRESOLVED * span
    return bool((excess & (span > 1e-9 * np.abs(values).max(axis=1))).any())


def first_root(
    value: Callable[[float], float], since: np.ndarray, samples: np.ndarray, rounding: float
) -> float | None:
    """When a row first gets negative."""
    negative = np.flatnonzero(samples < 0.0)
    first = int(negative[0]) if negative.size else len(samples)
    inner = samples[1:-1]
    dips = np.flatnonzero((inner < samples[:-2]) & (inner <= samples[2:])) + 1
    for j in dips[dips < first]:  # between three samples it may touch zero unseen
        rise = samples[j - 1] - 2 * samples[j] + samples[j + 1]
        if samples[j] > rise:
            continue
        at, low = _lowest(value, float(since[j - 1]), float(since[j + 1]))
        if low < 0.0:
            return _root(value, float(since[j - 1]), at, rounding)
    if not negative.size:
        return None
    if first == 0:
        return float(since[0]) + rounding
    return _root(value, float(since[first - 1]), float(since[first]), rounding)


def _lowest(value: Callable[[float], float], a: float, b: float) -> tuple[float, float]:
    """The lowest point between a and b, by golden sections; stops where it is negative."""
    ratio = 0.6180339887498949
    c, d = b - ratio * (b - a), a + ratio * (b - a)
    fc, fd = value(c), value(d)
    for _ in range(40):
        if min(fc, fd) < 0.0:
            break
        if fc < fd:
            b, d, fd = d, c, fc
            c = b - ratio * (b - a)
            fc = value(c)
        else:
            a, c, fc = c, d, fd
            d = a + ratio * (b - a)
            fd = value(d)
    return (c, fc) if fc < fd else (d, fd)


def _root(value: Callable[[float], float], a: float, b: float, rounding: float) -> float:
    """The end of an interval of length `rounding` at whose end the value is negative."""
    fa, fb = value(a), value(b)
    side = 0
    for i in range(MAX_TRIALS):  # Illinois, and every third time the middle
        if b - a <= rounding:
            break
        c = (a + b) / 2 if i % 3 == 2 or not fa > fb else (a * fb - b * fa) / (fb - fa)
        c = min(max(c, a + rounding / 2), b - rounding / 2)
        fc = value(c)
        if fc < 0.0:
            b, fb = c, fc
            fa, side = (fa / 2 if side == 1 else fa), 1
        else:
            a, fa = c, fc
            fb, side = (fb / 2 if side == -1 else fb), -1
    return b
