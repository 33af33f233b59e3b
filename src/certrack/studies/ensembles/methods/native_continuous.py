"""The continuous loop by C that is written for it and compiled on this machine."""

from __future__ import annotations

import numpy as np

from certrack.integrators.base import MemberOutcome
from certrack.integrators.many.native import (
    BinCounts,
    Native,
    NativeResult,
    SharedGrid,
    StepControl,
)
from certrack.integrators.registers import GROUP_SIZE
from certrack.studies.ensembles.build_flow import build_flow, shown_signals
from certrack.studies.ensembles.methods.base import MemberResults, Method, modes_of
from certrack.studies.ensembles.metric_formulas import INTEGRAL_METRICS, MEMORY_METRICS
from certrack.studies.ensembles.problem import EnsembleProblem
from certrack.studies.ensembles.statistics import BAND_BITS, BINS_PER_SIDE, Bands, counts_shape

#: A group of members that needs more steps is given up.
MAX_GROUP_STEPS = 1_000_000


class NativeContinuous(Method):
    """Members of a continuous loop by compiled C.

    Members share their steps in groups, always the same ones, so whole groups are computed.

    Parameters
    ----------
    problem : EnsembleProblem
    threads : int
    implicit : bool
        Whether steps are linearly implicit, for a stiff loop, and not explicit.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it.
    """

    def __init__(self, problem: EnsembleProblem, threads: int, *, implicit: bool = False) -> None:
        self._problem, self._threads = problem, threads
        self._modes = modes_of(problem.members.loop, side_by_side=True)
        members = problem.members
        self._flow, switches = build_flow(members, problem.varying, any_numbers=True)
        values = dict(zip(members.loop.parameters, members.base.tolist(), strict=False))
        problem.refuse_own_times(switches)
        self._segments = problem.segments(switches, values)
        signals = shown_signals(self._flow, members.loop)
        numbers = [values[name] for name in self._flow.numbers]
        self._native = Native(self._flow, signals, numbers, implicit=implicit)
        self._table_shape = counts_shape(len(signals), len(problem.times))
        self._native.reserve(threads, self._table_shape)

    def compute(self, begin: int, end: int, bands: Bands) -> MemberResults:
        results, part = self._integrate(begin, end, bands)
        names = (*INTEGRAL_METRICS, *MEMORY_METRICS)
        totals = dict(zip(names, results.totals[:, part], strict=True))
        metrics = self._problem.metrics(totals)
        run_alone = results.outcomes[part] == MemberOutcome.run_alone
        return MemberResults(metrics, results.ends[part], run_alone)

    def final_states(self, begin: int, end: int, bands: Bands) -> np.ndarray:
        """Plant states at the end of the run, shape (n, N); NaN for a member that ended early."""
        results, part = self._integrate(begin, end, bands)
        states: np.ndarray = results.finals[: self._flow.watched, part]
        return np.where(results.ends[part] < self._problem.end, np.nan, states)

    def first_group(self, tolerance: float) -> tuple[int, int]:
        """Steps that the first group of members takes, and how many of it are given up."""
        nothing = np.zeros(self._table_shape, dtype=np.int32)
        centre, unit = np.zeros(self._table_shape[1::-1]), np.ones(self._table_shape[1])
        tally = BinCounts(slice(0, 0), BINS_PER_SIDE, BAND_BITS, nothing)
        results = self._groups(0, GROUP_SIZE, tally, centre, unit, tolerance, threads=1)
        return results.steps, int((results.outcomes == MemberOutcome.run_alone).sum())

    def _integrate(self, begin: int, end: int, bands: Bands) -> tuple[NativeResult, slice]:
        """Whole groups, and where the members begin ... end-1 are among them; these are counted."""
        first, last = begin - begin % GROUP_SIZE, -(-end // GROUP_SIZE) * GROUP_SIZE
        part = slice(begin - first, end - first)
        tally = BinCounts(part, BINS_PER_SIDE, BAND_BITS, bands.counts)
        tolerance, threads = self._problem.tolerance, self._threads
        centre, unit = bands.centre, bands.unit
        return self._groups(first, last, tally, centre, unit, tolerance, threads=threads), part

    def _groups(
        self,
        first: int,
        last: int,
        tally: BinCounts,
        centre: np.ndarray,
        unit: np.ndarray,
        tolerance: float,
        *,
        threads: int,
    ) -> NativeResult:
        """The members first ... last-1, which are whole groups."""
        problem, segments = self._problem, self._segments
        starts, table = problem.starts_and_parameters(first, last)
        modes = np.repeat(np.array(self._modes)[:, None], starts.shape[1], axis=1)
        names = self._flow.parameters[: len(self._flow.parameters) - len(modes)]
        return self._native.integrate(
            starts,
            np.vstack([[table[name] for name in names], modes]),
            SharedGrid(segments.edges, segments.shared, problem.times, centre, unit),
            StepControl(tolerance, problem.system.settings.max_state, MAX_GROUP_STEPS),
            tally,
            threads,
        )
