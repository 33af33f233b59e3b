"""The sampled loop by maps from event to event: heyoka's, or NumPy's where it is missing.

Without heyoka a few members are run one by one in plain Python numbers: a step of one member costs
NumPy as much as a step of a hundred.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.sampled.maps import HeyokaMaps, NumpyMaps, SampledMaps
from certrack.integrators.sampled.run import SampledProblem, SampledRun
from certrack.integrators.sampled.scalar_maps import ScalarMaps
from certrack.loops.plant import INPUT
from certrack.studies.ensembles.methods.sampled_base import (
    TOTALS,
    GroupResults,
    OnGridPoint,
    SampledMethod,
)
from certrack.studies.ensembles.problem import EnsembleProblem

#: Fewer members than this are faster one by one in Python than together in NumPy (measured).
SINGLE_MEMBERS = 6


class LockstepSampled(SampledMethod):
    """Members of a sampled loop by compiled maps; every machine has this method."""

    def __init__(self, problem: EnsembleProblem, threads: int, *, adjustable: bool) -> None:
        super().__init__(problem, threads, adjustable=adjustable)
        loop = self.loop
        self.whole_registers = has_heyoka()
        self._maps: SampledMaps = HeyokaMaps(loop, vector=True) if has_heyoka() else NumpyMaps(loop)
        self._one = self._maps if has_heyoka() else ScalarMaps(loop)
        names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
        self._shown_values = numpy_callable(names, self.shown)

    def integrate(self, group: SampledProblem, on_grid_point: OnGridPoint) -> GroupResults:
        if self.whole_registers or group.x.shape[1] >= SINGLE_MEMBERS:
            return self._together(self._maps, group, on_grid_point)
        return self._one_by_one(group, on_grid_point)

    def _one_by_one(self, group: SampledProblem, on_grid_point: OnGridPoint) -> GroupResults:
        """Each member by itself; what is shown is handed over for all of them at once."""
        count, points = group.x.shape[1], int((group.timeline.marks >= 0).sum())
        shown = np.full((points, len(self.shown), count), np.nan)
        valid = np.zeros((points, count), dtype=bool)
        parts = []
        for i in range(count):

            def keep(k: int, values: np.ndarray, is_counted: np.ndarray, i: int = i) -> None:
                shown[k, :, i], valid[k, i] = values[:, 0], is_counted[0]

            parts.append(self._together(self._one, _member(group, i), keep))
        for k in range(points):
            on_grid_point(k, shown[k], valid[k])
        return GroupResults(
            {name: np.concatenate([part.totals[name] for part in parts]) for name in TOTALS},
            np.concatenate([part.ends for part in parts]),
            np.concatenate([part.run_alone for part in parts]),
        )

    def _together(
        self, maps: SampledMaps, group: SampledProblem, on_grid_point: OnGridPoint
    ) -> GroupResults:
        run = SampledRun(maps, group)
        events, count = group.timeline, group.x.shape[1]
        times = events.times[events.marks >= 0]

        def at_grid_point(k: int) -> None:
            values = self._shown_values(times[k], run.x, run.u, run.parameters)
            on_grid_point(k, rows(values, count), ~run.run_alone)

        run.run(on_mark=at_grid_point)
        missing = np.full((len(self.shown), count), np.nan)
        for k in range(run.marks, len(times)):
            on_grid_point(k, missing, ~run.run_alone)
        totals = dict(zip(TOTALS, [*run.totals, run.variation], strict=True))
        return GroupResults(totals, run.ends, run.run_alone)


def _member(group: SampledProblem, i: int) -> SampledProblem:
    """The problem of one member of a group."""
    one = slice(i, i + 1)
    return replace(
        group,
        x=group.x[:, one],
        states=group.states[:, one],
        totals=group.totals[:, one],
        parameters=np.ascontiguousarray(group.parameters[:, one]),
        keys=group.keys[one],
    )
