"""One run of the sampled loop: the compiled maps, the run, and its solution between the steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.lowering import NumpyFunction, numpy_callable, rows
from certrack.core.progress import Progress, silent
from certrack.integrators.base import Outcome, Trajectory, parts_of
from certrack.integrators.sampled.events import event_timeline
from certrack.integrators.sampled.maps import HeyokaMaps, SampledMaps
from certrack.integrators.sampled.run import SampledProblem, SampledRun
from certrack.integrators.sampled.scalar_maps import ScalarMaps
from certrack.integrators.sampled.sliding import with_modes
from certrack.integrators.switching import ModeRecord, sticking_notes
from certrack.loops.continuous import INTEGRAL_SCALE
from certrack.loops.controller import SampledController, starting_state
from certrack.loops.plant import INPUT
from certrack.loops.sampled import SampledLoop, loop_values, sample_loop
from certrack.loops.schedule import Schedule, make_schedule
from certrack.loops.time_switches import TimeSwitches, switched_sampled_loop
from certrack.model.noise import keys
from certrack.simulation.implementation_notes import implementation_notes
from certrack.simulation.run import Run
from certrack.systems.system import System

#: Samples after which the progress is reported: often enough to be seen, too rarely to cost time.
SAMPLES_PER_REPORT = 500

#: Takes a time at a break to the piece that begins there, whatever its rounding.
JUST_AFTER = 1 + 1e-12


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
        by_numpy = integrator == "scipy" or not has_heyoka()
        maps: SampledMaps = ScalarMaps(loop) if by_numpy else HeyokaMaps(loop, vector=False)
        self.maps = maps if around is None else around(maps, loop)
        self.outputs = outputs_of(self.loop)
        names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
        self._rates = numpy_callable(names, [*loop.plant.rates, loop.e_1])

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
        line = event_timeline(implementation, settings.duration, breaks, np.empty(0))
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
        record = RunRecord(problem.x, problem.totals, len(system.controller.states))

        def sampled(t: float, states: Array) -> None:
            record.add_sample(t, states)
            if len(record.samples) % SAMPLES_PER_REPORT == 0:
                progress(t, settings.duration, None)

        progress(0.0, settings.duration, None)
        run = SampledRun(self.maps, problem)
        run.run(on_sample=sampled, on_step=record.add_step)
        record.add_sample(float(line.times[-1]), run.states)
        progress(settings.duration, settings.duration, None)
        outcome: Outcome = run.outcomes[0]
        if outcome is not Outcome.finished:
            record.drop_from(settings.max_state)
        times = np.array(record.ends)
        modes = None
        if run.crossing is not None:
            modes = run.crossing.modes()
        slopes = Slopes(self._rates, schedule, parameters[:, 0], modes)
        solution = record.solution(slopes, run.u[0])
        parts = parts_of(len(solution.ends) - 1)
        trajectory = Trajectory(times, solution, outcome, "sampled", parts, modes)
        notes = [*schedule.notes]
        if modes is not None:
            notes += sticking_notes(modes, trajectory.end)
        notes += implementation_notes(system)
        return Run(system, trajectory, solution.input_at, tuple(notes))


@dataclass(frozen=True)
class Slopes:
    """Rates of the plant's states and of the integrals, for steps that begin at `begins`.

    Attributes
    ----------
    rates : NumpyFunction
        Those of the states, and e_1.
    schedule : Schedule
    parameters : (P,) array
    modes : ModeRecord, optional
        Of the run; the last of the rates' parameters.
    """

    rates: NumpyFunction
    schedule: Schedule
    parameters: Array
    modes: ModeRecord | None = None

    def __call__(self, t: Array, x: Array, u: Array, begins: Array) -> Array:
        pieces = [*self.schedule.pieces_at(begins * JUST_AFTER)]
        if self.modes is not None:
            pieces += [*self.modes.at(begins)]
        with np.errstate(all="ignore"):
            rates = rows(self.rates(t, x, u, [*self.parameters, *pieces]), len(t))
        e = rates[-1]
        return np.vstack([rates[:-1], np.array([u**2, e**2, e]) / INTEGRAL_SCALE])


def outputs_of(loop: SampledLoop) -> Callable[[Array, Array], Array] | None:
    """Measured values as a function of states and parameters; None where they are the states."""
    if loop.plant.outputs == loop.plant.states:
        return None
    evaluate = numpy_callable(
        [loop.plant.states, [*loop.parameters, *loop.pieces]], loop.plant.outputs
    )
    return lambda x, p: rows(evaluate(x, p), x.shape[1])


class RunRecord:
    """What one sampled run leaves, step after step and sample after sample.

    Parameters
    ----------
    x, totals : (n, 1) and (3, 1) arrays
        Plant states and integrals at the start.
    estimates : int
        Number of estimates; they come first among the controller's states.
    """

    def __init__(self, x: Array, totals: Array, estimates: int) -> None:
        self.ends = [0.0]
        self.samples: list[float] = []
        self._order, self._count = len(x), estimates
        self._columns = [np.vstack([x, totals])[:, 0]]
        self._inputs: list[float] = []
        self._estimates: list[Array] = []

    def add_step(self, t: float, x: Array, totals: Array, u: Array) -> None:
        """A step that ends at t, with the input that acted on it."""
        self.ends.append(t)
        self._columns.append(np.concatenate([x[:, 0], totals[:, 0]]))
        self._inputs.append(u[0])

    def add_sample(self, t: float, states: Array) -> None:
        """The controller's states that the sample at t used."""
        self.samples.append(t)
        self._estimates.append(states[: self._count, 0])

    def drop_from(self, max_state: float) -> None:
        """Forget all steps from the first one on that ends beyond the largest state."""
        largest = np.abs(np.array(self._columns)[:, : self._order]).max(axis=1)
        last = int(np.argmax(np.append(~(largest <= max_state), True)))
        self.ends, self._columns = self.ends[:last], self._columns[:last]
        self._inputs = self._inputs[: last - 1]

    def solution(
        self, slopes: Callable[[Array, Array, Array, Array], Array], first_input: float
    ) -> SampledSolution:
        """Dense output; where there is not one step, of a step of no length with that input."""
        ends, columns, inputs = self.ends, self._columns, self._inputs
        if len(ends) == 1:
            ends, columns, inputs = ends * 2, columns * 2, [first_input]
        return SampledSolution(
            np.array(ends),
            np.array(columns).T,
            np.array(inputs),
            np.array(self.samples),
            np.array(self._estimates).reshape(len(self.samples), self._count).T,
            slopes,
            self._order,
        )


