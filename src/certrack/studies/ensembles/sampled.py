"""Members under a sampled controller, from their numbers to metrics and bands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.many.native import STUCK
from certrack.integrators.many.sampled_events import EventTimeline, event_timeline
from certrack.integrators.many.sampled_maps import HeyokaMaps, Maps, NumpyMaps
from certrack.integrators.many.sampled_native import SampledNative
from certrack.integrators.many.sampled_run import SampledProblem, SampledRun
from certrack.integrators.single.taylor import available
from certrack.loops.controller import starting_state
from certrack.loops.plant import INPUT
from certrack.loops.sampled import loop_values, sample_loop
from certrack.model.implementation import Implementation
from certrack.model.noise import keys
from certrack.simulation.sampled import outputs_of
from certrack.studies.ensembles.flow import BAND, IN_TAIL, MEMORIES, SUMS, sampled_totals
from certrack.studies.ensembles.members import Members

#: Names of what is totalled; the last one is kept by the integrators themselves.
TOTALS = (*SUMS, *MEMORIES[1:], MEMORIES[0])


@dataclass(frozen=True)
class Segments:
    """Where rates, signals or what is totalled may jump.

    Attributes
    ----------
    edges : (K+1,) array, s
        Begins of the segments, and the end of the run.
    shared : (K, H) array
        On each, whether it lies in the tail, and the reference's piece.
    """

    edges: np.ndarray
    shared: np.ndarray

    def at(self, time: float) -> np.ndarray:
        """Values on the segment that begins at or contains `time`."""
        k = int(np.searchsorted(self.edges, time * (1 + 1e-12), side="right")) - 1
        found: np.ndarray = self.shared[min(k, len(self.shared) - 1)]
        return found


@dataclass(frozen=True)
class Group:
    """Members that are run together; whole groups of eight.

    Attributes
    ----------
    first : int
    starts : (S, N) array
        Plant states and estimates.
    table : values of every parameter that varies, by symbol
    """

    first: int
    starts: np.ndarray
    table: Mapping[sympy.Symbol, np.ndarray]


#: Gets the number of a time of the grid, the shown values of all members there, and which of them
#: count: those that have to be run alone show what comes after their last time themselves.
Show = Callable[[int, np.ndarray, np.ndarray], None]

#: What is totalled, by name; last times; which members have to be run alone.
Found = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]


class SampledCrowd:
    """A sampled loop compiled for many members.

    Parameters
    ----------
    members : Members
    varying : symbols
        Parameters that differ between members; the others get their values.
    method : {"native", "lockstep"}
    tolerance : float
    segments : Segments
    grid : (T,) array, s
        Times at which members are shown: e_1, the measured states, u.

    Raises
    ------
    Unavailable
        If this machine does not have the method.
    """

    def __init__(
        self,
        members: Members,
        varying: Iterable[sympy.Symbol],
        method: str,
        tolerance: float,
        segments: Segments,
        grid: np.ndarray,
    ) -> None:
        self._system, self._seed = members.template, members.seed
        self._tolerance, self._segments, self._grid = tolerance, segments, grid
        whole = sample_loop(self._system, sampled_totals())
        base = dict(zip(whole.parameters, loop_values(whole, self._system).tolist(), strict=True))
        free = set(varying)
        loop = whole.with_numbers(
            {name: sympy.Float(value) for name, value in base.items() if name not in free}
        )
        self._loop = loop = replace(
            loop, parameters=(*loop.parameters, BAND), pieces=(IN_TAIL, *loop.pieces)
        )
        self._line = self._timeline(self._system.implementation)
        self._outputs = outputs_of(loop)
        shown = (loop.e_1, *loop.plant.outputs, INPUT)
        self._native, self._maps = None, None
        if method == "native":
            self._native = SampledNative(loop, shown)
        else:
            heyoka = available()
            self._maps = HeyokaMaps(loop, vector=True) if heyoka else NumpyMaps(loop)
            names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
            self._shown = numpy_callable(names, shown)

    def run(self, group: Group, show: Show, implementation: Implementation | None = None) -> Found:
        """Run members to their end.

        Parameters
        ----------
        group : Group
        show : Show
        implementation : Implementation, optional
            Another one than the system's, with the same structure; the parameters that it
            changes must be among the varying ones.
        """
        system, count = self._system, group.starts.shape[1]
        line = self._line if implementation is None else self._timeline(implementation)
        implementation = implementation or system.implementation
        assert implementation is not None
        n, settings = self._loop.plant.n, system.settings
        kept = starting_state(
            self._loop.controller, (0.0,) * (len(group.starts) - n), implementation
        )
        states = np.repeat(kept[:, None], count, axis=1)
        states[: len(group.starts) - n] = group.starts[n:]
        course = SampledProblem(
            x=group.starts[:n],
            states=states,
            totals=np.zeros((len(self._loop.totals), count)),
            parameters=np.array([group.table[name] for name in self._loop.parameters]),
            implementation=implementation,
            timeline=line,
            outputs=self._outputs,
            pieces=self._segments.at,
            keys=keys(self._seed, group.first, count),
            tolerance=self._tolerance,
            max_state=settings.max_state,
        )
        if self._native is not None:
            return self._by_native(self._native, course, show)
        assert self._maps is not None
        return self._by_maps(self._maps, course, show)

    def _timeline(self, implementation: Implementation | None) -> EventTimeline:
        """All events under an implementation: the same for all members."""
        assert implementation is not None
        duration = self._system.settings.duration
        return event_timeline(implementation, duration, self._segments.edges[1:-1], self._grid)

    def _by_native(self, native: SampledNative, course: SampledProblem, show: Show) -> Found:
        passed = native.integrate(course, self._segments.shared)
        stuck = passed.outcomes == STUCK
        for mark, values in enumerate(passed.values):
            show(mark, values, ~(stuck & later(self._grid[mark], passed.ends)))
        totals = dict(zip(TOTALS, passed.totals, strict=True))
        return totals, passed.ends, stuck

    def _by_maps(self, maps: Maps, course: SampledProblem, show: Show) -> Found:
        run, line, count = SampledRun(maps, course), course.timeline, course.x.shape[1]
        times = line.times[line.marks >= 0]

        def look(mark: int) -> None:
            values = self._shown(times[mark], run.x, run.u, run.parameters)
            show(mark, rows(values, count), ~run.stuck)

        run.run(on_mark=look)
        for mark in range(run.marks, len(times)):
            show(mark, np.full((len(self._loop.plant.outputs) + 2, count), np.nan), ~run.stuck)
        totals = dict(zip(TOTALS, [*run.totals, run.variation], strict=True))
        return totals, run.ends, run.stuck


def later(time: float | np.ndarray, end: float | np.ndarray) -> np.ndarray:
    """Whether a time of the grid lies after an event that rounding may have moved."""
    return np.asarray(time > np.asarray(end) * (1 + 1e-12))
