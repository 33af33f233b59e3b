"""A complete tracking problem: plant, truth, reference, law and how to run it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.laws.base import Controller, Law
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.references import Reference, require_order

MAX_PERIODS = 20_000

INTEGRATORS = ("auto", "taylor", "scipy", "implicit")


@dataclass(frozen=True)
class Settings:
    """How a run is carried out and judged.

    Parameters
    ----------
    x0 : n numbers
        Initial plant state; that of the truth where it has states of its own.
    duration : float > 0, s
        Length of the run; it starts at t = 0.
    estimates : numbers, optional
        Initial controller states (delta_hat, theta_hat ...); zero if left out.
    tolerance : float
        Relative and absolute tolerance of the integrator.
    integrator : {"auto", "taylor", "scipy", "implicit"}
        ``auto`` takes the Taylor method, or an implicit one where the design is stiff.
    band : float > 0, optional
        |e_1| has settled when it stays within this band; 5 % of the largest |y_d| if left out.
    tail : float, s, optional
        The tail error is the largest |e_1| from this time on; half the duration if left out.
    max_state : float
        The run has escaped when a plant state passes this magnitude.
    """

    x0: tuple[float, ...]
    duration: float
    estimates: tuple[float, ...] | None = None
    tolerance: float = 1e-9
    integrator: str = "auto"
    band: float | None = None
    tail: float | None = None
    max_state: float = 1e9

    def __post_init__(self) -> None:
        values: dict[str, Any] = {
            "x0": checks.reals("simulation.x0", self.x0, None, "one number per state"),
            "duration": checks.real("simulation.duration", self.duration, above=0),
            "max_state": checks.real("simulation.max_state", self.max_state, above=0),
            "tolerance": checks.real("simulation.tolerance", self.tolerance, least=1e-14),
        }
        for i, start in enumerate(values["x0"]):
            if abs(start) > values["max_state"]:
                raise InputError(
                    f"simulation.x0[{i}]", "must be within simulation.max_state", start
                )
        if values["tolerance"] > 1e-2:
            raise InputError("simulation.tolerance", "must be at most 0.01", self.tolerance)
        checks.choice("simulation.integrator", self.integrator, INTEGRATORS)
        if self.estimates is not None:
            what = "one number per controller state"
            values["estimates"] = checks.reals("simulation.estimates", self.estimates, None, what)
        if self.band is not None:
            values["band"] = checks.real("simulation.band", self.band, above=0)
        if self.tail is not None:
            values["tail"] = checks.real("simulation.tail", self.tail, least=0)
            if values["tail"] >= values["duration"]:
                raise InputError("simulation.tail", "must be before the end of the run", self.tail)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def tail_start(self) -> float:
        """Time from which the tail error is taken, s."""
        return self.duration / 2 if self.tail is None else self.tail


@dataclass(frozen=True)
class System:
    """Plant, truth, reference, law and settings that fit each other.

    A population, if given, says what varies between the members of an ensemble; an implementation,
    that the controller is sampled.

    Raises
    ------
    InputError
        If a part does not fit another: shapes, signs, or a reference that is not smooth enough.
    """

    plant: Plant
    law: Law
    reference: Reference
    truth: Truth
    settings: Settings
    title: str = ""
    population: Population | None = None
    implementation: Implementation | None = None

    def __post_init__(self) -> None:
        for name, kind in (
            ("plant", Plant),
            ("law", Law),
            ("truth", Truth),
            ("settings", Settings),
        ):
            if not isinstance(getattr(self, name), kind):
                raise InputError(name, f"must be a {kind.__name__}", getattr(self, name))
        plant = self.plant
        object.__setattr__(self, "truth", self.truth.bound_to(plant))
        what = "one number per state"
        if self.truth.states:
            what += f" of the truth ({', '.join(self.truth.states)})"
        checks.sequence("simulation.x0", self.settings.x0, len(self.simulated_states), what)
        controller = self.controller
        for state in controller.states:
            if state.name in (*plant.states, *self.simulated_states):
                raise InputError("law", "has a state of this name already", state.name, "Rename it")
        if self.population is not None:
            if not isinstance(self.population, Population):
                raise InputError("population", "must be a Population", self.population)
            bound = self.population.bound_to(plant, self.truth, len(controller.states))
            object.__setattr__(self, "population", bound)
            for i, entry in enumerate(bound.x0 or ()):
                if max(abs(entry.low), abs(entry.high)) > self.settings.max_state:
                    raise InputError(f"ensemble.x0[{i}]", "must be within simulation.max_state")
        if self.implementation is not None:
            if not isinstance(self.implementation, Implementation):
                raise InputError("implementation", "must be an Implementation", self.implementation)
            implementation = self.implementation.bound_to(plant, len(controller.states))
            implementation.samples(self.settings.duration)
            object.__setattr__(self, "implementation", implementation)
        period = getattr(self.reference, "period", None)
        if period is not None and self.settings.duration > MAX_PERIODS * period:
            raise InputError(
                "reference.period",
                f"must not repeat more than {MAX_PERIODS} times in simulation.duration",
                period,
            )
        q = controller.coordinates.q
        require_order(self.reference, q + 1, f"this design (law.feedforward = {q})")
        if self.settings.estimates is not None:
            names = ", ".join(state.name for state in controller.states) or "none"
            checks.sequence(
                "simulation.estimates",
                self.settings.estimates,
                len(controller.states),
                f"the controller states ({names})",
            )

    @cached_property
    def controller(self) -> Controller:
        """The law made for the plant."""
        return self.law.design(self.plant)

    @property
    def varied(self) -> Population:
        """What varies between the members of an ensemble: as stated, or by default."""
        return self.population or Population.default(self.plant, self.truth)

    @property
    def simulated_states(self) -> tuple[str, ...]:
        """Names of the simulated plant's states: the truth's own, or those of the design."""
        return self.truth.states or self.plant.states

    def replace(self, **changes: Any) -> System:
        """A copy with some parts replaced, checked again."""
        return replace(self, **changes)

    def with_settings(self, **changes: Any) -> System:
        """A copy with some settings replaced."""
        return replace(self, settings=replace(self.settings, **changes))

    @property
    def estimates(self) -> tuple[float, ...]:
        """Initial values of the controller's states."""
        return self.settings.estimates or (0.0,) * len(self.controller.states)

    @property
    def start(self) -> tuple[float, ...]:
        """Initial values of plant and controller states."""
        return self.settings.x0 + self.estimates
