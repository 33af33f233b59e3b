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

from certrack.integrators.base import ESCAPING, Outcome
from certrack.integrators.many.maps import LANES, PAIR, Maps
from certrack.model.implementation import Implementation
from certrack.model.noise import normal

Array = np.ndarray

#: The error allowed in a step is this part of the tolerance: there may be many steps while an error
#: dies out.
SHARE = 0.1

#: No step is shorter than this part of the time. One that is as short may have the whole tolerance
#: as its error: a jump of the rates is crossed by it, where formulas cease to exist it fails.
SHORTEST = 1e-15

#: A member that needs more steps for one interval is given up.
MOST_STEPS = 5_000

#: Times closer than this part of a period are one, and those that rounding may have separated.
CLOSE, ROUNDING = 1e-9, 1e-15


@dataclass(frozen=True)
class Timeline:
    """When something happens.

    Attributes
    ----------
    times : (K+1,) array, s
        From the begin to the end of the run.
    samples, acts : (K+1,) arrays of bool
        Where a sample is taken; where the next command begins to act.
    breaks : (K+1,) array of int
        How many new pieces of the reference, or of what is totalled, begin there.
    marks : (K+1,) array of int
        Number of the time of interest there, or -1.
    """

    times: Array
    samples: Array
    acts: Array
    breaks: Array
    marks: Array


def timeline(
    implementation: Implementation, duration: float, breaks: Array, marks: Array
) -> Timeline:
    """All events of a run, in order; those that rounding alone separates are one."""
    taken = implementation.offset + implementation.period * np.arange(
        implementation.samples(duration)
    )
    taken = taken[taken < duration * (1 - 1e-12)]
    begun = taken + implementation.delay * implementation.period
    begun = begun[begun < duration * (1 - 1e-12)]
    kinds = [taken, begun, np.asarray(breaks), np.asarray(marks), np.array([0.0, duration])]
    times = np.concatenate(kinds)
    kind = np.repeat(np.arange(len(kinds)), [len(part) for part in kinds])
    order = np.lexsort((kind, times))
    gaps = np.diff(times[order], prepend=-np.inf)
    event = np.empty(len(times), dtype=int)
    close = max(CLOSE * min(implementation.period, duration), ROUNDING * duration)
    event[order] = np.cumsum(gaps > close) - 1
    merged = np.empty(event.max() + 1)
    for part in (3, 1, 0, 2, 4):  # the last one has the say: at a break the new piece holds
        merged[event[kind == part]] = times[kind == part]

    def where(part: int) -> Array:
        found = np.zeros(len(merged), dtype=bool)
        found[event[kind == part]] = True
        return found

    shown = np.full(len(merged), -1)
    shown[event[kind == 3]] = np.arange(len(marks))
    begun_there = np.bincount(event[kind == 2], minlength=len(merged))
    return Timeline(merged, where(0), where(1), begun_there, shown)


@dataclass(frozen=True)
class Course:
    """What some members are to do.

    Attributes
    ----------
    x, states, totals : (·, N) arrays
        Initial plant states, controller states and totals.
    parameters : (P, N) array
    implementation : Implementation
    timeline : Timeline
    outputs : callable, optional
        Measured values of the plant's states and all parameters, where they are not the states.
    pieces : callable
        Values of the reference's piece symbols from a time on.
    keys : (N,) array of unsigned integers
        Of the members' noise.
    tolerance : float
    max_state : float
    """

    x: Array
    states: Array
    totals: Array
    parameters: Array
    implementation: Implementation
    timeline: Timeline
    outputs: Callable[[Array, Array], Array] | None
    pieces: Callable[[float], Array]
    keys: Array
    tolerance: float
    max_state: float


#: Gets time, plant states, totals and input at the end of every step of a lone member.
Record = Callable[[float, Array, Array, Array], None]


