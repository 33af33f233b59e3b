"""One run of a sampled loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.base import Outcome, Trajectory
from certrack.integrators.many.sampled_events import event_timeline
from certrack.integrators.many.sampled_maps import HeyokaMaps, Maps, NumpyMaps
from certrack.integrators.many.sampled_run import SampledProblem, SampledRun
from certrack.integrators.single.taylor import available
from certrack.loops.continuous import INTEGRAL_SCALE
from certrack.loops.controller import SampledController, starting_state
from certrack.loops.plant import INPUT
from certrack.loops.sampled import SampledLoop, loop_values, sample_loop
from certrack.model.noise import keys
from certrack.references import pieces_at
from certrack.simulation.run import Run
from certrack.systems.system import System

Array = np.ndarray

#: Beyond so many steps a run is sampled at their ends and middles only.
MANY = 20_000

#: Samples after which the progress is told.
OFTEN = 500


class SampledSimulator:
    """A system with an implementation, compiled; runs it for any numbers.

    Parameters
    ----------
    system : System
    around : callable, optional
        Gets the compiled maps and the loop; the run uses the maps that it returns.
    controller : SampledController, optional
        That of the system, where it has been made before.
    """

    def __init__(
        self,
        system: System,
        around: Callable[[Maps, SampledLoop], Maps] | None = None,
        controller: SampledController | None = None,
    ) -> None:
        self.loop: SampledLoop = sample_loop(system, controller=controller)
        wanted = system.settings.integrator
        if wanted == "implicit":
            raise InputError(
                "simulation.integrator",
                "a sampled loop has no implicit method",
                wanted,
                "Use auto or scipy",
            )
        by_numpy = wanted == "scipy" or not available()
        self.maps: Maps = NumpyMaps(self.loop) if by_numpy else HeyokaMaps(self.loop, vector=False)
        self.maps = self.maps if around is None else around(self.maps, self.loop)
        self.outputs = outputs_of(self.loop)
        names = [TIME, self.loop.plant.states, INPUT, [*self.loop.parameters, *self.loop.pieces]]
        self._rates = numpy_callable(names, [*self.loop.plant.rates, self.loop.e_1])

    def run(self, system: System, progress: Callable[[float], None] = lambda _share: None) -> Run:
        """Simulate `system`; `progress` gets the share that is done."""
        implementation, settings = system.implementation, system.settings
        assert implementation is not None
        breaks = system.reference.breaks(0.0, settings.duration)
        line = event_timeline(implementation, settings.duration, breaks, np.empty(0))
        parameters = loop_values(self.loop, system)[:, None]
        course = SampledProblem(
            x=np.array(settings.x0)[:, None],
            states=starting_state(self.loop.controller, system.estimates, implementation)[:, None],
            totals=np.zeros((len(self.loop.totals), 1)),
            parameters=parameters,
            implementation=implementation,
            timeline=line,
            outputs=self.outputs,
            pieces=system.reference.piece_values,
            keys=keys(implementation.seed, implementation.stream, 1),
            tolerance=settings.tolerance,
            max_state=settings.max_state,
        )
        ends, columns, inputs = [0.0], [np.vstack([course.x, course.totals])[:, 0]], []
        kept: list[tuple[float, Array]] = []

        def record(t: float, x: Array, totals: Array, u: Array) -> None:
            ends.append(t)
            columns.append(np.concatenate([x[:, 0], totals[:, 0]]))
            inputs.append(u[0])

        count = len(system.controller.states)
        run = SampledRun(self.maps, course)

        def sampled(t: float, states: Array) -> None:
            kept.append((t, states[:count, 0]))
            if len(kept) % OFTEN == 0:
                progress(t / settings.duration)

        run.run(on_sample=sampled, on_step=record)
        kept.append((float(line.times[-1]), run.states[:count, 0]))
        outcome: Outcome = run.outcomes[0]
        if outcome is not Outcome.finished:
            inside = np.abs(np.array(columns)[:, : len(course.x)]).max(axis=1)
            last = int(np.argmax(np.append(~(inside <= settings.max_state), True)))
            ends, columns, inputs = ends[:last], columns[:last], inputs[: last - 1]
        times = np.array(ends)
        if len(ends) == 1:  # not one step: a start alone, as a step of no length
            ends, columns, inputs = ends * 2, columns * 2, [run.u[0]]
        dense = Steps(
            np.array(ends),
            np.array(columns).T,
            np.array(inputs),
            np.array([t for t, _ in kept]),
            np.array([z for _, z in kept]).reshape(len(kept), count).T,
            partial(self._slopes, system, parameters[:, 0]),
            len(course.x),
        )
        trajectory = Trajectory(times, dense, outcome, "sampled", 2 if len(ends) > MANY else 8)
        return Run(system, trajectory, lambda t, _: dense.input(t))

    def _slopes(
        self, system: System, parameters: Array, t: Array, x: Array, u: Array, begins: Array
    ) -> Array:
        """Rates of the plant's states and of the integrals, for steps that begin at `begins`."""
        pieces = pieces_at(system.reference, begins * (1 + 1e-12))
        with np.errstate(all="ignore"):
            found = rows(self._rates(t, x, u, [*parameters, *pieces]), len(t))
        e = found[-1]
        return np.vstack([found[:-1], np.array([u**2, e**2, e]) / INTEGRAL_SCALE])


def outputs_of(loop: SampledLoop) -> Callable[[Array, Array], Array] | None:
    """Measured values as a function of states and parameters; None where they are the states."""
    if loop.plant.outputs == loop.plant.states:
        return None
    evaluate = numpy_callable(
        [loop.plant.states, [*loop.parameters, *loop.pieces]], loop.plant.outputs
    )
    return lambda x, p: rows(evaluate(x, p), x.shape[1])


@dataclass(frozen=True)
class Steps:
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

    def _owner(self, t: Array) -> Array:
        return np.searchsorted(self.ends[1:-1], t, side="right")

    def input(self, t: Array) -> Array:
        """The input that acts at the times t."""
        return self.inputs[self._owner(np.asarray(t, dtype=float))]

    def __call__(self, t: Array) -> Array:
        """Plant states, estimates and integrals at the times t."""
        t = np.asarray(t, dtype=float)
        k = self._owner(t)
        begin, h = self.ends[k], np.diff(self.ends)[k]
        s = (t - begin) / np.where(h > 0, h, 1.0)
        a, b, u = self.columns[:, k], self.columns[:, k + 1], self.inputs[k]
        da = h * self.slopes(begin, a[: self.n], u, begin)
        db = h * self.slopes(begin + h, b[: self.n], u, begin)
        rise = b - a
        found = a + s * (da + s * (3 * rise - 2 * da - db + s * (da + db - 2 * rise)))
        held = np.searchsorted(self.samples, t, side="right") - 1
        z = self.estimates[:, np.clip(held, 0, None)]
        return np.vstack([found[: self.n], z, found[self.n :]])
