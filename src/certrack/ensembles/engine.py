"""From a range of member numbers to their statistics: what every worker does."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache

import numpy as np
import sympy

from certrack.ensembles.flow import BAND, MEMORIES, SUMS, make_flow, shown
from certrack.ensembles.members import AMPLITUDE, Members
from certrack.ensembles.sampled import Group, SampledCrowd, Segments, later
from certrack.ensembles.statistics import BAND_BITS, FINEST, SIDE, Bands, Statistics, Tally
from certrack.implementation import Implementation
from certrack.integrators.base import Outcome
from certrack.integrators.lockstep import Lockstep
from certrack.integrators.native import LANES, STUCK, Native, Passed, Timeline, Unavailable
from certrack.integrators.taylor import available
from certrack.metrics import Metrics
from certrack.population import Distribution
from certrack.run import Run
from certrack.sampled_controller import (
    SampledController,
    controller_values,
    sampled_controller,
)
from certrack.simulated_plant import measured
from certrack.simulation import simulate
from certrack.system import System
from certrack.systemtext import to_text

#: The metrics of a member, as those of a single run.
METRICS = tuple(entry.name for entry in fields(Metrics) if entry.name not in ("band", "tail_start"))

METHODS = ("native", "lockstep", "alone")

#: Members that one thread takes at a time in lanes: their shown values stay in the cache.
PIECE = 1024

#: The same under a sampled controller, where a member takes a thousand times as long.
SAMPLED_PIECE = 256

#: More steps than this, and a group is given up.
MOST_STEPS = 1_000_000

Range = tuple[int, int]

#: First member; metrics (one row each) and outcomes of some members.
Part = tuple[int, np.ndarray, np.ndarray]

#: Fine grid on which the reference's largest magnitude is looked for.
FINE = 20_001


@dataclass(frozen=True, eq=False)
class Plan:
    """What workers need to know.

    Attributes
    ----------
    system : System
    seed : int
    tolerance : float
    limit : float, optional
        Of the tail error.
    centre : (R, T) array
        e_1, the states of the design and u of the nominal run on the time grid.
    scale : (R,) array
        Their magnitudes, powers of two.
    method : {"native", "lockstep", "alone"}
        Compiled C; heyoka's compiled maps; or each member by itself, by the ordinary simulation.
    """

    system: System
    seed: int
    tolerance: float
    limit: float | None
    centre: np.ndarray
    scale: np.ndarray
    method: str

    @property
    def unit(self) -> np.ndarray:
        """What the bands count in."""
        return self.scale * 2.0**-FINEST

    @cached_property
    def key(self) -> bytes:
        """Equal for equal plans."""
        text = f"{to_text(self.system)} {self.seed} {self.tolerance!r} {self.limit!r} {self.method}"
        return text.encode() + self.centre.tobytes() + self.scale.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plan) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def empty(self, bands: Bands | None = None) -> Statistics:
        """Statistics of no members, or with the given bands."""
        metrics = {name: Tally() for name in METRICS}
        return Statistics(bands or Bands(self.centre, self.scale), metrics)


def make_plan(
    system: System, seed: int, tolerance: float, limit: float | None, method: str
) -> Plan:
    """A plan around the nominal run, the one of the system itself."""
    run = simulate(system)
    centre = _signals(run, grid(system))
    centre[0] = 0.0  # the error has a natural zero
    with np.errstate(invalid="ignore"):
        largest = np.nanmax(np.abs(_signals(run, run.t)), axis=1)
        if system.varied.x0:
            reach = np.abs(measured(system, _ends(system.varied.x0))).max(axis=1)
            largest[1:-1] = np.fmax(largest[1:-1], reach)
    largest[0] = np.fmax(largest[0], largest[1])
    largest[~(largest > 0)] = 1.0
    scale = np.exp2(np.rint(np.log2(largest)))
    return Plan(system, seed, tolerance, limit, np.nan_to_num(centre), scale, method)


def _ends(entries: tuple[Distribution, ...]) -> np.ndarray:
    """Points at the ends of the distributions, one column each: all but one at the same end."""
    low, high = ([getattr(entry, end) for entry in entries] for end in ("low", "high"))
    one = np.eye(len(entries), dtype=bool)
    return np.concatenate([np.where(one, low, high), np.where(one, high, low)]).T


def grid(system: System) -> np.ndarray:
    """Times of the bands, s."""
    return np.linspace(0.0, system.settings.duration, system.varied.points + 1)


def _signals(run: Run, t: np.ndarray) -> np.ndarray:
    """e_1, the states of the design and u of a run; NaN after its end."""
    n = run.system.plant.n
    inside = t <= run.trajectory.end
    found = np.full((n + 2, len(t)), np.nan)
    states = run.trajectory.interpolate(t[inside])
    found[1 : n + 1, inside] = measured(run.system, states)
    found[0, inside] = found[1, inside] - run.system.reference.values(t[inside], 0)[0]
    found[n + 1, inside] = run.input_of(t[inside], states)
    return found


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
        if plan.method == "lockstep" and not available():
            raise Unavailable("heyoka is not installed")
        _, varying = self._members.table(0, 1)
        if system.implementation is not None:
            segments = Segments(self._edges, self._shared)
            if adjustable:
                varying |= dict.fromkeys(self._sampled_controller().numbers, np.empty(0))
            self._crowd = SampledCrowd(
                self._members, varying, plan.method, plan.tolerance, segments, self._grid
            )
            return
        self._flow = make_flow(self._members, varying)
        if plan.method == "native":
            self._native = Native(self._flow, shown(self._flow, self._members.loop))
        else:
            self._lockstep = Lockstep(self._flow, plan.tolerance, parallel=threads > 1)

    def compute(self, begin: int, end: int) -> Statistics:
        """Statistics of the members begin ... end-1."""
        size = PIECE if self.plan.system.implementation is None else SAMPLED_PIECE
        starts = range(begin - begin % size, end, size)
        pieces = [(max(first, begin), min(first + size, end)) for first in starts]
        shares = [pieces[i :: self._threads] for i in range(min(self._threads, len(pieces)))]
        if self.plan.method != "native":
            shares = [[(begin, end)]]
        with ThreadPoolExecutor(len(shares)) as pool:
            done = list(pool.map(self._share, shares))
        found = done[0][0]
        for bands, _ in done[1:]:
            found.merge(bands)
        parts = sorted((part for _, parts in done for part in parts), key=lambda part: part[0])
        metrics = np.concatenate([values for _, values, _ in parts], axis=1)
        outcomes = np.concatenate([names for _, _, names in parts])
        statistics = self.plan.empty(found)
        statistics.members = end - begin
        statistics.outcomes.update(outcomes.tolist())
        for name, values in zip(METRICS, metrics, strict=True):
            statistics.metrics[name].observe(values)
        tail = metrics[METRICS.index("tail_error")]
        tail = np.where(np.isnan(tail), np.inf, tail)
        statistics.observe_worst(tail, begin)
        if self.plan.limit is not None:
            statistics.violations = int((tail > self.plan.limit).sum())
        return statistics

    def final_states(self, begin: int, end: int) -> np.ndarray:
        """States of the design at the end of the run, shape (n, N); compiled C only."""
        passed = self._pass(begin, end)
        reduced = passed.values[-1, 1:-1, begin % LANES : begin % LANES + end - begin]
        plan = self.plan
        found: np.ndarray = reduced * plan.unit[1:-1, None] + plan.centre[1:-1, -1:]
        return found

    def _share(self, pieces: list[Range]) -> tuple[Bands, list[Part]]:
        """What one thread computes: bands, and every member's metrics and outcome."""
        bands = Bands(self.plan.centre, self.plan.scale)
        return bands, [(begin, *self._piece(begin, end, bands)) for begin, end in pieces]

    def _piece(self, begin: int, end: int, bands: Bands) -> tuple[np.ndarray, np.ndarray]:
        """Metrics and outcomes of the members begin ... end-1; their signals go to the bands."""
        count = end - begin
        metrics = np.full((len(METRICS), count), np.nan)
        outcomes = np.full(count, Outcome.finished.name, dtype=object)
        ends = np.full(count, -1.0)
        alone = np.ones(count, dtype=bool)
        if self.plan.method != "alone":
            together = self._in_lanes if self.plan.method == "native" else self._in_step
            if self.plan.system.implementation is not None:
                together = self._sampled
            metrics, ends, alone = together(begin, end, bands)
            outcomes[~alone & (ends < self._edges[-1])] = Outcome.escaped.name
            metrics[:, ends < self._edges[-1]] = np.nan
        for i in np.flatnonzero(alone).tolist():
            run = simulate(self._members.member(begin + i))
            outcomes[i] = run.outcome.name
            if run.outcome is Outcome.finished:
                metrics[:, i] = [getattr(run.metrics, name) for name in METRICS]
            self._show_alone(run, float(ends[i]), bands)
        return metrics, outcomes

    def _show_alone(self, run: Run, after: float, bands: Bands) -> None:
        """Count a run of its own where the lockstep did not."""
        late = np.flatnonzero(later(self._grid, after))
        signals = _signals(run, self._grid[late])
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
            for signal, row in enumerate(values):
                bands.observe(signal, mark, row[part][counted[part]])

        group = Group(first, *self._varied(first, last))
        totals, ends, alone = self._crowd.run(group, show)
        metrics = self._metrics({name: values[part] for name, values in totals.items()})
        return metrics, ends[part], alone[part]

    def extremes(self, members: int, way: Implementation) -> tuple[float, float]:
        """Largest tail error and input of the first members under another implementation.

        The error is inf where a member does not finish.

        Parameters
        ----------
        members : int
        way : Implementation
            With the structure of the system's own.
        """
        system, controller = self.plan.system, self._sampled_controller()
        values = controller_values(controller, system.plant, system.law, way)
        numbers = dict(zip(controller.parameters, values, strict=True))
        numbers = {name: numbers[name] for name in controller.numbers}
        size = LANES * max(1, members // (LANES * self._threads))

        def extremes(first: int) -> tuple[float, float]:
            starts, table = self._varied(first, first + size)
            table |= {name: np.full(size, value) for name, value in numbers.items()}
            group = Group(first, starts, table)
            totals, ends, alone = self._crowd.run(group, lambda *_: None, way)
            mine = slice(0, members - first)
            done = ~alone & (ends >= self._edges[-1])
            tails = np.where(done, totals["tail_error"], np.inf)[mine]
            return float(tails.max()), float(np.nanmax(totals["peak_input"][mine]))

        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(extremes, range(0, members, size)))
        return max(tail for tail, _ in found), max(peak for _, peak in found)

    def _sampled_controller(self) -> SampledController:
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

    def _in_lanes(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Metrics, last times, and who must be run alone."""
        part = slice(begin % LANES, begin % LANES + end - begin)
        passed = self._pass(begin, end)
        self._native.count(passed, part, SIDE, BAND_BITS, bands.counts)
        totals = dict(zip((*SUMS, *MEMORIES), passed.totals[:, part], strict=True))
        return self._metrics(totals), passed.ends[part], passed.outcomes[part] == STUCK

    def _pass(self, begin: int, end: int) -> Passed:
        """Members share their steps in groups of eight, always the same eight: whole groups."""
        plan = self.plan
        starts, parameters = self._table(begin - begin % LANES, -(-end // LANES) * LANES)
        timeline = Timeline(self._edges, self._shared, self._grid, plan.centre, plan.unit)
        limit = plan.system.settings.max_state
        return self._native.integrate(
            starts, parameters, timeline, plan.tolerance, limit, MOST_STEPS
        )

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


@lru_cache(maxsize=4)
def engine(plan: Plan) -> Engine:
    """The compiled plan of a worker process."""
    return Engine(plan)


def compute_chunk(plan: Plan, begin: int, end: int) -> tuple[dict[str, np.ndarray], float]:
    """What a worker process runs: packed statistics, and the seconds without compilation."""
    ready = engine(plan)
    clock = time.perf_counter()
    return ready.compute(begin, end).packed(), time.perf_counter() - clock
