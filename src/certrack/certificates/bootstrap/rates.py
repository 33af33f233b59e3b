"""Which alpha a row is bounded with next, from the slopes that were met."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

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

    @property
    def surrounded(self) -> bool:
        """Whether the best alpha is known to be between two that were tried."""
        return self._below is not None and self._above is not None

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


class Solved(Protocol):
    """A minimiser."""

    @property
    def bounds(self) -> np.ndarray:
        """Of every row, in its unit."""

    @property
    def slope(self) -> float:
        """Derivative of their sum by log alpha."""


_Solved = TypeVar("_Solved", bound=Solved)
_SolvedOut = TypeVar("_SolvedOut", bound=Solved, covariant=True)


class RowProgram(Protocol[_SolvedOut]):
    """A program that bounds rows with a given decay rate."""

    def solve(self, alpha: float, rows: np.ndarray) -> _SolvedOut | None:
        """The smallest bounds; None if there are none."""


def best_of_rates(
    program: RowProgram[_Solved], rows: np.ndarray, rate: Rate, tries: int
) -> _Solved | None:
    """The smallest sum of bounds over some alpha, of which `rate` learns."""
    best: _Solved | None = None
    for _ in range(tries):
        solution = program.solve(rate.alpha, rows)
        rate.met(None if solution is None else solution.slope)
        if solution is not None and (best is None or solution.bounds.sum() < best.bounds.sum()):
            best = solution
    return best
