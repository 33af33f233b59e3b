"""The laws that enter a comparison: which of their numbers are searched, and where they begin."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import CertrackError, InputError
from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Law
from certrack.laws.baselines.base import Baseline, weight_at
from certrack.laws.baselines.mpc import Mpc
from certrack.laws.classic import Classic
from certrack.laws.linear import Linear
from certrack.laws.lqr import LqrWeights
from certrack.laws.plant_coordinates import output_derivatives
from certrack.laws.registry import BASELINES
from certrack.laws.robust import Robust
from certrack.references.base import Reference
from certrack.simulation.planned_input import quadratic_programs
from certrack.systems.system import Settings, System
from certrack.tuning.families import AdaptiveFamily, PositiveGains, RobustFamily
from certrack.tuning.linear_family import rates_of

#: Gains of rivals are searched up to so many times those of the start, and down as far: their units
#: differ, and so may their sizes.
RIVAL_FACTOR = 1e6

#: First weights of the other states, in parts of that of the output where they move as it does.
WEIGHT_RATIO = 0.1

#: Damping with which the paper's law begins.
FIRST_DAMPING = 1.0

#: Adaptation gain with which the classic law begins.
FIRST_ADAPTATION = 1.0


class RivalGains(PositiveGains):
    """Gains that begin as fast as the file's own law, in a wide box."""

    def __init__(self, system: System, feedforward: int) -> None:
        self._rate = float(np.exp(np.log(rates_of(system)).mean()))
        super().__init__(system, feedforward)
        self.low, self.high = (
            self.start + v for v in (-np.log(RIVAL_FACTOR), np.log(RIVAL_FACTOR))
        )

    def at_speed(self, factor: float) -> np.ndarray:
        return np.log(np.array(self._at_rate(self.base, factor * self._rate)))

    def _numbers(self, law: Law) -> list[float]:
        return self._at_rate(law, self._rate)

    @abstractmethod
    def _at_rate(self, law: Law, rate: float) -> list[float]:
        """The tuned numbers of a loop that is about so fast, 1/s."""


class BaselineFamily(RivalGains):
    """The gains that a baseline says are its tuned ones."""

    def __init__(self, system: System, law: type[Baseline], feedforward: int) -> None:
        self._law = law
        super().__init__(system, feedforward)

    def _base(self, law: Law, feedforward: int) -> Law:
        if type(law) is self._law:
            return replace(law, feedforward=feedforward)
        return self._law(feedforward=feedforward, observer=law.observer)

    def _at_rate(self, law: Law, rate: float) -> list[float]:
        assert isinstance(law, Baseline)
        gains = law.gains_at(self.plant, rate)
        return [gains[name] for name in self._law.tuned]

    def _with(self, values: np.ndarray) -> Law:
        gains: dict[str, Any] = dict(zip(self._law.tuned, map(float, values), strict=True))
        return replace(self.base, **gains)


class LqrFamily(RivalGains):
    """Linear feedback by the weights of all states."""

    kind = "linear"

    def _base(self, law: Law, feedforward: int) -> Law:
        lqr = LqrWeights((1.0,) * self.plant.n)
        return Linear(lqr=lqr, feedforward=feedforward, observer=law.observer)

    def _at_rate(self, law: Law, rate: float) -> list[float]:
        assert isinstance(law, Linear)
        plant, order = self.plant, np.arange(self.plant.n)
        sizes = np.abs(np.diag(output_derivatives(plant))) / rate**order  # of xi_1 by xi_i
        parts = np.where(order == 0, 1.0, WEIGHT_RATIO)
        first = weight_at(plant, law.known_gain(plant), rate)
        return [float(v) for v in first * parts * sizes**2]

    def _with(self, values: np.ndarray) -> Law:
        lqr = LqrWeights(tuple(map(float, values)))
        assert isinstance(self.base, Linear)
        return replace(self.base, lqr=lqr)


class LeanAdaptiveFamily(AdaptiveFamily):
    """c and the adaptation, without the certificate's own number."""

    has_share = False


class PaperFamily(PositiveGains):
    """c, one damping k and one p for all steps; of the reference y_d alone is used."""

    kind = "paper"

    def _base(self, law: Law, feedforward: int) -> Law:
        n = self.plant.n
        return replace(
            law,
            k=tuple((FIRST_DAMPING,) * (2 * m) for m in range(1, n + 1)),
            p=(FIRST_DAMPING,) * (n - 1),
            coupling=None,
            feedforward=0,
        )

    def _numbers(self, law: Law) -> list[float]:
        assert law.k is not None
        adaptation = (
            [law.gain_rate, law.leak_gain, law.leak_theta] if isinstance(law, Adaptive) else []
        )
        return [*law.c, law.k[0][0], FIRST_DAMPING, *adaptation]

    def _with(self, values: np.ndarray) -> Law:
        n = self.plant.n
        *c, k, p = map(float, values[: n + 2])
        rows = tuple((k,) * (2 * m) for m in range(1, n + 1))
        law = replace(self.base, c=tuple(c), k=rows, p=(p,) * (n - 1))
        if isinstance(law, Adaptive):
            rate, leak_gain, leak_theta = map(float, values[n + 2 :])
            law = replace(law, gain_rate=rate, leak_gain=leak_gain, leak_theta=leak_theta)
        return law


