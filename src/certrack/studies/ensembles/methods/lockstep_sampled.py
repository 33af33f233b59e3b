"""The sampled loop by maps from event to event: heyoka's, or NumPy's where it is missing."""

from __future__ import annotations

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.sampled.maps import HeyokaMaps, NumpyMaps, SampledMaps
from certrack.integrators.sampled.run import SampledProblem, SampledRun
from certrack.loops.plant import INPUT
from certrack.studies.ensembles.methods.sampled_base import (
    TOTALS,
    GroupResults,
    OnGridPoint,
    SampledMethod,
)
from certrack.studies.ensembles.problem import EnsembleProblem


class LockstepSampled(SampledMethod):
    """Members of a sampled loop by compiled maps; every machine has this method."""

    def __init__(self, problem: EnsembleProblem, threads: int, *, adjustable: bool) -> None:
        super().__init__(problem, threads, adjustable=adjustable)
        loop = self.loop
        self._maps: SampledMaps = HeyokaMaps(loop, vector=True) if has_heyoka() else NumpyMaps(loop)
        names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
        self._shown_values = numpy_callable(names, self.shown)

    def integrate(self, group: SampledProblem, on_grid_point: OnGridPoint) -> GroupResults:
        run = SampledRun(self._maps, group)
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
