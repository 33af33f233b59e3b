"""From a range of member numbers to their statistics: what every worker does."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from certrack.ensembles.flow import BAND, MEMORIES, SIGNALS, SUMS, make_flow, shown
from certrack.ensembles.members import AMPLITUDE, Members
from certrack.ensembles.statistics import BAND_BITS, FINEST, SIDE, Bands, Statistics, Tally
from certrack.integrators.base import Outcome
from certrack.integrators.lockstep import Lockstep
from certrack.integrators.native import (
    GROUP,
    STUCK,
    Control,
    Counted,
    Native,
    Passed,
    Timeline,
    Unavailable,
)
from certrack.integrators.taylor import available
from certrack.metrics import Metrics
from certrack.run import Run
from certrack.simulation import simulate
from certrack.system import System
from certrack.systemtext import to_text

#: The metrics of a member, as those of a single run.
METRICS = tuple(entry.name for entry in fields(Metrics) if entry.name not in ("band", "tail_start"))

METHODS = ("native", "lockstep", "alone")

#: Threads share the members in pieces of so many, whose random numbers are drawn together.
PIECE = 1024

#: More steps than this, and a group is given up.
MOST_STEPS = 1_000_000

Range = tuple[int, int]

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
        e_1, the states and u of the nominal run on the time grid.
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
    reach = [max(abs(d.low), abs(d.high)) for d in system.varied.x0 or ()]
    largest[1 : len(reach) + 1] = np.fmax(largest[1 : len(reach) + 1], reach)
    largest[0] = np.fmax(largest[0], largest[1])
    largest[~(largest > 0)] = 1.0
    scale = np.exp2(np.rint(np.log2(largest)))
    return Plan(system, seed, tolerance, limit, np.nan_to_num(centre), scale, method)


def grid(system: System) -> np.ndarray:
    """Times of the bands, s."""
    return np.linspace(0.0, system.settings.duration, system.varied.points + 1)


def _signals(run: Run, t: np.ndarray) -> np.ndarray:
    """e_1, the states and u of a run; NaN after its end."""
    n = run.system.plant.n
    inside = t <= run.trajectory.end
    found = np.full((n + 2, len(t)), np.nan)
    states = run.trajectory.interpolate(t[inside])
    found[1 : n + 1, inside] = states[:n]
    found[0, inside] = states[0] - run.system.reference.values(t[inside], 0)[0]
    found[n + 1, inside] = run.input_of(t[inside], states)
    return found


class Engine:
    """A plan, compiled.

    Parameters
    ----------
    plan : Plan
    threads : int
        Cores to use.
    """

    def __init__(self, plan: Plan, threads: int = 1) -> None:
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
        self._flow = make_flow(self._members, varying)
        if plan.method == "native":
            self._native = Native(self._flow, shown(self._flow))
        else:
            self._lockstep = Lockstep(self._flow, plan.tolerance, parallel=threads > 1)

    def compute(self, begin: int, end: int) -> Statistics:
        """Statistics of the members begin ... end-1."""
        bands = Bands(self.plan.centre, self.plan.scale)
        metrics, outcomes = self._piece(begin, end, bands)
        statistics = self.plan.empty(bands)
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
        """Plant states at the end of the run, shape (n, N); compiled C only."""
        passed, part = self._pass(begin, end, Bands(self.plan.centre, self.plan.scale))
        found: np.ndarray = passed.finals[: self._flow.watched, part]
        return np.where(passed.ends[part] < self._edges[-1], np.nan, found)

    def _piece(self, begin: int, end: int, bands: Bands) -> tuple[np.ndarray, np.ndarray]:
        """Metrics and outcomes of the members begin ... end-1; their signals go to the bands."""
        count = end - begin
        metrics = np.full((len(METRICS), count), np.nan)
        outcomes = np.full(count, Outcome.finished.name, dtype=object)
        ends = np.full(count, -1.0)
        alone = np.ones(count, dtype=bool)
        if self.plan.method != "alone":
            together = self._in_threads if self.plan.method == "native" else self._in_step
            metrics, ends, alone = together(begin, end, bands)
            if (early := ends < self._edges[-1]).any():
                outcomes[early & ~alone] = Outcome.escaped.name
                metrics[:, early] = np.nan
        for i in np.flatnonzero(alone).tolist():
            run = simulate(self._members.member(begin + i))
            outcomes[i] = run.outcome.name
            if run.outcome is Outcome.finished:
                metrics[:, i] = [getattr(run.metrics, name) for name in METRICS]
            self._show_alone(run, float(ends[i]), bands)
        return metrics, outcomes

    def _show_alone(self, run: Run, after: float, bands: Bands) -> None:
        """Count a run of its own where the lockstep did not."""
        late = np.flatnonzero(self._grid > after)
        signals = _signals(run, self._grid[late])
        for signal, values in enumerate(signals):
            for k, value in zip(late.tolist(), values, strict=True):
                bands.observe(signal, k, np.array([value]))

    def _table(self, begin: int, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Starts and parameters of some members."""
        starts, table = self._members.table(begin, end)
        band = np.full(end - begin, self._band)
        amplitude = table.get(AMPLITUDE)
        if self.plan.system.settings.band is None and amplitude is not None:
            band *= np.abs(amplitude)
        table[BAND] = band
        return starts, np.array([table[name] for name in self._flow.parameters])

    def _in_threads(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Metrics, last times, and who must be run alone."""
        first, last = begin // PIECE, -(-end // PIECE)
        count = min(self._threads, last - first)
        cuts = [PIECE * (first + (last - first) * i // count) for i in range(count + 1)]
        shares = [(max(a, begin), min(b, end), bands) for a, b in pairwise(cuts)]
        with ThreadPoolExecutor(count) as pool:
            found = pool.map(self._in_lanes, *zip(*shares, strict=True))
        metrics, ends, alone = zip(*found, strict=True)
        return np.concatenate(metrics, axis=1), np.concatenate(ends), np.concatenate(alone)

    def _in_lanes(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, by one thread."""
        passed, part = self._pass(begin, end, bands)
        totals = dict(zip((*SUMS, *MEMORIES), passed.totals[:, part], strict=True))
        return self._metrics(totals), passed.ends[part], passed.outcomes[part] == STUCK

    def _pass(self, begin: int, end: int, bands: Bands) -> tuple[Passed, slice]:
        """Members share their steps in groups, always the same ones: whole groups are computed.

        Counts the members begin ... end-1, and says where they are among the computed.
        """
        plan, first = self.plan, begin - begin % GROUP
        starts, parameters = self._table(first, -(-end // GROUP) * GROUP)
        timeline = Timeline(self._edges, self._shared, self._grid, plan.centre, plan.unit)
        part = slice(begin - first, end - first)
        control = Control(plan.tolerance, plan.system.settings.max_state, MOST_STEPS)
        counted = Counted(part, SIDE, BAND_BITS, bands.counts)
        return self._native.integrate(starts, parameters, timeline, control, counted), part

    def _in_step(
        self, begin: int, end: int, bands: Bands
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, by the lockstep method."""
        lockstep, rows = self._lockstep, self._lockstep.rows
        starts, parameters = self._table(begin, end)
        times = np.union1d(self._grid, self._edges)
        places = {int(np.searchsorted(times, t)): k for k, t in enumerate(self._grid)}
        restarts = frozenset(np.searchsorted(times, self._edges[1:-1]).tolist())
        first = rows["signals"].start
        e, u = first + SIGNALS.index("e"), first + SIGNALS.index("u")
        last: dict[str, np.ndarray] = {}

        def look(k: int, row: Callable[[int], np.ndarray]) -> None:
            if k in places:
                for signal, index in enumerate([e, *range(self._flow.watched), u]):
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
            "rms_error": np.sqrt(totals["integral_squared_error"] / duration),
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
