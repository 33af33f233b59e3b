"""One run of the sampled loop: its compiled forms, the run, and its solution between the steps.

A run of many events is C (:mod:`certrack.integrators.sampled.single`), if it can be: the compiler,
which is asked once, takes as long as a few thousand events otherwise do. Everything else goes from
event to event by compiled maps (:mod:`certrack.integrators.sampled.run`). Which of both it is
depends on the problem alone, never on what was run before; they agree to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.lowering import numpy_callable, rows
from certrack.core.progress import Progress, silent
from certrack.integrators.base import MethodUnavailable, Outcome, Trajectory, parts_of
from certrack.integrators.sampled.events import EventTimeline, event_timeline
from certrack.integrators.sampled.maps import HeyokaMaps, SampledMaps
from certrack.integrators.sampled.plans import LimitedPlans
from certrack.integrators.sampled.run import SampledProblem, SampledRun
from certrack.integrators.sampled.scalar_maps import ScalarMaps
from certrack.integrators.sampled.single import WORTH_COMPILING, SampledSingle
from certrack.integrators.sampled.sliding import with_modes
from certrack.integrators.sampled.solution import (
    RunRecord,
    SampledSolution,
    Slopes,
    StepTable,
)
from certrack.integrators.switching import ModeRecord, sticking_notes
from certrack.loops.controller import SampledController, starting_state
from certrack.loops.plant import INPUT
from certrack.loops.sampled import SampledLoop, loop_values, sample_loop
from certrack.loops.schedule import make_schedule
from certrack.loops.time_switches import TimeSwitches, switched_sampled_loop
from certrack.model.implementation import Implementation
from certrack.model.noise import keys
from certrack.simulation.implementation_notes import implementation_notes
from certrack.simulation.planned_input import PlannedMaps, limited_plans
from certrack.simulation.run import Run
from certrack.systems.system import System

#: Samples after which the progress is reported: often enough to be seen, too rarely to cost time.
SAMPLES_PER_REPORT = 500


class SampledSimulator:
    """A system with an implementation, compiled; runs it for any numbers.

    Parameters
    ----------
    system : System
    around : callable, optional
        Gets the compiled maps and the loop; the run uses the maps that it returns.
    controller : SampledController, optional
        That of the system, where it has been made before.
    with_switches : bool
        Whether switches of time are symbols of the piece; otherwise the error control follows them.

    Attributes
    ----------
    loop : SampledLoop
        As :func:`~certrack.loops.sampled.sample_loop` makes it.
    maps : SampledMaps
        Of the loop with its switches of time.
    """

    def __init__(
        self,
        system: System,
        around: Callable[[SampledMaps, SampledLoop], SampledMaps] | None = None,
        controller: SampledController | None = None,
        with_switches: bool = True,
    ) -> None:
        self.loop: SampledLoop = sample_loop(system, controller=controller)
        loop, self._switches = self.loop, TimeSwitches()
        if with_switches:
            loop, self._switches = switched_sampled_loop(loop)
        loop, self.surfaces = with_modes(loop)
        integrator = system.settings.integrator
        if integrator == "implicit":
            raise InputError(
                "simulation.integrator",
                "a sampled loop has no implicit method",
                integrator,
                "Use auto or scipy",
            )
        self._compiled, self._around = loop, around
        self._by_numpy = integrator == "scipy" or not has_heyoka()
        self._in_c = integrator != "scipy" and around is None and self.surfaces is None
        self.outputs = outputs_of(self.loop)
        self._singles: dict[bool, SampledSingle | None] = {}
        self._last_events: tuple[Any, EventTimeline | None] = (None, None)
        names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
        self._rates = numpy_callable(names, [*loop.plant.rates, loop.e_1, loop.slope])

    @cached_property
    def maps(self) -> SampledMaps:
        """Of the loop with its switches of time."""
        loop = self._compiled
        maps: SampledMaps = ScalarMaps(loop) if self._by_numpy else HeyokaMaps(loop, vector=False)
        return maps if self._around is None else self._around(maps, loop)

    def _single(self, plans: bool) -> SampledSingle | None:
        """The loop in C; None where there is no compiler."""
        if plans not in self._singles:
            try:
                self._singles[plans] = SampledSingle(self._compiled, plans)
            except MethodUnavailable:
                self._singles[plans] = None
        return self._singles[plans]

    def run(self, system: System, progress: Progress = silent) -> Run:
        """Simulate `system`; `progress` gets the time reached."""
        implementation, settings = system.implementation, system.settings
        assert implementation is not None
        parameters = loop_values(self.loop, system)[:, None]
        numbers = dict(zip(self.loop.parameters, parameters[:, 0].tolist(), strict=True))
        schedule = make_schedule(
            system.reference, self._switches, numbers, settings.duration, settings.tolerance
        )
        breaks = schedule.breaks(0.0, settings.duration)
        line = self._events(implementation, settings.duration, breaks)
        problem = SampledProblem(
            x=np.array(settings.x0)[:, None],
            states=starting_state(self.loop.controller, system.estimates, implementation)[:, None],
            totals=np.zeros((len(self.loop.totals), 1)),
            parameters=parameters,
            implementation=implementation,
            timeline=line,
            outputs=self.outputs,
            pieces=schedule.piece_values,
            keys=keys(implementation.seed, implementation.stream, 1),
            tolerance=settings.tolerance,
            max_state=settings.max_state,
            surfaces=self.surfaces,
        )
        progress(0.0, settings.duration, None)
        shared = np.array([schedule.piece_values(t) for t in (0.0, *breaks)])
        plans = limited_plans(system, line)
        record = self._record_in_c(problem, shared, plans, progress)
        outcome, modes = Outcome.finished, None
        if record is None:
            maps = self.maps
            if plans is not None:
                maps = PlannedMaps(maps, self.loop, line, plans)
            record, outcome, modes = self._record_by_maps(maps, problem, progress)
        progress(settings.duration, settings.duration, None)
        slopes = Slopes(self._rates, schedule, parameters[:, 0], modes)
        solution = SampledSolution(record.with_a_step(), slopes, len(problem.x))
        parts = parts_of(max(1, len(record.inputs)))
        trajectory = Trajectory(record.ends, solution, outcome, "sampled", parts, modes)
        notes = [*schedule.notes]
        if modes is not None:
            notes += sticking_notes(modes, trajectory.end)
        notes += implementation_notes(system)
        return Run(system, trajectory, solution.input_at, tuple(notes))

    def _events(
        self, implementation: Implementation, duration: float, breaks: Array
    ) -> EventTimeline:
        """The events of a run; the last ones are remembered, for they rarely change."""
        key = (implementation, duration, breaks.tobytes())
        known, line = self._last_events
        if line is None or known != key:
            line = event_timeline(implementation, duration, breaks, np.empty(0))
            self._last_events = (key, line)
        return line

    def _record_in_c(
        self,
        problem: SampledProblem,
        shared: Array,
        plans: LimitedPlans | None,
        progress: Progress,
    ) -> StepTable | None:
        """All steps by compiled C; None where that is not worth its while, or cannot do it."""
        if len(problem.timeline.times) < WORTH_COMPILING or not self._in_c:
            return None
        single = self._single(plans is not None)
        return None if single is None else single.record(problem, shared, plans, progress)

    def _record_by_maps(
        self, maps: SampledMaps, problem: SampledProblem, progress: Progress
    ) -> tuple[StepTable, Outcome, ModeRecord | None]:
        """All steps that end within the admitted states, how the run ended, and its modes."""
        estimates, end = len(self.loop.controller.estimates), float(problem.timeline.times[-1])
        record = RunRecord(problem, estimates)

        def sampled(t: float, states: Array) -> None:
            record.add_sample(t, states)
            if record.samples % SAMPLES_PER_REPORT == 0:
                progress(t, end, None)

        run = SampledRun(maps, problem)
        run.run(on_sample=sampled, on_step=record.add_step)
        record.add_sample(end, run.states)
        outcome: Outcome = run.outcomes[0]
        if outcome is not Outcome.finished:
            record.drop_from(problem.max_state)
        modes = None if run.crossing is None else run.crossing.modes()
        return record.steps(float(run.u[0])), outcome, modes


def outputs_of(loop: SampledLoop) -> Callable[[Array, Array], Array] | None:
    """Measured values as a function of states and parameters; None where they are the states."""
    if loop.plant.outputs == loop.plant.states:
        return None
    count = len(loop.parameters)
    evaluate = numpy_callable([loop.plant.states, loop.parameters], loop.plant.outputs)
    return lambda x, p: rows(evaluate(x, p[:count]), x.shape[1])  # pieces of time follow
