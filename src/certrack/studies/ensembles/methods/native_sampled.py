"""The sampled loop by C that is written for it and compiled on this machine."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from certrack.integrators.base import MemberOutcome, MethodUnavailable
from certrack.integrators.sampled.native import SampledNative
from certrack.integrators.sampled.run import SampledProblem
from certrack.simulation.planned_input import limited_plans
from certrack.studies.ensembles.methods.base import MemberResults
from certrack.studies.ensembles.methods.sampled_base import (
    TOTALS,
    GroupResults,
    OnGridPoint,
    SampledMethod,
)
from certrack.studies.ensembles.problem import EnsembleProblem, is_clearly_after
from certrack.studies.ensembles.statistics import Bands

#: Members that a thread takes at a time; a multiple of the lanes.
PART_MEMBERS = 256


class NativeSampled(SampledMethod):
    """Members of a sampled loop by compiled C; the threads take parts of a range in turns.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it.
    """

    any_numbers = True

    def __init__(self, problem: EnsembleProblem, threads: int, *, adjustable: bool) -> None:
        super().__init__(problem, threads, adjustable=adjustable)
        if self.surfaces is not None:
            raise MethodUnavailable("sign() of a state makes the plant slide: not in compiled C")
        plans = limited_plans(problem.system, self.timeline)
        if plans is not None and self.varies_what_is_planned:
            raise MethodUnavailable("members whose plans of the input differ run alone")
        self._native = SampledNative(self.loop, self.shown, self.numbers, plans)

    def compute(self, begin: int, end: int, bands: Bands) -> MemberResults:
        firsts = range(begin - begin % PART_MEMBERS, end, PART_MEMBERS)
        begins = [max(first, begin) for first in firsts]
        ends = [min(first + PART_MEMBERS, end) for first in firsts]
        compute_part = super().compute
        with ThreadPoolExecutor(self.threads) as pool:
            parts = list(pool.map(lambda a, b: compute_part(a, b, bands), begins, ends))
        return MemberResults(
            np.concatenate([part.metrics for part in parts], axis=1),
            np.concatenate([part.ends for part in parts]),
            np.concatenate([part.run_alone for part in parts]),
        )

    def integrate(self, group: SampledProblem, on_grid_point: OnGridPoint) -> GroupResults:
        results = self._native.integrate(group, self.segments.shared)
        run_alone = results.outcomes == MemberOutcome.run_alone
        for k, values in enumerate(results.values):
            not_reached = is_clearly_after(self.problem.times[k], results.ends)
            on_grid_point(k, values, ~(run_alone & not_reached))
        totals = dict(zip(TOTALS, results.totals, strict=True))
        return GroupResults(totals, results.ends, run_alone)
