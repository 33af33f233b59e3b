"""Which alpha a row is bounded with next, from the slopes that were met."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

#: Factor by which alpha moves while its best value is not surrounded; and the ends of all.
STRIDE, LARGEST_ALPHA, LEAST_ALPHA = 2.5, 1e6, 1e-6

#: A step between two alpha leaves this part of their distance to either.
INNER = 0.15


@dataclass
class Rate:
    """The alpha of one row, from program to program, which change little.

    Attributes
    ----------
    alpha : float, 1/s
        To be tried next.
    """

    alpha: float
    _below: tuple[float, float] | None = field(default=None, repr=False)
    _above: tuple[float, float] | None = field(default=None, repr=False)

    def met(self, slope: float | None) -> None:
        """Take in the slope of the bound by log alpha; None where there was no bound."""
        here = math.log(self.alpha)
        if slope is None or slope > 0:
            self._above = (here, math.inf if slope is None else slope)
            if self._below is not None and self._below[0] >= here:
                self._below = None
        else:
            self._below = (here, slope)
            if self._above is not None and self._above[0] <= here:
                self._above = None
        self.alpha = math.exp(self._next(here))

    def _next(self, here: float) -> float:
        if self._below is None:
            return max(here - math.log(STRIDE), math.log(LEAST_ALPHA))
        if self._above is None:
            return min(here + math.log(STRIDE), math.log(LARGEST_ALPHA))
        (low, first), (high, last) = self._below, self._above
        part = 0.5 if last == math.inf else first / (first - last) if first < 0 else 0.0
        return low + min(max(part, INNER), 1 - INNER) * (high - low)
