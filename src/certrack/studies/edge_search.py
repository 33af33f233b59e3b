"""Search an edge: the last value that holds before the first that fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from certrack.loops.stability import LinearLoop

#: Ratio of one value tried to the next, and of a value that fails to the one reported.
VALUE_RATIO, EDGE_RATIO = 1.25, 1.01

#: Values tried at most before the search ends without an edge.
MAX_VALUES = 60

#: Relative accuracy of the exact edge of stability.
EXACT_EDGE_TOLERANCE = 1e-12

#: Values at which the spectral radius is looked at before its edge is bracketed.
RADIUS_POINTS = 400


@dataclass(frozen=True)
class Sweep:
    """Values in geometric steps: from the start, by the ratio, until they would pass the end."""

    start: float
    ratio: float
    end: float

    def values(self) -> Iterator[float]:
        """The values, MAX_VALUES at most."""
        value = self.start
        for _ in range(MAX_VALUES):
            yield value
            if (value * self.ratio > self.end) == (self.ratio > 1):
                return
            value *= self.ratio


def last_before_failure(
    error_at: Callable[[float], float], sweep: Sweep, limit: float
) -> tuple[float | None, bool]:
    """Last value before the first failure, and whether there was none."""
    good = None
    for value in sweep.values():
        if error_at(value) <= limit:
            good = value
        elif good is None:
            return None, False
        else:
            return _bisected(error_at, good, value, limit), False
    return good, True


def _bisected(error_at: Callable[[float], float], good: float, bad: float, limit: float) -> float:
    """A value that holds, within EDGE_RATIO of one that fails."""
    while max(good / bad, bad / good) > EDGE_RATIO:
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if error_at(middle) <= limit else (good, middle)
    return good


def stability_edge(
    linear: LinearLoop | None,
    period_and_delay: Callable[[float], tuple[float, float]],
    sweep: Sweep,
) -> float | None:
    """First value at which the spectral radius reaches 1; None if it does not, or is not known."""
    if linear is None:
        return None
    values = np.geomspace(sweep.start, sweep.end, RADIUS_POINTS)
    radii = [linear.radius(*period_and_delay(value)) for value in values]
    k = next((k for k, radius in enumerate(radii) if radius >= 1.0), None)
    if k is None:
        return None
    if k == 0:
        return 0.0
    low, high = float(values[k - 1]), float(values[k])
    return float(
        brentq(
            lambda v: linear.radius(*period_and_delay(v)) - 1.0,
            low,
            high,
            rtol=EXACT_EDGE_TOLERANCE,
        )
    )
