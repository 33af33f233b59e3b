"""From a system and what is wanted of it to a :class:`Task`: the quantities, and their limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.scope import has_ranges
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.loops.stability import LinearLoop, linear_loop
from certrack.model.implementation import Implementation
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.certified import certified
from certrack.tuning.companion import is_memoryless
from certrack.tuning.families import AdaptiveFamily, Family
from certrack.tuning.implemented import DrivePeak, ImplementedError
from certrack.tuning.limits import Limit, Task
from certrack.tuning.quantities import (
    Largest,
    NoiseGain,
    PeakGainError,
    Quantity,
    SemidefiniteError,
)
from certrack.tuning.ranged import RangedError
from certrack.tuning.registry import tuning_family
from certrack.tuning.responses import BoxResponse, Grid, LinearEnergy, PartPeak, StartPeak
from certrack.tuning.runs import (
    MOST_CORNERS,
    TRANSIENT_PART,
    CompiledRuns,
    CornerPeak,
    Held,
    RunEnergy,
    corners,
)
from certrack.tuning.sampled_responses import input_plant
from certrack.tuning.stability import DelayEdge, EstimatesPeriod, StabilityEdge

OBJECTIVES = ("error", "peak", "energy", "period")

#: What is missing where a peak is limited and no box of starts is known.
STARTS_REMEDY = "State ensemble.x0, a range for each state"

#: The loop must be stable at so many times the file's period, or at this period without one, s.
PERIODS_IN_HAND, LEAST_PERIOD = 3.0, 0.003

#: Of the drive's saturation, the part that the nominal input from x0 may reach: the proof that it
#: is never met needs the rest, for the uncertain terms.
SATURATION_SHARE = 0.9

#: The noise gain may become so many times that of the start's design.
NOISE_FACTOR = 10.0


@dataclass(frozen=True)
class Requirements:
    """What the user asks for; None where nothing is said."""

    error: float | None = None
    peak_input: float | None = None
    energy: float | None = None
    period: float | None = None
    delay_margin: float | None = None
    noise: float | None = None
    box: Sequence[tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        for name in ("error", "peak_input", "energy", "period", "delay_margin", "noise"):
            value = getattr(self, name)
            if value is not None:
                checks.real(name, value, above=0)


class TuningProblem:
    """The quantities of a system, and the task.

    Parameters
    ----------
    base : System
        With the first law of the family; with an implementation, where the error is that of the
        loop as implemented.
    system : System
        As the user has it.
    wanted : Requirements
    objective : one of :data:`OBJECTIVES`
    family : Family, optional
        That of the base's law if left out.

    Attributes
    ----------
    box : (n, 2) array or None
        The box of starts.
    task : Task
    notes : list of str
        What the user should know.
    """

    def __init__(
        self,
        base: System,
        system: System,
        wanted: Requirements,
        objective: str,
        family: Family | None = None,
    ) -> None:
        self.base, self.system, self.wanted = base, system, wanted
        law = base.law
        self._family = family or tuning_family(base, law.kind, law.order(base.plant))
        self.notes: list[str] = []
        self.box = _box(system, wanted.box)
        self.error = _error_quantity(base)
        self._linear = input_plant(base)
        self._drive = system.implementation
        self._loop = self._held_loop()
        self._runs: CompiledRuns | None = None
        self.noise = NoiseGain(base)
        self._refuse_twice(objective)
        self.objective = self._objective(objective)
        self.task = Task(
            self.objective, objective != "period", tuple(self._limits(objective)), self._accepts()
        )

    def _refuse_twice(self, objective: str) -> None:
        name = {"peak": "peak_input"}.get(objective, objective)
        if getattr(self.wanted, name) is not None:
            raise InputError(
                name,
                f"is what is optimised, so it cannot be a limit (objective {objective})",
                remedy="Leave it out, or choose another objective",
            )

    def _objective(self, objective: str) -> Quantity:
        if objective == "error":
            return self.error
        if objective == "peak":
            quantities = self._peaks()
            return quantities[0] if len(quantities) == 1 else Largest(quantities)
        if objective == "energy":
            return self._energy()
        if self._loop is None:
            raise InputError(
                "objective",
                "a nonlinear loop has no exact longest period to be optimised",
                "period",
                "Give the period as a limit, which is simulated, and optimise the error",
            )
        return self._edge(self._loop)

    def _limits(self, objective: str) -> list[Limit]:
        wanted, limits = self.wanted, []
        if objective != "error":
            limits.append(self._error_limit())
        if wanted.peak_input is not None:
            peaks = self._peaks()
            limits += [Limit(q, wanted.peak_input, option="--peak-input") for q in peaks]
        limits += self._saturation()
        if wanted.energy is not None:
            limits.append(Limit(self._energy(), wanted.energy, option="--energy"))
        option = "" if wanted.period is None else "--period"
        if isinstance(self.error, SemidefiniteError) and self._held.update == "euler":
            limits.append(Limit(EstimatesPeriod(), self.held_period, True, option))
        if self._loop is not None and objective != "period":
            limits.append(Limit(self._edge(self._loop), self.held_period, True, option))
        if wanted.delay_margin is not None:
            limits.append(self._delay_limit(wanted.delay_margin))
        start = NoiseGain(self.system).value(self.first)
        most = NOISE_FACTOR * start if wanted.noise is None else wanted.noise
        limits.append(Limit(self.noise, most, option="" if wanted.noise is None else "--noise"))
        return limits

    @property
    def _least_limit(self) -> float:
        """The smallest of the drive's limits of |u|."""
        assert self._drive is not None and self._drive.saturation is not None
        return min(map(abs, map(float, self._drive.saturation)))

    @property
    def is_linear(self) -> bool:
        """Whether peaks and edges are computed and not simulated."""
        return self._linear is not None

    @property
    def first(self) -> Candidate:
        """The start's design: that of the base."""
        return Candidate(self._family, self.base, self._family.start)

    @property
    def _held(self) -> Implementation:
        """How a nonlinear loop is held in a simulation."""
        update = "euler" if self._drive is None else self._drive.update
        return Implementation(self.held_period, update=update)

    @property
    def held_period(self) -> float:
        """The period at which the held loop must be stable, s."""
        if self.wanted.period is not None:
            return self.wanted.period
        return LEAST_PERIOD if self._drive is None else PERIODS_IN_HAND * self._drive.period

    def _error_limit(self) -> Limit:
        if self.wanted.error is not None:
            return Limit(self.error, self.wanted.error, option="--error")
        best = certified(self.system, bootstrap=False)  # what a search can reach is without it
        if not best.verified:
            raise InputError(
                "error",
                "must be given: the system's own design has no certified error",
                remedy="Give one",
            )
        return Limit(self.error, best.bound)

    def _peaks(self) -> list[Quantity]:
        if self.box is None:
            raise InputError(
                "peak_input",
                "must hold over a box of starts, and the file has none; at a single start a small "
                "peak only means that its response happens to cancel",
                remedy=STARTS_REMEDY,
            )
        if self._linear is not None:
            response = BoxResponse(self._linear, Grid.of(self.base), self.box)
            return PartPeak.every(response, self.first)
        duration = TRANSIENT_PART * self.base.settings.duration
        first = self.first
        quantities = [
            CornerPeak(self._compiled(), tuple(map(float, corner)), duration)
            for corner in corners(self.box)
        ]
        quantities.sort(key=lambda quantity: -quantity.value(first))
        return list(quantities[:MOST_CORNERS])

    def _saturation(self) -> list[Limit]:
        """The input from the file's start stays within the drive's limits, with some in hand."""
        drive = self._drive
        if drive is None or drive.saturation is None or self._linear is None:
            return []
        x0 = np.array(self.base.settings.x0)
        box = np.stack([x0, x0], axis=1)
        quantity = StartPeak(BoxResponse(self._linear, Grid.of(self.base), box))
        if isinstance(self.error, ImplementedError):
            return [Limit(DrivePeak(quantity, self.error), self._least_limit)]
        return [Limit(quantity, SATURATION_SHARE * self._least_limit)]

    def _energy(self) -> Quantity:
        settings = self.base.settings
        if self._linear is not None:
            return LinearEnergy(self._linear, Grid.of(self.base), np.array(settings.x0))
        return RunEnergy(self._compiled(), settings.x0, settings.duration)

    def _compiled(self) -> CompiledRuns:
        if self._runs is None:
            self._runs = CompiledRuns(self.base)
        return self._runs

    def _held_loop(self) -> LinearLoop | None:
        drive = self.base.implementation or self._drive or Implementation(LEAST_PERIOD)
        if self.base.implementation is None and not is_memoryless(self.system.law):
            drive = Implementation(drive.period)  # its sensors are those of the observer
        return linear_loop(self.base.replace(implementation=drive))

    def _edge(self, loop: LinearLoop) -> StabilityEdge:
        delay = 0.0 if self._drive is None else float(self._drive.run_delay)
        return StabilityEdge(loop, self.held_period, delay)

    def _delay_limit(self, margin: float) -> Limit:
        if self._loop is None:
            raise InputError(
                "delay_margin",
                "needs a linear loop: a nonlinear one has no exact edge",
                remedy="See what certrack margin says of the tuned file",
            )
        period = LEAST_PERIOD if self._drive is None else self._drive.period
        guess = min(margin, 1 / self.first.design.fastest_pole)
        edge = DelayEdge(self._loop, guess, period=period)
        return Limit(edge, margin, at_least=True, option="--delay-margin")

    def _accepts(self) -> Any:
        """The last word: no shorter period is unstable; a nonlinear loop works when held."""
        if self._loop is not None:
            return self._stable
        held = Held(self.base, self._held)
        self.notes.append(
            f"held at {self.held_period:.4g} s in a simulation: a nonlinear loop has no exact edge"
        )
        return held.holds

    def _stable(self, candidate: Candidate) -> bool:
        """Whether no shorter period is unstable; of a loop as implemented, with a proof."""
        assert self._loop is not None
        edge = self._edge(self._loop).first(candidate)
        if isinstance(self.objective, StabilityEdge):
            stable = math.isfinite(edge)
        else:
            stable = edge >= self.held_period
        if stable and isinstance(self.error, ImplementedError):
            return self.error.is_verified(candidate)
        return stable


#: Each counts its evaluations.
ErrorQuantity = ImplementedError | PeakGainError | RangedError | SemidefiniteError


def _error_quantity(base: System) -> ErrorQuantity:
    if base.implementation is not None:
        return ImplementedError(base.implementation)
    if base.law.kind == AdaptiveFamily.kind:
        return SemidefiniteError(base.replace(plant=replace(base.plant, constant_ranges=())))
    return RangedError(base) if has_ranges(base) else PeakGainError(base)


def _box(system: System, stated: Sequence[tuple[float, float]] | None) -> np.ndarray | None:
    """The box of starts, (n, 2)."""
    count = len(system.simulated_states)
    if stated is not None:
        pairs = checks.sequence("box", stated, count, "low:high for each state")
        ends = [checks.ordered_pair(f"box[{i}]", pair) for i, pair in enumerate(pairs)]
        return np.array(ends, dtype=float)
    population = system.population
    if population is None or population.x0 is None:
        return None
    return np.array([(entry.low, entry.high) for entry in population.x0], dtype=float)
