"""What one sampled run leaves: its steps, what happens at their ends, and all between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from certrack.core.arrays import Array
from certrack.core.lowering import NumpyFunction, rows
from certrack.integrators.base import fractions
from certrack.integrators.sampled.run import SampledProblem
from certrack.integrators.switching import ModeRecord
from certrack.loops.continuous import INTEGRAL_SCALE
from certrack.loops.schedule import Schedule

#: Takes a time at a break to the piece that begins there, whatever its rounding.
JUST_AFTER = 1 + 1e-12


@dataclass(frozen=True)
class StepTable:
    """The steps of a run, one after the other.

    Attributes
    ----------
    ends : (K+1,) array, s
        Begin of the run, and end of every step.
    columns : (n+3, K+1) array
        Plant states and integrals at `ends`.
    inputs : (K,) array
        The input on each step; without a step the one that acts.
    samples : (M+1,) array, s
        Times of the samples, and the end of the run.
    estimates : (r, M+1) array
        The estimates that each sample used, and the last ones.
    sides : (4, K) array, optional
        e_1 at the begin and at the end of each step, and its rate there.
    """

    ends: Array
    columns: Array
    inputs: Array
    samples: Array
    estimates: Array
    sides: Array | None = None

    def with_a_step(self) -> StepTable:
        """The same with one step of no length, if there is none."""
        if len(self.ends) > 1:
            return self
        ends, columns = np.repeat(self.ends, 2), np.repeat(self.columns, 2, axis=1)
        return replace(self, ends=ends, columns=columns)


class RunRecord:
    """What a run leaves step after step and sample after sample, as it goes on.

    Parameters
    ----------
    problem : SampledProblem
        Of one member.
    estimates : int
        Number of estimates; they come first among the controller's states.
    """

    def __init__(self, problem: SampledProblem, estimates: int) -> None:
        self._order, self._count = len(problem.x), estimates
        self._ends, self._samples = [0.0], list[float]()
        self._columns = [np.vstack([problem.x, problem.totals])[:, 0]]
        self._inputs = list[float]()
        self._estimates = list[Array]()

    @property
    def samples(self) -> int:
        """How many there were."""
        return len(self._samples)

    def add_step(self, t: float, x: Array, totals: Array, u: Array) -> None:
        """A step that ends at t, with the input that acted on it."""
        self._ends.append(t)
        self._columns.append(np.concatenate([x[:, 0], totals[:, 0]]))
        self._inputs.append(u[0])

    def add_sample(self, t: float, states: Array) -> None:
        """The controller's states that the sample at t used."""
        self._samples.append(t)
        self._estimates.append(states[: self._count, 0])

    def drop_from(self, max_state: float) -> None:
        """Forget all steps from the first one on that ends beyond the largest state."""
        largest = np.abs(np.array(self._columns)[:, : self._order]).max(axis=1)
        last = int(np.argmax(np.append(~(largest <= max_state), True)))
        self._ends, self._columns = self._ends[:last], self._columns[:last]
        self._inputs = self._inputs[: last - 1]

    def steps(self, first_input: float) -> StepTable:
        """All of it; where there is not one step, with that input."""
        return StepTable(
            np.array(self._ends),
            np.array(self._columns).T,
            np.array(self._inputs or [first_input]),
            np.array(self._samples),
            np.array(self._estimates).reshape(len(self._samples), self._count).T,
        )


@dataclass(frozen=True)
class Slopes:
    """Rates along steps that begin at `begins`.

    Attributes
    ----------
    rates : NumpyFunction
        Those of the plant's states; e_1 and its own.
    schedule : Schedule
    parameters : (P,) array
    modes : ModeRecord, optional
        Of the run; the last of the rates' parameters.
    """

    rates: NumpyFunction
    schedule: Schedule
    parameters: Array
    modes: ModeRecord | None = None

    def __call__(self, t: Array, x: Array, u: Array, begins: Array) -> tuple[Array, Array]:
        """Rates of states and integrals; e_1 and its rate."""
        pieces = [*self.schedule.pieces_at(begins * JUST_AFTER)]
        if self.modes is not None:
            pieces += [*self.modes.at(begins)]
        with np.errstate(all="ignore"):
            values = rows(self.rates(t, x, u, [*self.parameters, *pieces]), len(t))
            e = values[-2]
            integrands = np.array([u**2, e**2, e]) / INTEGRAL_SCALE
        return np.vstack([values[:-2], integrands]), values[-2:]


