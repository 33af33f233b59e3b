"""Members under a sampled controller, from their numbers to metrics and bands."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import sympy

from certrack.ensembles.flow import BAND, IN_TAIL, MEMORIES, SUMS, sampled_totals
from certrack.ensembles.members import Members
from certrack.ensembles.statistics import Bands
from certrack.expressions import TIME
from certrack.integrators.base import Outcome
from certrack.integrators.maps import HeyokaMaps, NumpyMaps
from certrack.integrators.sampled import Course, SampledRun, timeline
from certrack.integrators.sampled_lanes import SampledNative
from certrack.integrators.taylor import available
from certrack.lowering import numpy_callable, rows
from certrack.noise import keys
from certrack.sampled_controller import starting_state
from certrack.sampled_loop import loop_values, sample_loop
from certrack.sampled_simulation import outputs_of
from certrack.simulated_plant import INPUT

#: Names of what is totalled; the last one is kept by the integrators themselves.
TOTALS = (*SUMS, *MEMORIES[1:], MEMORIES[0])

#: Outcome of a member that a fast method gave up.
STUCK = 2


class SampledCrowd:
    """A sampled loop compiled for many members.

    Parameters
    ----------
    members : Members
    varying : symbols
        Parameters that differ between members.
    method : {"native", "lockstep"}
    tolerance : float
    edges, shared : arrays
        Begins of the segments and the end of the run; on every segment, whether it lies in the
        tail, and the reference's piece.
    grid : (T,) array, s
        Times of the bands.

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
        edges: np.ndarray,
        shared: np.ndarray,
        grid: np.ndarray,
    ) -> None:
        system = members.template
        assert system.implementation is not None
        self._members, self._tolerance = members, tolerance
        self._edges, self._shared, self._marks = edges, shared, len(grid)
        whole = sample_loop(system, sampled_totals())
        self._rest = len(whole.controller.states) - len(system.controller.states)
        base = dict(zip(whole.parameters, loop_values(whole, system).tolist(), strict=True))
        for name in varying:
            base.pop(name, None)
        fixed = {name: sympy.Float(value) for name, value in base.items()}
        loop = whole.with_numbers(fixed)
        self._loop = replace(
            loop, parameters=(*loop.parameters, BAND), pieces=(IN_TAIL, *loop.pieces)
        )
        duration = system.settings.duration
        self._line = timeline(system.implementation, duration, edges[1:-1], grid)
        shown = (loop.e_1, *loop.plant.outputs, INPUT)
        self._native, self._maps = None, None
        if method == "native":
            self._native = SampledNative(self._loop, shown)
        else:
            heyoka = available()
            self._maps = HeyokaMaps(self._loop, vector=True) if heyoka else NumpyMaps(self._loop)
            self._shown = numpy_callable(
                [
                    TIME,
                    self._loop.plant.states,
                    INPUT,
                    [*self._loop.parameters, *self._loop.pieces],
                ],
                shown,
            )

    def run(
        self,
        begin: int,
        end: int,
        starts: np.ndarray,
        table: dict[sympy.Symbol, np.ndarray],
        part: slice,
        bands: Bands,
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """What is totalled of the members begin ... end-1, their last times, and who is stuck.

        Whole groups of eight; `part` of them is counted in the bands.
        """
        system, count = self._members.template, end - begin
        way = system.implementation
        assert way is not None
        n, controller = self._loop.plant.n, self._loop.controller
        kept = starting_state(controller, (0.0,) * (len(starts) - n), way)[:, None]
        kept = np.repeat(kept, count, axis=1)
        kept[: len(starts) - n] = starts[n:]
        totals = np.zeros((len(self._loop.totals), count))
        parameters = np.array([table[name] for name in self._loop.parameters])
        streams = keys(self._members.seed, begin, count)
        limit = system.settings.max_state
        if self._native is not None:
            passed = self._native.integrate(
                way,
                self._line,
                (starts[:n], kept, totals),
                parameters,
                streams,
                self._shared,
                self._tolerance,
                limit,
            )
            for k, rows_ in enumerate(passed.values):
                for signal, values in enumerate(rows_):
                    bands.observe(signal, k, values[part])
            stuck = passed.outcomes == STUCK
            return dict(zip(TOTALS, passed.totals, strict=True)), passed.ends, stuck
        course = Course(
            x=starts[:n],
            states=kept,
            totals=totals,
            parameters=parameters,
            way=way,
            timeline=self._line,
            outputs=outputs_of(self._loop),
            pieces=self._pieces,
            keys=streams,
            tolerance=self._tolerance,
            max_state=limit,
        )
        assert self._maps is not None
        going = SampledRun(self._maps, course)

        def look(mark: int) -> None:
            now = self._line.times[self._line.marks == mark][0]
            values = rows(self._shown(now, going.x, going.u, going.parameters), count)
            for signal, row in enumerate(values):
                bands.observe(signal, mark, row[part])

        going.go(look=look)
        for mark in range(going.marks, self._marks):
            for signal in range(bands.centre.shape[0]):
                bands.observe(signal, mark, np.full(part.stop - part.start, np.nan))
        found = dict(zip(TOTALS, [*going.totals, going.variation], strict=True))
        limits = {Outcome.finished, Outcome.escaped}
        stuck = np.array([outcome not in limits for outcome in going.outcomes])
        return found, going.ends, stuck

    def _pieces(self, time: float) -> np.ndarray:
        k = int(np.searchsorted(self._edges, time * (1 + 1e-12), side="right")) - 1
        return self._shared[min(k, len(self._shared) - 1)]
