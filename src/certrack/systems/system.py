"""A complete tracking problem: plant, truth, reference, law and how to run it."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError, shorten
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.core.notebook import ShownInNotebooks
from certrack.core.once import without_results
from certrack.laws.base import Controller, Law
from certrack.laws.baselines.mpc import planned_limits
from certrack.laws.leakage import longest_euler_period
from certrack.laws.observer_model import observer_model
from certrack.laws.online import LEVEL
from certrack.laws.plant_coordinates import output_derivatives
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.references import Reference, SoftStart, check_reference, require_order
from certrack.systems.design import Design, design

#: More periods of the reference than this in a run are refused: each is several pieces to stop at.
MAX_REPEATS = 20_000

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
        Initial controller states (delta_hat, theta_hat ...); if left out, what the law states, or
        zero.
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

    x0: tuple[float, ...] = keyed(
        "numbers",
        help="initial state; that of the truth's own states if it has some",
        shape="one number per state",
    )
    duration: float = keyed("number", help="length of the run", unit="s", above=0)
    estimates: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="initial controller states, not the prior guesses",
        shape="one number per controller state",
        otherwise="those of the law",
    )
    tolerance: float = keyed(
        "number",
        1e-9,
        help="relative and absolute tolerance of the integrator",
        least=1e-14,
        most=1e-2,
    )
    integrator: str = keyed("choice", "auto", help="how the run is integrated", choices=INTEGRATORS)
    band: float | None = keyed(
        "number",
        None,
        help="settled when |e_1| stays within",
        above=0,
        otherwise="5 % of max |y_d|",
    )
    tail: float | None = keyed(
        "number",
        None,
        help="the tail error is taken from here",
        unit="s",
        least=0,
        otherwise="duration/2",
    )
    max_state: float = keyed(
        "number", 1e9, help="the run has escaped when a state passes this", above=0
    )

    def __post_init__(self) -> None:
        check_fields(self, "simulation")
        for i, start in enumerate(self.x0):
            if abs(start) > self.max_state:
                raise InputError(
                    f"simulation.x0[{i}]", "must be within simulation.max_state", start
                )
        if self.tail is not None and self.tail >= self.duration:
            raise InputError("simulation.tail", "must be before the end of the run", self.tail)

    @property
    def tail_start(self) -> float:
        """Time from which the tail error is taken, s."""
        return self.duration / 2 if self.tail is None else self.tail


@dataclass(frozen=True)
class System(ShownInNotebooks):
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
    title: str = keyed("text", "", help="shown in tables and pictures", otherwise="none")
    population: Population | None = None
    implementation: Implementation | None = None

    def __post_init__(self) -> None:
        self._check_parts()
        set_fields(self, truth=self.truth.bound_to(self.plant))
        what = "one number per state"
        if self.truth.states:
            what += f" of the truth ({', '.join(self.truth.states)})"
        checks.sequence("simulation.x0", self.settings.x0, len(self.simulated_states), what)
        for state in self.controller.states:
            if state.name in (*self.plant.states, *self.simulated_states):
                raise InputError("law", "has a state of this name already", state.name, "Rename it")
        self._bind_population()
        self._bind_implementation()
        self._join_reference()
        self._check_reference()
        if self.settings.estimates is not None:
            names = ", ".join(state.name for state in self.controller.states) or "none"
            checks.sequence(
                "simulation.estimates",
                self.settings.estimates,
                len(self.controller.states),
                f"the controller states ({names})",
            )
            self._check_level("simulation", [(v, v) for v in self.settings.estimates])

    def _check_level(self, table: str, estimates: Sequence[tuple[float, float]]) -> None:
        """Refuse gains that begin beyond their ends."""
        for i, (state, (low, high)) in enumerate(
            zip(self.controller.states, estimates, strict=False)
        ):
            if state == LEVEL and not 0 <= low <= high <= 1:
                raise InputError(f"{table}.estimates[{i}]", f"must be 0 to 1: it is {LEVEL}")

    def _check_parts(self) -> None:
        required = {"plant": Plant, "law": Law, "truth": Truth, "settings": Settings}
        optional = {"population": Population, "implementation": Implementation}
        for name, kind in (required | optional).items():
            part = getattr(self, name)
            if not isinstance(part, kind) and not (part is None and name in optional):
                article = "an" if kind is Implementation else "a"
                raise InputError(name, f"must be {article} {kind.__name__}", part)
        check_fields(self, "", "title")

    def _bind_population(self) -> None:
        if self.population is None:
            return
        states = len(self.controller.states)
        population = self.population.bound_to(self.plant, self.truth, states)
        set_fields(self, population=population)
        limits = [(entry.low, entry.high) for entry in population.estimates or ()]
        self._check_level("ensemble", limits)
        for i, entry in enumerate(population.x0 or ()):
            if max(abs(entry.low), abs(entry.high)) > self.settings.max_state:
                raise InputError(f"ensemble.x0[{i}]", "must be within simulation.max_state")

    def _bind_implementation(self) -> None:
        planned_limits(self.law, self.implementation)  # refuses limits that no plan can keep
        if self.implementation is None:
            return
        implementation = self.implementation.bound_to(self.plant, len(self.controller.states))
        implementation.samples(self.settings.duration)
        if implementation.update == "euler":
            self._check_leak(implementation.period)
            if self.law.online is not None:
                self.law.online.check_period(implementation.period)
        if self.law.observer is not None:
            observer_model(self.plant, self.law, implementation)
        set_fields(self, implementation=implementation)

    def _check_leak(self, period: float) -> None:
        """Refuse a period at which Euler's step makes the estimates diverge by their own leak."""
        longest = longest_euler_period(self.controller)
        if period >= longest:
            raise InputError(
                "implementation.period",
                f"must be below {longest:.4g} s: there a step of forward Euler overshoots the "
                "estimates' leakage (Gamma leak_theta, gain_rate leak_gain) by as much as it "
                "corrects, and the estimates diverge",
                period,
                'Set implementation.update = "exact_leak", or a shorter period',
            )

    def _join_reference(self) -> None:
        """A soft start begins at the state where the run begins."""
        if not isinstance(self.reference, SoftStart):
            return
        if self.truth.states:
            message = "needs the state of the design, and the truth has states of its own"
            raise InputError("reference.transient", message, remedy="Leave it out")
        start = output_derivatives(self.plant) @ np.array(self.settings.x0)
        set_fields(self, reference=self.reference.joined(tuple(start.tolist())))

    def _check_reference(self) -> None:
        order = self.controller.coordinates.q + 1
        check_reference(self.reference, 1, self.settings.duration)
        period = getattr(self.reference, "period", None)
        if period is not None and self.settings.duration > MAX_REPEATS * period:
            raise InputError(
                "reference.period",
                f"must not repeat more than {MAX_REPEATS} times in simulation.duration",
                period,
            )
        require_order(self.reference, order, f"this design (law.feedforward = {order - 1})")
        check_reference(self.reference, order, self.settings.duration)

    def __getstate__(self) -> dict[str, object]:
        return without_results(vars(self))

    @cached_property
    def long_run(self) -> System:
        """The same without a transient part of its reference, for what holds in the long run."""
        if not isinstance(self.reference, SoftStart):
            return self
        return self.replace(reference=self.reference.long_run)

    @cached_property
    def controller(self) -> Controller:
        """The law made for the plant."""
        return self.law.design(self.plant)

    def design(self) -> Design:
        """Error coordinates, virtual controls and control law, as numbers and as formulas.

        Returns
        -------
        Design

        Examples
        --------
        >>> import certrack
        >>> certrack.load("example1").design().coordinates.n
        2
        """
        return design(self)

    @property
    def varied(self) -> Population:
        """What varies between the members of an ensemble: as stated, or by default."""
        return self.population or Population.default(self.plant, self.truth)

    @property
    def simulated_states(self) -> tuple[str, ...]:
        """Names of the simulated plant's states: the truth's own, or those of the design."""
        return self.truth.states or self.plant.states

    def __repr__(self) -> str:
        implementation = self.implementation
        how = (
            "continuous" if implementation is None else f"sampled every {implementation.period:g} s"
        )
        text = f"{self.law.kind} law, order {self.plant.n}, {how}, {self.settings.duration:g} s"
        return f"System({shorten(self.title)!r}: {text})"

    def replace(self, **changes: Any) -> System:
        """A copy with some parts replaced, checked again.

        Parameters
        ----------
        **changes
            Parts by name.

        Returns
        -------
        System

        Examples
        --------
        >>> import certrack
        >>> system = certrack.load("example1")
        >>> system.replace(title="mine").title
        'mine'
        """
        checks.known_keys("system", changes, [entry.name for entry in fields(self)])
        return replace(self, **changes)

    def with_settings(self, **changes: Any) -> System:
        """A copy with some settings replaced.

        A stated tail keeps its share of the run where only the duration changes.

        Parameters
        ----------
        **changes
            Entries of :class:`Settings` by name.

        Returns
        -------
        System

        Examples
        --------
        >>> import certrack
        >>> certrack.load("example1").with_settings(x0=(0, 0)).settings.x0
        (0.0, 0.0)
        """
        checks.known_keys("settings", changes, keys_of(Settings))
        tail, duration = self.settings.tail, changes.get("duration")
        if tail is not None and "tail" not in changes and isinstance(duration, numbers.Real):
            changes["tail"] = float(duration) * (tail / self.settings.duration)
        return replace(self, settings=replace(self.settings, **changes))

    @property
    def estimates(self) -> tuple[float, ...]:
        """Initial values of the controller's states."""
        stated = self.settings.estimates
        return self.controller.start if stated is None else stated

    @property
    def start(self) -> tuple[float, ...]:
        """Initial values of plant and controller states."""
        return self.settings.x0 + self.estimates


def require_system(system: Any, key: str = "system") -> None:
    """Refuse what is no system, such as the name of a file, where one is needed."""
    if not isinstance(system, System):
        raise InputError(key, "must be a System", system, "certrack.load makes one")
