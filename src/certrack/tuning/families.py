"""Which numbers of a law are tuned: a family turns a vector v into a law."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from certrack.core.rounding import in_digits
from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Law
from certrack.systems.system import System

#: Gains are searched between these, over those of the start: nobody means a gain that is 1e4 times
#: another, and the recursion's coefficients are powers of them.
LOWEST_GAIN, HIGHEST_GAIN = 1e-3, 1e3

#: Standard deviation of random starts, in logarithms of gains.
SPREAD = 0.7

#: Significant digits of a gain in the tuned file.
GAIN_DIGITS = 6

#: alpha over the fastest rate, where it is a variable: at the start, and its limits.
ALPHA_SHARE, SHARES = 0.4, (0.02, 0.97)


class Family(ABC):
    """The laws that a search goes through: one for each vector v.

    Attributes
    ----------
    kind : str
        Of the laws.
    has_share : bool
        Whether the last entry of v is no gain, but log(alpha/fastest) of the semidefinite program.
    start, low, high : arrays
        The v of the system's own law, and the ends of the search.
    """

    kind: ClassVar[str]
    has_share: ClassVar[bool] = False
    start: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @abstractmethod
    def law(self, v: np.ndarray) -> Law:
        """The law of a point."""

    @abstractmethod
    def written(self, v: np.ndarray) -> Law:
        """The law of a point, its gains rounded to the digits of a file."""

    @abstractmethod
    def random(self, rng: np.random.Generator) -> np.ndarray:
        """A point where another search may begin."""


class PositiveGains(Family):
    """Laws whose tuned numbers are positive; v are their logarithms.

    Parameters
    ----------
    system : System
        Where the search starts; its damping is left out.
    feedforward : int
        q of all of them.
    """

    def __init__(self, system: System, feedforward: int) -> None:
        self.plant = system.plant
        self.base = self._base(system.law, feedforward)
        numbers = [*self._numbers(self.base), *([ALPHA_SHARE] if self.has_share else [])]
        self.start = np.log(np.array(numbers, dtype=float))
        self.low, self.high = self.start + np.log(LOWEST_GAIN), self.start + np.log(HIGHEST_GAIN)
        if self.has_share:
            self.low[-1], self.high[-1] = np.log(SHARES)

    def law(self, v: np.ndarray) -> Law:
        return self._with(np.exp(v))

    def written(self, v: np.ndarray) -> Law:
        return self._with(np.array([in_digits(value, GAIN_DIGITS) for value in np.exp(v)]))

    def random(self, rng: np.random.Generator) -> np.ndarray:
        moved = self.start + SPREAD * rng.standard_normal(len(self.start))
        if self.has_share:
            moved[-1] = self.start[-1]
        return np.clip(moved, self.low, self.high)

    def at_speed(self, factor: float) -> np.ndarray:
        """The start with rates so many times as large: the first n numbers, if not said else."""
        v: np.ndarray = self.start.copy()
        v[: self.plant.n] += np.log(factor)
        return v

    @abstractmethod
    def _base(self, law: Law, feedforward: int) -> Law:
        """The law from which the others differ in the tuned numbers only."""

    @abstractmethod
    def _numbers(self, law: Law) -> list[float]:
        """The tuned numbers."""

    @abstractmethod
    def _with(self, values: np.ndarray) -> Law:
        """The law with these numbers."""


class RobustFamily(PositiveGains):
    """c, and where the recursion is balanced its coupling."""

    kind = "robust"

    def _base(self, law: Law, feedforward: int) -> Law:
        return replace(law, k=None, p=None, feedforward=feedforward)

    def _numbers(self, law: Law) -> list[float]:
        return [*law.c, *([] if law.coupling is None else [law.coupling])]

    def _with(self, values: np.ndarray) -> Law:
        n = len(self.base.c)
        coupling = None if self.base.coupling is None else float(values[n])
        return replace(self.base, c=tuple(map(float, values[:n])), coupling=coupling)


class AdaptiveFamily(RobustFamily):
    """c and the adaptation: gain_rate, its leaks, and the diagonal of Gamma.

    The prior guesses follow from the ranges of g_n and theta, where there are any:
    delta0 = 1/sqrt(g_low g_high) makes max_g g (1/g - delta0)^2 smallest, and theta0 is the middle.
    """

    kind = "adaptive"
    has_share = True

    def _base(self, law: Law, feedforward: int) -> Law:
        law = super()._base(law, feedforward)
        assert isinstance(law, Adaptive)
        if law.Gamma is not None and np.ndim(law.Gamma) == 2:
            law = replace(law, Gamma=tuple(np.diag(np.array(law.Gamma, dtype=float))))
        plant = self.plant
        if plant.input_gain_range is not None:
            low, high = map(float, plant.input_gain_range)
            delta0 = plant.gain_sign / float(np.sqrt(low * high))
            law = replace(law, delta0=in_digits(delta0, GAIN_DIGITS))
        if plant.theta_range is not None:
            middle = tuple((float(a) + float(b)) / 2 for a, b in plant.theta_range)
            law = replace(law, theta0=middle)
        return law

    def _numbers(self, law: Law) -> list[float]:
        assert isinstance(law, Adaptive)
        Gamma = [1.0] * self.plant.r if law.Gamma is None else [float(v) for v in law.Gamma]
        adaptation = [law.gain_rate, law.leak_gain, law.leak_theta, *Gamma]
        return super()._numbers(law) + adaptation

    def _with(self, values: np.ndarray) -> Law:
        first = len(super()._numbers(self.base))
        law = super()._with(values[:first])
        adaptation = values[first : first + 3 + self.plant.r]
        gain_rate, leak_gain, leak_theta, *Gamma = map(float, adaptation)
        assert isinstance(law, Adaptive)
        return replace(
            law,
            gain_rate=gain_rate,
            leak_gain=leak_gain,
            leak_theta=leak_theta,
            Gamma=tuple(Gamma) or None,
        )
