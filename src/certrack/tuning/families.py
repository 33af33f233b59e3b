"""Which numbers of a law are tuned: its positive gains, as logarithms.

A family turns a vector v into a law. To give a law a family, write a class here and list it in
:data:`FAMILIES`; all else follows from the law's own certificate.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from certrack.core.errors import InputError
from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Law
from certrack.laws.classic import Classic
from certrack.laws.robust import Robust
from certrack.systems.system import System

#: Gains are searched between these, over those of the start: nobody means a gain that is 1e4 times
#: another, and the recursion's coefficients are powers of them.
LOWEST_GAIN, HIGHEST_GAIN = 1e-3, 1e3

#: Significant digits of a gain in the tuned file.
GAIN_DIGITS = 6

#: alpha over the fastest rate, where it is a variable: at the start, and its limits.
ALPHA_SHARE, SHARES = 0.4, (0.02, 0.97)


class Family(ABC):
    """The laws that a search goes through.

    Parameters
    ----------
    system : System
        Where the search starts; its damping is left out.
    feedforward : int
        q of all of them.
    """

    kind: ClassVar[str]
    #: Whether the last entry of v is no gain, but log(alpha/fastest) of the semidefinite program.
    has_share: ClassVar[bool] = False

    def __init__(self, system: System, feedforward: int) -> None:
        self.plant = system.plant
        self.base = self._base(system.law, feedforward)
        numbers = [*self._numbers(self.base), *([ALPHA_SHARE] if self.has_share else [])]
        self.start = np.log(np.array(numbers, dtype=float))

    @property
    def low(self) -> np.ndarray:
        """Lower ends of v."""
        low: np.ndarray = self.start + np.log(LOWEST_GAIN)
        if self.has_share:
            low[-1] = np.log(SHARES[0])
        return low

    @property
    def high(self) -> np.ndarray:
        """Upper ends of v."""
        high: np.ndarray = self.start + np.log(HIGHEST_GAIN)
        if self.has_share:
            high[-1] = np.log(SHARES[1])
        return high

    def law(self, v: np.ndarray) -> Law:
        """The law of a point."""
        return self._with(np.exp(v))

    def written(self, v: np.ndarray) -> Law:
        """The law of a point, its gains rounded to the digits of a file."""
        return self._with(np.array([float(f"{value:.{GAIN_DIGITS}g}") for value in np.exp(v)]))

    @abstractmethod
    def _base(self, law: Law, feedforward: int) -> Law:
        """The law from which the others differ in the tuned numbers only."""

    @abstractmethod
    def _numbers(self, law: Law) -> list[float]:
        """The tuned numbers."""

    @abstractmethod
    def _with(self, values: np.ndarray) -> Law:
        """The law with these numbers."""


class RobustFamily(Family):
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
            law = replace(law, delta0=float(f"{delta0:.{GAIN_DIGITS}g}"))
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


#: The family of each kind of law.
FAMILIES: Mapping[str, type[Family]] = {
    family.kind: family for family in (RobustFamily, AdaptiveFamily)
}


def tuning_family(system: System, kind: str, feedforward: int) -> Family:
    """The family in which `system` is tuned.

    Raises
    ------
    InputError
        If laws of this kind have none, or the plant does not tell what they must know.
    """
    if kind not in FAMILIES:
        why = "has no certificate: without leakage no bound exists" if kind == Classic.kind else ""
        raise InputError(
            "law.kind",
            f"{why or 'has no gains that tune knows'}",
            kind,
            f"Choose --law {' or --law '.join(FAMILIES)}",
        )
    return FAMILIES[kind](_with_law(system, kind, feedforward), feedforward)


def _with_law(system: System, kind: str, feedforward: int) -> System:
    """The system with a law of this kind, c and coupling of its own."""
    law = system.law
    if law.kind == kind:
        return system
    known = {"robust": Robust, "adaptive": Adaptive}[kind]
    same = {"c": law.c, "coupling": law.coupling, "feedforward": feedforward}
    return system.replace(law=known(**same), settings=replace(system.settings, estimates=None))