@dataclass(frozen=True)
class SampledSolution:
    """Dense output of a sampled run: cubic Hermite polynomials between the steps' ends.

    Attributes
    ----------
    ends : (K+1,) array, s
    columns : (n+3, K+1) array
        Plant states and integrals at `ends`.
    inputs : (K,) array
        The input on each step.
    samples : (M+1,) array, s
        Times of the samples, and the end of the run.
    estimates : (r, M+1) array
        The estimates that each sample used, and the last ones.
    slopes : callable
        Rates of the columns at times, states, inputs, and begins of the steps.
    n : int
        Number of plant states.
    """

    ends: Array
    columns: Array
    inputs: Array
    samples: Array
    estimates: Array
    slopes: Callable[[Array, Array, Array, Array], Array]
    n: int

    def _step_at(self, t: Array) -> Array:
        """Number of the step that t lies in."""
        return np.searchsorted(self.ends[1:-1], t, side="right")

    def input(self, t: Array) -> Array:
        """The input that acts at the times t."""
        return self.inputs[self._step_at(np.asarray(t, dtype=float))]

    def input_at(self, t: Array, _states: Array) -> Array:
        """The same, called as the input of any run is."""
        return self.input(t)

    def __call__(self, t: Array) -> Array:
        """Plant states, estimates and integrals at the times t."""
        t = np.asarray(t, dtype=float)
        k = self._step_at(t)
        begin, h = self.ends[k], np.diff(self.ends)[k]
        s = (t - begin) / np.where(h > 0, h, 1.0)
        a, b, u = self.columns[:, k], self.columns[:, k + 1], self.inputs[k]
        da = h * self.slopes(begin, a[: self.n], u, begin)
        db = h * self.slopes(begin + h, b[: self.n], u, begin)
        rise = b - a
        x = a + s * (da + s * (3 * rise - 2 * da - db + s * (da + db - 2 * rise)))
        sample = np.searchsorted(self.samples, t, side="right") - 1
        z = self.estimates[:, np.clip(sample, 0, None)]
        return np.vstack([x[: self.n], z, x[self.n :]])
