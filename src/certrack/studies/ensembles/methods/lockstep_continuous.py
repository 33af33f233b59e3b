"""The continuous loop by heyoka: all members take the same steps, one compiled step for all."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from certrack.core.heyoka import has_heyoka
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.lockstep import Lockstep
from certrack.studies.ensembles.build_flow import build_flow, shown_signals
from certrack.studies.ensembles.methods.base import MemberResults, Method, modes_of
from certrack.studies.ensembles.metric_formulas import INTEGRAL_METRICS, MEMORY_METRICS
from certrack.studies.ensembles.problem import EnsembleProblem
from certrack.studies.ensembles.statistics import Bands


class LockstepContinuous(Method):
    """Members of a continuous loop in lockstep.

    Parameters
    ----------
    problem : EnsembleProblem
    threads : int

    Raises
    ------
    MethodUnavailable
        If heyoka is not installed.
    """

    def __init__(self, problem: EnsembleProblem, threads: int) -> None:
        if not has_heyoka():
            raise MethodUnavailable("heyoka is not installed")
        self._problem = problem
        modes_of(problem.members.loop, side_by_side=False)
        self._flow, switches = build_flow(problem.members, problem.varying)
        problem.refuse_own_times(switches)
        self._segments = problem.segments(switches)
        self._lockstep = Lockstep(self._flow, problem.tolerance, parallel=threads > 1)
        self._times = np.union1d(problem.times, self._segments.edges)
        jumps = np.searchsorted(self._times, self._segments.edges[1:-1])
        self._restarts = frozenset(jumps.tolist())
        self._shown_rows = self._rows_of_shown_signals()

    def _rows_of_shown_signals(self) -> list[int]:
        """Where in a member's column the signals of the bands lie."""
        flow = self._flow
        row_of = dict(zip(flow.states, itertools.count()))
        signals = (end for _, end in flow.sides)
        row_of |= zip(signals, itertools.count(flow.rows["signals"].start))
        return [row_of[name] for name in shown_signals(flow, self._problem.members.loop)]

    def compute(self, begin: int, end: int, bands: Bands) -> MemberResults:
        problem, rows = self._problem, self._flow.rows
        starts, table = problem.starts_and_parameters(begin, end)
        parameters = np.array([table[name] for name in self._flow.parameters])
        band_index = {int(np.searchsorted(self._times, t)): k for k, t in enumerate(problem.times)}
        totals: dict[str, np.ndarray] = {}

        def on_grid_point(k: int, row: Callable[[int], np.ndarray]) -> None:
            if k in band_index:
                for signal, index in enumerate(self._shown_rows):
                    bands.observe(signal, band_index[k], row(index))
            if k == len(self._times) - 1:
                for kind, names in (("integrals", INTEGRAL_METRICS), ("memories", MEMORY_METRICS)):
                    first = rows[kind].start
                    totals.update((name, row(first + i)) for i, name in enumerate(names))

        ends, run_alone = self._lockstep.run(
            starts,
            parameters,
            self._times,
            self._segments.at,
            on_grid_point,
            problem.system.settings.max_state,
            self._restarts,
        )
        return MemberResults(problem.metrics(totals), ends, run_alone)
