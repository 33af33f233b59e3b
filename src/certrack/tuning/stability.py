"""The longest period at which a linear loop is stable, and its gradient."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from certrack.laws.leakage import longest_euler_period
from certrack.loops.stability import LinearLoop
from certrack.tuning.candidate import DIFFERENCE, Candidate
from certrack.tuning.quantities import Quantity

#: Ratio by which the edge is bracketed, its relative accuracy, and the longest period looked at
#: over the first guess.
BRACKET, EDGE_ACCURACY, FARTHEST = 1.3, 1e-9, 1e6

#: Delays are looked at up to so many periods: each is one more state.
MOST_PERIODS = 500

#: Periods below the edge at which the loop must be stable, too: down to the edge over the last.
EDGE_CHECKS, DOWN_TO = 40, 100.0


class StabilityEdge(Quantity):
    """The first period, or delay at a fixed period, at which the spectral radius reaches 1.

    Parameters
    ----------
    loop : LinearLoop
    guess : float, s
        Near which the edge is looked for.
    delay : float, periods
        That grows with the period.
    period : float, optional
        The period at which it is the delay that grows; None: the period grows.
    """

    name = "period"

    def __init__(
        self, loop: LinearLoop, guess: float, delay: float = 0.0, period: float | None = None
    ) -> None:
        self._loop, self._guess, self._period, self._delay = loop, guess, period, delay
        self._farthest = FARTHEST * guess if period is None else MOST_PERIODS * period
        self._last: tuple[Candidate, float] | None = None

    def value(self, candidate: Candidate) -> float:
        if self._last is None or self._last[0] is not candidate:
            self._last = candidate, self._edge(replace(self._loop, law=candidate.law))
        return self._last[1]

    def first(self, candidate: Candidate) -> float:
        """The same, and no period below it is unstable."""
        loop = replace(self._loop, law=candidate.law)
        edge = self.value(candidate)
        if not math.isfinite(edge):
            return edge
        below = edge / np.geomspace(1.001, DOWN_TO, EDGE_CHECKS)
        unstable = [value for value in below if self._log_radius(loop, value) >= 0]
        return float(min(unstable, default=edge))

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        """By the implicit function theorem, at log radius = 0."""
        edge = self.value(candidate)
        if not 0 < edge < math.inf:
            return np.zeros(len(candidate.v))
        ratio = math.exp(DIFFERENCE)
        loop = replace(self._loop, law=candidate.law)
        by_edge = self._log_radius(loop, edge * ratio) - self._log_radius(loop, edge / ratio)
        slopes = []
        for above, below in candidate.neighbours:
            high, low = (
                self._log_radius(replace(self._loop, law=point.law), edge)
                for point in (above, below)
            )
            slopes.append(-(high - low) / by_edge if by_edge else 0.0)
        return np.array(slopes)

    def _edge(self, loop: LinearLoop) -> float:
        low = high = self._guess
        if self._log_radius(loop, self._guess) < 0:
            while self._log_radius(loop, high) < 0:
                low, high = high, high * BRACKET
                if high > self._farthest:
                    return math.inf
        else:
            while self._log_radius(loop, low) >= 0:
                low, high = low / BRACKET, low
                if low < self._guess / FARTHEST:
                    return 0.0
        return float(brentq(lambda T: self._log_radius(loop, T), low, high, rtol=EDGE_ACCURACY))

    def _log_radius(self, loop: LinearLoop, value: float) -> float:
        T, d = (
            (value, self._delay) if self._period is None else (self._period, value / self._period)
        )
        radius = loop.radius(T, d)
        return math.log(radius) if 0 < radius < math.inf else (-50.0 if not radius else 50.0)


class DelayEdge(StabilityEdge):
    """The delay, s, that the loop bears at a period."""

    name = "delay margin"


class EstimatesPeriod(Quantity):
    """The period at which a step of forward Euler forgets all of an estimate, s.

    Beyond it the estimates alternate, and at twice the period they diverge.
    """

    name = "period of the estimates"

    def value(self, candidate: Candidate) -> float:
        return longest_euler_period(candidate.system.controller) / 2
