"""Any linear law: feedback K and feed-forward gain r, each in parts of that of the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certrack.core.rounding import in_digits
from certrack.laws.backstepping import Gains
from certrack.laws.base import Law
from certrack.laws.linear import Linear
from certrack.laws.recursion import recursion
from certrack.systems.system import System
from certrack.tuning.families import SPREAD, Family

#: K_i and r lie between these parts of those of the start, added to them: a stabilising K_i of a
#: chain without couplings keeps its sign.
LEAST_CHANGE, LARGEST_CHANGE = -8.0, 40.0

#: Significant digits of K: the poles answer more to it than to rates.
FEEDBACK_DIGITS = 9


class LinearFamily(Family):
    """K_i = K_i0 (1 + v_i), r = r_0 (1 + v_{n+1}); r is fixed where nothing of y_d^(n) is left.

    Every lean backstepping design is in it: random starts are such designs.
    """

    kind = "linear"

    def __init__(self, system: System, feedforward: int) -> None:
        self.plant, self._q = system.plant, feedforward
        law = system.law
        if isinstance(law, Linear):
            settled = replace(law, feedforward=feedforward).settled(self.plant)
            self._rates = rates_of(system)
            self.base = settled
        else:
            self._rates = np.array(law.c, dtype=float)
            self.base = self._backstepping(self._rates)
        self._has_r = feedforward < self.plant.n - 1
        self._centre = self._joined(np.array(self.base.K, dtype=float), self.base.r or 0.0)
        self._signs, sizes = np.where(self._centre < 0, -1.0, 1.0), np.abs(self._centre)
        self._sizes = np.where(sizes > 0, sizes, sizes.max())
        self.start = np.zeros(len(self._sizes))
        self.low, self.high = self.start + LEAST_CHANGE, self.start + LARGEST_CHANGE

    def law(self, v: np.ndarray) -> Law:
        return self._with(*self._numbers(v))

    def written(self, v: np.ndarray) -> Law:
        K, r = self._numbers(v)
        K = np.array([in_digits(value, FEEDBACK_DIGITS) for value in K])
        return self._with(K, None if r is None else in_digits(r, FEEDBACK_DIGITS))

    def random(self, rng: np.random.Generator) -> np.ndarray:
        c = self._rates * np.exp(SPREAD * rng.standard_normal(len(self._rates)))
        law = self._backstepping(c)
        numbers = self._joined(np.array(law.K, dtype=float), law.r or 0.0)
        changes = (numbers - self._centre) * self._signs / self._sizes
        return np.clip(changes, self.low, self.high)

    def _joined(self, K: np.ndarray, r: float) -> np.ndarray:
        """The tuned numbers in one array."""
        return np.append(K, r) if self._has_r else K

    def _numbers(self, v: np.ndarray) -> tuple[np.ndarray, float | None]:
        values, n = self._centre + self._signs * self._sizes * v, self.plant.n
        return values[:n], float(values[n]) if self._has_r else None

    def _with(self, K: np.ndarray, r: float | None) -> Law:
        return replace(self.base, K=tuple(map(float, K)), r=r, lqr=None)

    def _backstepping(self, c: np.ndarray) -> Linear:
        """The linear law that a lean design with these rates is."""
        design = recursion(self.plant.g, self.plant.b, Gains(tuple(c)), self._q)
        K, r = tuple(map(float, design.nu_x)), float(design.nu_Y[-1])
        return Linear(K=K, r=r, feedforward=self._q)


def rates_of(system: System) -> np.ndarray:
    """Rates c for a backstepping design about as fast as a law without them."""
    law = system.law
    if law.c:
        return np.array(law.c, dtype=float)
    typical = float(np.exp(np.log(np.abs(system.controller.coordinates.poles)).mean()))
    return np.full(system.plant.n, typical)