class ClassicFamily(PositiveGains):
    """c and the gains of an adaptation without leakage."""

    kind = "classic"

    def _base(self, law: Law, feedforward: int) -> Law:
        return Classic(c=law.c, gain_rate=FIRST_ADAPTATION)

    def _numbers(self, law: Law) -> list[float]:
        return [*law.c, FIRST_ADAPTATION, *[FIRST_ADAPTATION] * self.plant.r]

    def _with(self, values: np.ndarray) -> Law:
        n = len(self.base.c)
        assert isinstance(self.base, Classic)
        return replace(
            self.base,
            c=tuple(map(float, values[:n])),
            gain_rate=float(values[n]),
            Gamma=tuple(map(float, values[n + 1 :])) or None,
        )


def backstepping_of(system: System) -> System:
    """The system with a law of the recursion, as fast as its own where that has none."""
    if system.law.c:
        return system.replace(law=replace(system.law, sampled_feedforward=False, integral=None))
    c = tuple(map(float, rates_of(system)))
    return system.replace(law=Robust(c=c, feedforward=system.law.feedforward))


def most_feedforward(reference: Reference, n: int) -> int:
    """As many derivatives of y_d as the plant can use and the reference has."""
    return int(max(0, min(n - 1, reference.order - 1)))


def informed(system: System) -> System:
    """The system whose plant states g_n and theta; where it does not, the law's prior guesses.

    Raises
    ------
    InputError
        If nobody guesses them.
    """
    plant, law = system.plant, system.law
    stated = plant.input_gain is not None and (plant.theta is not None or not plant.r)
    if stated:
        return system
    delta0, theta0 = getattr(law, "delta0", 0.0), getattr(law, "theta0", None)
    if not delta0:
        raise InputError("law.delta0", "must say about what 1/g_n is: other laws need it")
    guesses: dict[str, Any] = {"input_gain": 1 / delta0, "theta": theta0 or (0.0,) * plant.r}
    plant = replace(plant, **guesses, input_gain_range=None, theta_range=None)
    settings = replace(system.settings, estimates=None)
    population = system.population and replace(system.population, estimates=None)
    known = Robust(c=law.c or (1.0,) * plant.n)
    return system.replace(plant=plant, law=known, settings=settings, population=population)


def _lean(system: System) -> tuple[System, PositiveGains]:
    base = backstepping_of(system)
    adaptive = isinstance(base.law, Adaptive)
    family = LeanAdaptiveFamily if adaptive else RobustFamily
    most = most_feedforward(system.reference, system.plant.n)
    return base, family(base, max(base.law.feedforward, min(1, most)))


def _paper(system: System) -> tuple[System, PositiveGains]:
    base = backstepping_of(system)
    return base, PaperFamily(base, 0)


def _classic(system: System) -> tuple[System, PositiveGains]:
    base, q = backstepping_of(system), most_feedforward(system.reference, system.plant.n)
    if isinstance(base.law, Adaptive):
        return base, ClassicFamily(base, q)
    return base, RobustFamily(base, q)


def _lqr(system: System) -> tuple[System, PositiveGains]:
    base = informed(system)
    return base, LqrFamily(base, most_feedforward(system.reference, system.plant.n))


def _baseline(law: type[Baseline]) -> Callable[[System], tuple[System, PositiveGains]]:
    def entrant(system: System) -> tuple[System, PositiveGains]:
        base = informed(system)
        if base.implementation is not None:  # Euler's method would be none of the law's doing
            exact = replace(base.implementation, update="exact_leak")
            base = base.replace(implementation=exact)
        q = most_feedforward(system.reference, system.plant.n)
        return base, BaselineFamily(base, law, q)

    return entrant


def with_input_limit(
    entrant: System, family: PositiveGains, peak_input: float
) -> tuple[System, PositiveGains]:
    """The entrant and its gains, with a law that plans within this limit of |u| if it can.

    Raises
    ------
    InputError
        If no plans can be made for the system.
    MissingExtra
        If there is nothing that solves them.
    """
    if not isinstance(entrant.law, Mpc):
        return entrant, family
    quadratic_programs()
    try:
        limited = entrant.replace(law=replace(entrant.law, input_limit=peak_input))
    except InputError as problem:
        raise InputError("laws", f"{Mpc.kind} does not fit: {problem}") from None
    return limited, BaselineFamily(limited, Mpc, limited.law.feedforward)


#: What a comparison may be asked for: system -> that with what the law knows, and its gains.
ENTRANTS: Mapping[str, Callable[[System], tuple[System, PositiveGains]]] = {
    "lean": _lean,
    "paper": _paper,
    "classic": _classic,
    "lqr": _lqr,
    **{law.kind: _baseline(law) for law in BASELINES},
}


def entrant_of(system: System, name: str) -> tuple[System, PositiveGains]:
    """The system with what the law of this name knows, and the family of its gains.

    Raises
    ------
    InputError
        If there is no such law, or the system does not tell what it must know.
    """
    checks.choice("laws", name, ENTRANTS)
    try:
        base, family = ENTRANTS[name](system)
        return base.replace(law=family.law(family.start), settings=_begun(base)), family
    except CertrackError as problem:
        raise InputError("laws", f"{name} does not fit: {problem}") from None


def _begun(system: System) -> Settings:
    """Settings without initial estimates, which are those of another law."""
    return replace(system.settings, estimates=None)
