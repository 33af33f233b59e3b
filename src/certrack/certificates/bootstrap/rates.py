"""Which alpha a row is bounded with next, from the slopes that were met."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

#: Factor by which alpha moves while its best value is not surrounded; and the ends of all.
STRIDE, LARGEST_ALPHA, LEAST_ALPHA = 2.5, 1e6, 1e-6

#: A step between two alpha leaves this part of their distance to either.
INNER = 0.15

#: The logarithm of an alpha, and the slope of the bound there: infinite where there is no bound.
Met = tuple[float, float]


@dataclass
class Rate:
    """The alpha of one row, from program to program, which change little.

    There is no bound where alpha is too fast, and none where it is so slow that the program is
    badly scaled. On which side an alpha without a bound is, another one with a bound tells.

    Attributes
    ----------
    alpha : float, 1/s
        To be tried next.
    """

    alpha: float
    _below: Met | None = field(default=None, repr=False)
    _above: Met | None = field(default=None, repr=False)
    _failed: list[float] = field(default_factory=list, repr=False)

    @property
    def surrounded(self) -> bool:
        """Whether the best alpha is known to be between two that were tried."""
        return self._below is not None and self._above is not None

    def met(self, slope: float | None) -> None:
        """Take in the slope of the bound by log alpha; None where there was no bound."""
        here = math.log(self.alpha)
        if slope is None:
            self._failed_at(here)
        elif slope > 0:
            self._surround(self._below, (here, slope))
        else:
            self._surround((here, slope), self._above)
        self.alpha = min(max(math.exp(self._next()), LEAST_ALPHA), LARGEST_ALPHA)

    def restart(self, alpha: float, slope: float) -> None:
        """Go on from another alpha, and what was met there; forget the others."""
        self._below = self._above = None
        self._failed.clear()
        self.alpha = alpha
        self.met(slope)

    def _failed_at(self, here: float) -> None:
        if self._below is None and self._above is None:
            self._failed.append(here)
        elif self._below is None or self._below[1] == -math.inf:
            self._below = (here, -math.inf)
        else:
            self._above = (here, math.inf)

    def _surround(self, below: Met | None, above: Met | None) -> None:
        """Take these two, unless they contradict each other: then the newer one alone."""
        if below is not None and above is not None and below[0] >= above[0]:
            below, above = (None, above) if below is self._below else (below, None)
        newer = above if below is self._below else below
        if newer is not None:
            slower = [v for v in self._failed if v < newer[0]]
            faster = [v for v in self._failed if v > newer[0]]
            below = (max(slower), -math.inf) if below is None and slower else below
            above = (min(faster), math.inf) if above is None and faster else above
        self._failed.clear()
        self._below, self._above = below, above

    def _next(self) -> float:
        stride = math.log(STRIDE)
        if self._below is not None and self._above is not None:
            (low, first), (high, last) = self._below, self._above
            finite = math.isfinite(first) and math.isfinite(last)
            part = (first / (first - last) if first < 0 else 0.0) if finite else 0.5
            return low + min(max(part, INNER), 1 - INNER) * (high - low)
        if self._below is not None:
            return self._below[0] + stride
        if self._above is not None:
            return self._above[0] - stride
        times = len(self._failed)  # faster and slower by turns
        step = (times + 1) // 2 * stride
        return self._failed[0] + (step if times % 2 else -step)


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
    program: RowProgram[_Solved],
    rows: np.ndarray,
    rate: Rate,
    tries: int,
    sweep: Sequence[float] = (),
) -> _Solved | None:
    """The smallest sum of bounds over some alpha, of which `rate` learns.

    The bound may have several minima over alpha: `rate` goes on from the best one of a sweep.
    """
    best: _Solved | None = None
    start = rate.alpha
    for alpha in sweep:
        solution = program.solve(alpha, rows)
        if solution is not None and (best is None or solution.bounds.sum() < best.bounds.sum()):
            best, start = solution, alpha
    if best is not None:
        rate.restart(start, best.slope)
    for _ in range(tries):
        solution = program.solve(rate.alpha, rows)
        rate.met(None if solution is None else solution.slope)
        if solution is not None and (best is None or solution.bounds.sum() < best.bounds.sum()):
            best = solution
    return best