class SampledRun:
    """Members on their way.

    Attributes
    ----------
    x, states, totals : (·, N) arrays
    u, variation : (N,) arrays
        The input that acts, and by how much in all it has changed.
    parameters : (P, N) array
        Of the loop and its current piece.
    marks : int
        Times of interest reached.
    ends : (N,) array, s
        Last event reached within the admitted states.
    outcomes : (N,) array of Outcome
    stuck : (N,) array of bool
        Who was given up for another reason than an escape.
    """

    def __init__(self, maps: Maps, course: Course) -> None:
        self._maps, self._course = maps, course
        self._allowed = SHARE * course.tolerance
        count = course.x.shape[1]
        self.x, self.states, self.totals = course.x, course.states, course.totals
        self.u = np.full(count, course.implementation.initial_input)
        self.ends = np.zeros(count)
        self.outcomes = np.full(count, Outcome.finished, dtype=object)
        self._alive, self.stuck = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        self._waiting: deque[Array] = deque()
        self._taken = self.marks = 0
        self.variation = np.zeros(count)
        pieces = course.pieces(0.0)
        self.parameters = np.vstack([course.parameters, np.repeat(pieces[:, None], count, axis=1)])
        self._pieces = slice(len(course.parameters), len(self.parameters))

    def go(
        self,
        *,
        sampled: Callable[[float, Array], None] = lambda _t, _states: None,
        record: Record | None = None,
        look: Callable[[int], None] = lambda _mark: None,
    ) -> None:
        """Carry out the course.

        Parameters
        ----------
        sampled : callable
            Gets the time and the controller's states before each sample.
        record : Record, optional
        look : callable
            Gets the number of every time of interest when it is reached.
        """
        line = self._course.timeline
        times, marks = line.times.tolist(), line.marks.tolist()
        samples, acts, breaks = line.samples.tolist(), line.acts.tolist(), line.breaks.tolist()
        for k, t in enumerate(times):
            if breaks[k] and self._pieces.start < len(self.parameters):
                self.parameters[self._pieces] = self._course.pieces(t)[:, None]
            if samples[k]:
                sampled(t, self.states)
                self._sample(t)
            if acts[k]:
                before, self.u = self.u, self._waiting.popleft()
                if k:
                    self.variation += np.abs(self.u - before)
            if marks[k] >= 0:
                look(marks[k])
                self.marks += 1
            if k + 1 < len(times) and not self.cross(t, times[k + 1], record):
                return

    def _sample(self, t: float) -> None:
        """Measure, evaluate the law; its command waits for the actuator."""
        implementation, x = self._course.implementation, self.x
        outputs = self._course.outputs
        true = x if outputs is None else outputs(x, self.parameters)
        measured = sensed(true, implementation, self._course.keys, self._taken)
        self._taken += 1
        u, self.states = self._maps.control(t, measured, self.states, self.parameters)
        self._waiting.append(implementation.converted(u))

    def cross(self, begin: float, end: float, record: Record | None = None) -> bool:
        """All members from one event to the next; whether any goes on."""
        h = end - begin
        x, totals, error = self._maps.step(
            begin, h, self._allowed, self.x, self.u, self.totals, self.parameters
        )
        late = ~(error <= 1.0)
        if late.any():
            late &= self._alive
            for group in _padded(np.flatnonzero(late), len(late)):
                self._creep(group, begin, end, h * _factor(error[group], 0.5), x, totals, record)
        if record is not None and not late[0]:
            record(end, x, totals, self.u)
        self.x, self.totals = x, totals
        if not self._inside():
            return False
        self.ends[self._alive] = end
        return True

    def _creep(
        self,
        group: Array,
        begin: float,
        end: float,
        h: Array,
        x_end: Array,
        totals_end: Array,
        record: Record | None,
    ) -> None:
        """Members that need several steps for the interval, each with its own step size."""
        t = np.full(len(group), begin)
        x, totals = self.x[:, group], self.totals[:, group]
        u, p = self.u[group], np.ascontiguousarray(self.parameters[:, group])
        lost, shortest = np.zeros(len(group), dtype=bool), SHORTEST * end
        for _ in range(MOST_STEPS):
            last = t + h >= end * (1 - 1e-15)
            h = np.where(last, end - t, np.maximum(h, shortest))
            least = h <= shortest
            allowed = np.where(least, self._course.tolerance, self._allowed)
            after, sums, error = self._maps.step(t, h, allowed, x, u, totals, p)
            passed = (error <= 1.0) & (t < end)
            x, totals = np.where(passed, after, x), np.where(passed, sums, totals)
            t = np.where(passed, np.where(last, end, t + h), t)
            if record is not None and passed[0]:
                record(float(t[0]), x, totals, u)
            h = h * _factor(error, 5.0)
            lost |= (t < end) & least & ~passed
            if (lost | (t >= end)).all():
                break
        stuck = t < end
        if stuck.any():
            wild = np.abs(x).max(axis=0) > ESCAPING
            x[:, stuck], totals[:, stuck] = np.nan, np.nan
            for i in np.flatnonzero(stuck):
                limit = Outcome.undefined if lost[i] else Outcome.step_limit
                self.outcomes[group[i]] = Outcome.escaped if wild[i] else limit
                self.stuck[group[i]] = not wild[i]
        x_end[:, group], totals_end[:, group] = x, totals

    def _inside(self) -> bool:
        """End the members that left the admitted states; whether any goes on."""
        limit = self._course.max_state
        if self.x.max() <= limit and self.x.min() >= -limit:  # nearly always, and not for NaN
            return True
        gone = ~(np.abs(self.x) <= limit).all(axis=0) & self._alive
        for i in np.flatnonzero(gone):
            if self.outcomes[i] is Outcome.finished:
                self.outcomes[i] = Outcome.escaped
        self._alive &= ~gone
        self.x[:, gone] = np.nan
        return bool(self._alive.any())


def sensed(true: Array, implementation: Implementation, keys: Array, sample: int) -> Array:
    """What the sensors give for measured values (n, N) at a sample: with noise, and rounded."""
    found = true
    if implementation.noise is not None:
        found = found + np.array(implementation.noise)[:, None] * normal(keys, sample, len(true))
    if implementation.measurement_quantum is not None:
        quantum = np.array(implementation.measurement_quantum)[:, None]
        with np.errstate(all="ignore"):
            found = np.where(quantum, np.rint(found / quantum) * quantum, found)
    return found


def _factor(error: Array, most: float) -> Array:
    """By what the next step is longer."""
    with np.errstate(all="ignore"):
        found = 0.9 * np.where(np.isfinite(error), error, 1e9) ** (-1.0 / PAIR.order)
    return np.clip(found, 0.1, most)


def _padded(members: Array, count: int) -> list[Array]:
    """All of them as one group, with the last one repeated: whole vector registers."""
    if not members.size:
        return []
    if count == 1:
        return [members]
    whole = -(-len(members) // LANES) * LANES
    return [members[np.minimum(np.arange(whole), len(members) - 1)]]