@dataclass(frozen=True)
class SampledSolution:
    """Dense output of a sampled run: cubic Hermite polynomials between the steps' ends.

    Attributes
    ----------
    record : StepTable
        Of one step at least.
    slopes : Slopes
    n : int
        Number of plant states.
    """

    record: StepTable
    slopes: Slopes
    n: int

    def _at_ends(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """What :class:`Slopes` gives at the begins and at the ends of all steps."""
        r, n = self.record, self.n
        begins, ends = r.ends[:-1], r.ends[1:]
        return (
            self.slopes(begins, r.columns[:n, :-1], r.inputs, begins),
            self.slopes(ends, r.columns[:n, 1:], r.inputs, begins),
        )

    @property
    def inputs(self) -> Array:
        """The input on each step."""
        return self.record.inputs

    @property
    def estimates(self) -> Array:
        """The estimates that each sample used, and the last ones."""
        return self.record.estimates

    @property
    def samples(self) -> Array:
        """Times of the samples, and the end of the run."""
        return self.record.samples

    @cached_property
    def sides(self) -> Array:
        """e_1 at the begins and at the ends of the steps, and its rate there, a row each."""
        if self.record.sides is not None:
            return self.record.sides
        (_, begin), (_, end) = self._at_ends()
        return np.array([begin[0], end[0], begin[1], end[1]])

    def _step_at(self, t: Array) -> Array:
        """Number of the step that t lies in."""
        return np.searchsorted(self.record.ends[1:-1], t, side="right")

    def input(self, t: Array) -> Array:
        """The input that acts at the times t."""
        return self.record.inputs[self._step_at(np.asarray(t, dtype=float))]

    def input_at(self, t: Array, _states: Array) -> Array:
        """The same, called as the input of any run is."""
        return self.input(t)

    def __call__(self, t: Array) -> Array:
        """Plant states, estimates and integrals at the times t."""
        t, r, n = np.asarray(t, dtype=float), self.record, self.n
        k = self._step_at(t)
        begin, h = r.ends[k], np.diff(r.ends)[k]
        s = (t - begin) / np.where(h > 0, h, 1.0)
        a, b, u = r.columns[:, k], r.columns[:, k + 1], r.inputs[k]
        da = h * self.slopes(begin, a[:n], u, begin)[0]
        db = h * self.slopes(begin + h, b[:n], u, begin)[0]
        rise = b - a
        x = a + s * (da + s * (3 * rise - 2 * da - db + s * (da + db - 2 * rise)))
        return np.vstack([x[:n], self._estimates_at(t), x[n:]])

    def subdivided(self, times: Array, parts: int) -> Array:
        """The same at the times of :func:`~certrack.integrators.base.subdivide`."""
        r, n, s = self.record, self.n, fractions(parts)
        (da, _), (db, _) = self._at_ends()
        h = np.diff(times)
        corners = np.stack([r.columns[:, :-1], r.columns[:, 1:], h * da, h * db], axis=-1)
        left = 1 - s
        weights = [left**2 * (1 + 2 * s), s**2 * (3 - 2 * s), s * left**2, -(s**2) * left]
        x = (corners @ np.array(weights)).reshape(len(r.columns), -1)
        z = np.repeat(self._estimates_at(times[:-1]), parts + 1, axis=1)
        for at in (0, -1):  # the begin and the end of the run are hit exactly
            x[:, at], z[:, at] = r.columns[:, at], self._estimates_at(times[at])
        return np.vstack([x[:n], z, x[n:]])

    def _estimates_at(self, t: Array) -> Array:
        """Those that the last sample used."""
        sample = np.searchsorted(self.record.samples, t, side="right") - 1
        return self.record.estimates[:, np.clip(sample, 0, None)]
