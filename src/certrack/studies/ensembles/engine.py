"""From a range of member numbers to their statistics: what every worker does."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, lru_cache
from threading import Lock

import numpy as np
import sympy

from certrack.integrators.base import Outcome
from certrack.integrators.many.lockstep import Lockstep
from certrack.integrators.many.native import (
    STUCK,
    BinCounts,
    Native,
    NativeResult,
    SharedGrid,
    StepControl,
    Unavailable,
)
from certrack.integrators.many.registers import GROUP_SIZE, LANES
from certrack.integrators.single.taylor import available
from certrack.loops.controller import (
    SampledController,
    controller_values,
    sampled_controller,
)
from certrack.model.implementation import Implementation
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.ensembles.flow import BAND, MEMORIES, SUMS, make_flow, shown
from certrack.studies.ensembles.members import AMPLITUDE, Members
from certrack.studies.ensembles.plan import METHODS, METRICS, Plan, grid, signals_of
from certrack.studies.ensembles.sampled import Group, SampledCrowd, Segments, later
from certrack.studies.ensembles.statistics import BAND_BITS, SIDE, Bands, Statistics

#: Numbers of the outcomes.
CODES = {outcome: code for code, outcome in enumerate(Outcome)}

#: Members under a sampled controller that a thread takes at a time.
SAMPLED_PIECE = 256

#: More steps than this, and a group is given up.
MOST_STEPS = 1_000_000

#: Fine grid on which the reference's largest magnitude is looked for.
FINE = 20_001


class Engine:
    """A plan, compiled.

    Parameters
    ----------
    plan : Plan
    threads : int
        Cores to use.
    adjustable : bool
        Whether :meth:`extremes` is to be asked for other implementations.
    """

    def __init__(self, plan: Plan, threads: int = 1, *, adjustable: bool = False) -> None:
        self.plan, self._threads = plan, threads
        system = plan.system
        self._members = Members(system, plan.seed)
        self._counting = Lock()  # several threads count in the same bands
        settings, reference = system.settings, system.reference
        self._grid = grid(system)
        fine = np.linspace(0.0, settings.duration, FINE)
        reach = float(np.abs(reference.values(fine, 0)[0]).max())
        self._band = settings.band or 0.05 * reach or 0.05
        breaks = reference.breaks(0.0, settings.duration)
        ends = [0.0, settings.tail_start, settings.duration]
        self._edges = np.unique(np.concatenate([ends, breaks]))
        self._shared = np.array([self._shared_at(time) for time in self._edges[:-1]])
        if plan.method == "alone":
            return
        _, varying = self._members.table(0, 1)
        if system.implementation is not None:
            segments = Segments(self._edges, self._shared)
            if adjustable:
                varying |= dict.fromkeys(self._controller.numbers, np.empty(0))
            self._crowd = SampledCrowd(
                self._members, varying, plan.method, plan.tolerance, segments, self._grid
            )
            return
        self._flow = make_flow(self._members, varying)
        if plan.method == "native":
            self._native = Native(self._flow, shown(self._flow, self._members.loop))
            self._native.reserve(threads, plan.empty().bands.counts.shape)
        elif not available():
            raise Unavailable("heyoka is not installed")
        else:
            self._lockstep = Lockstep(self._flow, plan.tolerance, parallel=threads > 1)

    def compute(self, begin: int, end: int, total: Statistics | None = None) -> Statistics:
        """Statistics of the members begin ... end-1; added to those of others, if given.

        A fresh table of counts costs as much as a thousand members.
        """
        statistics = self.plan.empty() if total is None else total
        metrics, outcomes = self._piece(begin, end, statistics.bands)
        statistics.members += end - begin
        for outcome, count in zip(CODES, np.bincount(outcomes).tolist(), strict=False):
            if count:
                statistics.outcomes[outcome.name] += count
        for name, values in zip(METRICS, metrics, strict=True):
            statistics.metrics[name].observe(values)
        tail = metrics[METRICS.index("tail_error")]
        tail = np.where(np.isnan(tail), np.inf, tail)
        statistics.observe_worst(tail, begin)
        if self.plan.limit is not None:
            statistics.violations += int((tail > self.plan.limit).sum())
        return statistics

    def final_states(self, begin: int, end: int) -> np.ndarray:
        """Plant states at the end of the run, shape (n, N); compiled C only."""
        passed, part = self._pass(begin, end, Bands(self.plan.centre, self.plan.scale))
        found: np.ndarray = passed.finals[: self._flow.watched, part]
        return np.where(passed.ends[part] < self._edges[-1], np.nan, found)

    def _piece(self, begin: int, end: int, bands: Bands) -> tuple[np.ndarray, np.ndarray]:
        """Metrics of the members begin ... end-1, and their outcomes by number.

        Their signals go to the bands.
        """
        count = end - begin
        metrics = np.full((len(METRICS), count), np.nan)
        outcomes = np.full(count, CODES[Outcome.finished])
        ends = np.full(count, -1.0)
        alone = np.ones(count, dtype=bool)
        if self.plan.method != "alone":
            native = self.plan.method == "native"
            if self.plan.system.implementation is not None:
                together = self._in_threads if native else self._sampled
            else:
                together = self._in_lanes if native else self._in_step
            metrics, ends, alone = together(begin, end, bands)
            if (early := ends < self._edges[-1]).any():
                outcomes[early & ~alone] = CODES[Outcome.escaped]
                metrics[:, early] = np.nan
        for i in np.flatnonzero(alone).tolist():
            run = simulate(self._members.member(begin + i))
            outcomes[i] = CODES[run.outcome]
            if run.outcome is Outcome.finished:
                metrics[:, i] = [getattr(run.metrics, name) for name in METRICS]
            self._show_alone(run, float(ends[i]), bands)
        return metrics, outcomes

    def _show_alone(self, run: Run, after: float, bands: Bands) -> None:
        """Count a run of its own where the lockstep did not."""
        late = np.flatnonzero(later(self._grid, after))
        signals = signals_of(run, self._grid[late])
        for signal, values in enumerate(signals):
            for k, value in zip(late.tolist(), values, strict=True):
                bands.observe(signal, k, np.array([value]))

    def _sampled(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, under a sampled controller; whole groups of eight share their steps."""
        first, last = begin - begin % LANES, -(-end // LANES) * LANES
        part = slice(begin - first, end - first)

        def show(mark: int, values: np.ndarray, counted: np.ndarray) -> None:
            with self._counting:
                for signal, row in enumerate(values):
                    bands.observe(signal, mark, row[part][counted[part]])

        group = Group(first, *self._varied(first, last))
        totals, ends, alone = self._crowd.run(group, show)
        metrics = self._metrics({name: values[part] for name, values in totals.items()})
        return metrics, ends[part], alone[part]

    def extremes(self, members: int, implementation: Implementation) -> tuple[float, float]:
        """Largest tail error and input of the first members under another implementation.

        The error is inf where a member does not finish.

        Parameters
        ----------
        members : int
        implementation : Implementation
            With the structure of the system's own.
        """
        system, controller = self.plan.system, self._controller
        values = controller_values(controller, system.plant, system.law, implementation)
        numbers = dict(zip(controller.parameters, values, strict=True))
        numbers = {name: numbers[name] for name in controller.numbers}
        size = LANES * max(1, members // (LANES * self._threads))

        def extremes(first: int) -> tuple[float, float]:
            starts, table = self._varied(first, first + size)
            table |= {name: np.full(size, value) for name, value in numbers.items()}
            group = Group(first, starts, table)
            totals, ends, alone = self._crowd.run(group, lambda *_: None, implementation)
            mine = slice(0, members - first)
            done = ~alone & (ends >= self._edges[-1])
            tails = np.where(done, totals["tail_error"], np.inf)[mine]
            return float(tails.max()), float(np.nanmax(totals["peak_input"][mine]))

        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(extremes, range(0, members, size)))
        return max(tail for tail, _ in found), max(peak for _, peak in found)

    @cached_property
    def _controller(self) -> SampledController:
        """The sampled controller of the plan's system."""
        system = self.plan.system
        assert system.implementation is not None
        return sampled_controller(system.plant, system.controller, system.implementation)

    def _table(self, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Starts and parameters of some members, as the flow has them."""
        starts, table = self._varied(begin, end)
        return starts, np.array([table[name] for name in self._flow.parameters])

    def _varied(self, begin: int, end: int) -> tuple[np.ndarray, dict[sympy.Symbol, np.ndarray]]:
        """Starts and parameters of some members, by name."""
        starts, table = self._members.table(begin, end)
        band = np.full(end - begin, self._band)
        amplitude = table.get(AMPLITUDE)
        if self.plan.system.settings.band is None and amplitude is not None:
            band *= np.abs(amplitude)
        table[BAND] = band
        return starts, table

    def _in_threads(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, in pieces that threads take in turns."""
        starts = range(begin - begin % SAMPLED_PIECE, end, SAMPLED_PIECE)
        shares = [(max(a, begin), min(a + SAMPLED_PIECE, end), bands) for a in starts]
        with ThreadPoolExecutor(self._threads) as pool:
            found = pool.map(self._sampled, *zip(*shares, strict=True))
        metrics, ends, alone = zip(*found, strict=True)
        return np.concatenate(metrics, axis=1), np.concatenate(ends), np.concatenate(alone)

    def _in_lanes(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Metrics, last times, and who must be run alone."""
        passed, part = self._pass(begin, end, bands)
        totals = dict(zip((*SUMS, *MEMORIES), passed.totals[:, part], strict=True))
        return self._metrics(totals), passed.ends[part], passed.outcomes[part] == STUCK

    def _pass(self, begin: int, end: int, bands: Bands) -> tuple[NativeResult, slice]:
        """Members share their steps in groups, always the same ones: whole groups are computed.

        Counts the members begin ... end-1, and says where they are among the computed.
        """
        plan, first = self.plan, begin - begin % GROUP_SIZE
        starts, parameters = self._table(first, -(-end // GROUP_SIZE) * GROUP_SIZE)
        timeline = SharedGrid(self._edges, self._shared, self._grid, plan.centre, plan.unit)
        part = slice(begin - first, end - first)
        control = StepControl(plan.tolerance, plan.system.settings.max_state, MOST_STEPS)
        counted = BinCounts(part, SIDE, BAND_BITS, bands.counts)
        passed = self._native.integrate(
            starts, parameters, timeline, control, counted, self._threads
        )
        return passed, part

    def _in_step(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, by the lockstep method."""
        lockstep, rows = self._lockstep, self._lockstep.rows
        starts, parameters = self._table(begin, end)
        times = np.union1d(self._grid, self._edges)
        places = {int(np.searchsorted(times, t)): k for k, t in enumerate(self._grid)}
        restarts = frozenset(np.searchsorted(times, self._edges[1:-1]).tolist())
        places_of = dict(zip(self._flow.states, itertools.count()))
        signals = (end for _, end in self._flow.sides)
        places_of |= zip(signals, itertools.count(rows["signals"].start))
        bands_of = [places_of[name] for name in shown(self._flow, self._members.loop)]
        last: dict[str, np.ndarray] = {}

        def look(k: int, row: Callable[[int], np.ndarray]) -> None:
            if k in places:
                for signal, index in enumerate(bands_of):
                    bands.observe(signal, places[k], row(index))
            if k == len(times) - 1:
                for kind, names in (("integrals", SUMS), ("memories", MEMORIES)):
                    last.update((name, row(rows[kind].start + i)) for i, name in enumerate(names))

        limit = self.plan.system.settings.max_state
        ends, stuck = lockstep.run(
            starts, parameters, times, self._shared_at, look, limit, restarts
        )
        return self._metrics(last), ends, stuck

    def _metrics(self, totals: dict[str, np.ndarray]) -> np.ndarray:
        """In the order of METRICS."""
        duration, outside = self.plan.system.settings.duration, totals["last_outside"]
        found = totals | {
            "settling_time": np.where(outside >= duration * (1 - 1e-12), np.nan, outside),
            "rms_error": np.sqrt(np.maximum(totals["integral_squared_error"], 0.0) / duration),
        }
        return np.array([found[name] for name in METRICS])

    def _shared_at(self, time: float) -> np.ndarray:
        """Values of the shared symbols: whether the tail has begun, the reference's piece."""
        tail = float(time >= self.plan.system.settings.tail_start)
        return np.concatenate([[tail], self.plan.system.reference.piece_values(time)])


def fastest(plan: Plan, threads: int, *, adjustable: bool = False) -> Engine:
    """The plan by the first method that this machine has, whatever the plan's is."""
    for name in METHODS:
        try:
            return Engine(replace(plan, method=name), threads, adjustable=adjustable)
        except Unavailable:
            continue
    raise AssertionError("members can always be run alone")


@lru_cache(maxsize=4)
def engine(plan: Plan) -> Engine:
    """The compiled plan of a worker process."""
    return Engine(plan)


def compute_chunk(plan: Plan, begin: int, end: int) -> tuple[dict[str, np.ndarray], float]:
    """What a worker process runs: packed statistics, and the seconds without compilation."""
    ready = engine(plan)
    clock = time.perf_counter()
    return ready.compute(begin, end).packed(), time.perf_counter() - clock
