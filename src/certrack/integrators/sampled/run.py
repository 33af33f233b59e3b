"""A plant under a sampled controller: exact events, error-controlled steps between them.

All members share the times at which something happens: samples, inputs that begin to act, breaks
of the reference, times of interest. Between two of them the input is constant, and every member
crosses the interval in one step of a Runge-Kutta pair, or in as many as its own error estimate
demands - at a kink of the plant (abs, sign, min, max) they shrink towards it. What a member
computes does not depend on its neighbours.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certrack.core.arrays import Array
from certrack.integrators.base import ESCAPING, Outcome
from certrack.integrators.registers import whole_registers
from certrack.integrators.sampled.events import EventTimeline
from certrack.integrators.sampled.maps import SampledMaps
from certrack.integrators.sampled.sliding import Crossing, values_of
from certrack.integrators.sampled.step_control import (
    END_ROUNDING,
    ERROR_SHARE,
    FIRST_MAX_FACTOR,
    MAX_FACTOR,
    MAX_INTERVAL_STEPS,
    SHORTEST_STEP,
    next_factor,
)
from certrack.integrators.switching import Surfaces
from certrack.model.implementation import Implementation
from certrack.model.noise import normal


@dataclass(frozen=True)
class SampledProblem:
    """Initial value problem of members under a sampled controller.

    Attributes
    ----------
    x, states, totals : (·, N) arrays
        Initial plant states, controller states and totals.
    parameters : (P, N) array
    implementation : Implementation
    timeline : EventTimeline
    outputs : callable, optional
        Measured values of the plant's states and all parameters, where they are not the states.
    pieces : callable
        Values of the reference's piece symbols from a time on.
    keys : (N,) array of unsigned integers
        Keys of the members' noise.
    tolerance : float
        Tolerance of the plant's states and of the integral of e_1, relative and absolute.
    max_state : float
        A plant state beyond it has escaped.
    surfaces : Surfaces, optional
        Where the plant switches and may slide; its modes are the last rows of the parameters.
    """

    x: Array
    states: Array
    totals: Array
    parameters: Array
    implementation: Implementation
    timeline: EventTimeline
    outputs: Callable[[Array, Array], Array] | None
    pieces: Callable[[float], Array]
    keys: Array
    tolerance: float
    max_state: float
    surfaces: Surfaces | None = None


#: Gets time, plant states, totals and input at the end of every step of a lone member.
OnStep = Callable[[float, Array, Array, Array], None]


class SampledRun:
    """The state of all members at the last event, and how it goes on.

    Attributes
    ----------
    x, states, totals : (·, N) arrays
    u, variation : (N,) arrays
        The input that acts, and the sum of its changes' magnitudes.
    parameters : (P, N) array
        Parameters of the loop and of its current piece.
    alive : (N,) array of bool
    step_map : callable
        That of the maps.
    allowed : float
        Error of a step.
    marks : int
        Times of interest reached.
    ends : (N,) array, s
        Last event reached within the admitted states.
    outcomes : (N,) array of Outcome
    run_alone : (N,) array of bool
        Which of many members have to be: given up for another reason than an escape.
    """

    def __init__(self, maps: SampledMaps, problem: SampledProblem) -> None:
        self._maps, self._problem = maps, problem
        self.step_map, self.allowed = maps.step, ERROR_SHARE * problem.tolerance
        count = problem.x.shape[1]
        self.x, self.states, self.totals = problem.x, problem.states, problem.totals
        self.u = np.full(count, problem.implementation.initial_input)
        self.ends = np.zeros(count)
        self.outcomes = np.full(count, Outcome.finished, dtype=object)
        self.alive, self.run_alone = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        self._waiting: deque[Array] = deque()
        self._samples = self.marks = 0
        self.variation = np.zeros(count)
        line = problem.timeline
        self._errors = problem.implementation.sensor_errors(line.times[line.samples])
        pieces = problem.pieces(0.0)
        last = values_of(pieces, problem.surfaces)
        self.parameters = np.vstack([problem.parameters, np.repeat(last[:, None], count, axis=1)])
        first = len(problem.parameters)
        self._pieces = slice(first, first + len(pieces))
        self.crossing = None if problem.surfaces is None else Crossing(self, problem.surfaces)

    def run(
        self,
        *,
        on_sample: Callable[[float, Array], None] = lambda _t, _states: None,
        on_step: OnStep | None = None,
        on_mark: Callable[[int], None] = lambda _mark: None,
    ) -> None:
        """Integrate to the end of the problem, or until no member is left.

        Parameters
        ----------
        on_sample : callable
            Gets the time and the controller's states before each sample.
        on_step : callable, optional
            Gets time, plant states, totals and input after each step of the first member.
        on_mark : callable
            Gets the number of every time of interest when it is reached.
        """
        line = self._problem.timeline
        times, marks = line.times.tolist(), line.marks.tolist()
        samples, acts, breaks = line.samples.tolist(), line.acts.tolist(), line.breaks.tolist()
        for k, t in enumerate(times):
            if breaks[k] and self._pieces.start < self._pieces.stop:
                self.parameters[self._pieces] = self._problem.pieces(t)[:, None]
            if samples[k]:
                on_sample(t, self.states)
                self._sample(float(line.clock[k]))
            if acts[k]:
                before, self.u = self.u, self._waiting.popleft()
                if k:
                    self.variation += np.abs(self.u - before)
            if marks[k] >= 0:
                on_mark(marks[k])
                self.marks += 1
            if k + 1 < len(times) and not self.advance(t, times[k + 1], on_step):
                return

    def _sample(self, t: float) -> None:
        """Measure, evaluate the law at the controller's own time; its command waits."""
        implementation, x = self._problem.implementation, self.x
        outputs = self._problem.outputs
        true = x if outputs is None else outputs(x, self.parameters)
        error = None if self._errors is None else self._errors[:, self._samples]
        measured = sensed(true, implementation, self._problem.keys, self._samples, error)
        self._samples += 1
        u, self.states = self._maps.control(t, measured, self.states, self.parameters)
        self._waiting.append(implementation.converted(u))

    def advance(self, begin: float, end: float, on_step: OnStep | None = None) -> bool:
        """Integrate all members from one event to the next; returns whether any goes on."""
        if self.crossing is not None:
            self.x, self.totals = self.crossing.cross(begin, end, on_step)
        else:
            self._cross(begin, end, on_step)
        if not self._inside():
            return False
        self.ends[self.alive] = end
        return True

    def _cross(self, begin: float, end: float, on_step: OnStep | None) -> None:
        """All members from `begin` to `end`, where the plant does not slide."""
        h = end - begin
        x, totals, error = self._maps.step(
            begin, h, self.allowed, self.x, self.u, self.totals, self.parameters
        )
        late = ~(error <= 1.0)
        if late.any() and (late := late & self.alive).any():
            group = np.flatnonzero(late)
            if len(late) > 1:  # maps of many members want whole registers
                group = group[whole_registers(len(group))]
            first = h * next_factor(error[group], FIRST_MAX_FACTOR)
            self._substep(group, begin, end, first, x, totals, on_step)
        if on_step is not None and not late[0]:
            on_step(end, x, totals, self.u)
        self.x, self.totals = x, totals

    def _substep(
        self,
        group: Array,
        begin: float,
        end: float,
        h: Array,
        x_end: Array,
        totals_end: Array,
        on_step: OnStep | None,
    ) -> None:
        """Members that need several steps for the interval, each with its own step size."""
        t = np.full(len(group), begin)
        x, totals = self.x[:, group], self.totals[:, group]
        u, p = self.u[group], np.ascontiguousarray(self.parameters[:, group])
        lost, shortest = np.zeros(len(group), dtype=bool), SHORTEST_STEP * end
        for _ in range(MAX_INTERVAL_STEPS):
            last = t + h >= end * (1 - END_ROUNDING)
            h = np.where(last, end - t, np.maximum(h, shortest))
            at_shortest = h <= shortest
            allowed = np.where(at_shortest, self._problem.tolerance, self.allowed)
            x_after, totals_after, error = self._maps.step(t, h, allowed, x, u, totals, p)
            accepted = (error <= 1.0) & (t < end)
            x = np.where(accepted, x_after, x)
            totals = np.where(accepted, totals_after, totals)
            t = np.where(accepted, np.where(last, end, t + h), t)
            if on_step is not None and accepted[0]:
                on_step(float(t[0]), x, totals, u)
            h = h * next_factor(error, MAX_FACTOR)
            lost |= (t < end) & at_shortest & ~accepted
            if (lost | (t >= end)).all():
                break
        given_up = t < end
        if given_up.any():
            wild = np.abs(x).max(axis=0) > ESCAPING
            x[:, given_up], totals[:, given_up] = np.nan, np.nan
            for i in np.flatnonzero(given_up):
                reason = Outcome.undefined if lost[i] else Outcome.step_limit
                if not np.abs(u[i]) <= self._problem.max_state:  # also where it is not a number
                    reason = Outcome.controller_diverged
                self.outcomes[group[i]] = Outcome.escaped if wild[i] else reason
                self.run_alone[group[i]] = not wild[i]
        x_end[:, group], totals_end[:, group] = x, totals

    def _inside(self) -> bool:
        """End the members that left the admitted states; whether any goes on."""
        max_state = self._problem.max_state
        if (
            self.x.max() <= max_state and self.x.min() >= -max_state
        ):  # nearly always, and not for NaN
            return True
        gone = ~(np.abs(self.x) <= max_state).all(axis=0) & self.alive
        for i in np.flatnonzero(gone):
            if self.outcomes[i] is Outcome.finished:
                self.outcomes[i] = Outcome.escaped
        self.alive &= ~gone
        self.x[:, gone] = np.nan
        return bool(self.alive.any())


def sensed(
    true: Array,
    implementation: Implementation,
    keys: Array,
    sample: int,
    error: Array | None = None,
) -> Array:
    """What the sensors give for measured values (n, N) at a sample: with noise, and rounded.

    Parameters
    ----------
    true : (n, N) array
    implementation : Implementation
    keys : (N,) array of unsigned integers
    sample : int
    error : (n,) array, optional
        The errors that the implementation states for this sample.
    """
    noise = sensor_noise(
        implementation,
        lambda: normal(keys, sample, len(true)),
        None if error is None else error[:, None],
    )
    measured = true if noise is None else true + noise
    if implementation.measurement_quantum is not None:
        quantum = np.array(implementation.measurement_quantum)[:, None]
        with np.errstate(all="ignore"):
            measured = np.where(quantum, np.rint(measured / quantum) * quantum, measured)
    return measured


def sensor_noise(
    implementation: Implementation, draw: Callable[[], Array], errors: Array | None
) -> Array | None:
    """What is added to measured values, a row for each; None for nothing.

    Parameters
    ----------
    implementation : Implementation
    draw : callable
        Gives standard normal numbers; called where there is noise.
    errors : array, optional
        Those that the implementation states.
    """
    noise = errors
    if implementation.noise is not None:
        normal_noise = np.array(implementation.noise)[:, None] * draw()
        noise = normal_noise if noise is None else normal_noise + noise
    if noise is not None and implementation.noise_bound is not None:
        bound = np.array(implementation.noise_bound)[:, None]
        noise = np.clip(noise, -bound, bound)
    return noise
