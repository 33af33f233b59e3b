"""What every method of computing members is given: the members, their times, their metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.integrators.base import MethodUnavailable
from certrack.loops.bursts import scan
from certrack.loops.schedule import make_schedule
from certrack.loops.time_switches import TimeSwitches
from certrack.simulation.metrics import settling_band
from certrack.studies.ensembles.members import AMPLITUDE, members_of
from certrack.studies.ensembles.metric_formulas import SETTLING_BAND
from certrack.studies.ensembles.plan import METRICS, band_times
from certrack.systems.system import System

#: Members whose formulas of time are scanned for bursts.
SCANNED_MEMBERS = 4

#: Steps are no longer than so many cells of a burst, each of which a polynomial of degree 7 fits;
#: and if that makes more of them than this, members are run alone.
CELLS_PER_STEP, MAX_EVENT_STEPS = 8, 5_000

#: Two times closer than this part of them are one: rounding may have separated them.
TIME_ROUNDING = 1e-12


@dataclass(frozen=True)
class Segments:
    """Where rates, signals or what is totalled may jump.

    Attributes
    ----------
    edges : (K+1,) array, s
        Begins of the segments, and the end of the run.
    shared : (K, H) array
        On each, whether it lies in the tail, the reference's piece, and the switches of time.
    """

    edges: np.ndarray
    shared: np.ndarray

    def at(self, time: float) -> np.ndarray:
        """Values on the segment that begins at or contains `time`."""
        k = int(np.searchsorted(self.edges, time * (1 + TIME_ROUNDING), side="right")) - 1
        values: np.ndarray = self.shared[min(k, len(self.shared) - 1)]
        return values


class EnsembleProblem:
    """All members of a system's population, and what their metrics refer to.

    Parameters
    ----------
    system : System
    seed : int
    tolerance : float
        Tolerance of the integrators.

    Attributes
    ----------
    members : Members
    times : (T,) array, s
        Times of the bands.
    """

    def __init__(self, system: System, seed: int, tolerance: float) -> None:
        self.system, self.tolerance = system, tolerance
        self.members = members_of(system, seed)
        self.times = band_times(system)
        self._settling_band = settling_band(system.settings, system.reference)

    @property
    def end(self) -> float:
        """Time at which a run ends, s."""
        return self.system.settings.duration

    def segments(
        self, switches: TimeSwitches, numbers: Mapping[sympy.Symbol, float] | None = None
    ) -> Segments:
        """Segments of a loop with its switches of time; numbers that are not put in have values."""
        settings = self.system.settings
        schedule = make_schedule(
            self.system.reference, switches, numbers or {}, settings.duration, self.tolerance
        )
        breaks = schedule.breaks(0.0, settings.duration)
        ends = self._ends_at_events(switches, numbers or {})
        breaks = np.union1d(breaks, ends) if len(ends) else breaks
        breaks = breaks[np.abs(breaks - settings.tail_start) > schedule.blur]
        edges = np.unique([0.0, settings.tail_start, settings.duration, *breaks])
        shared = [
            [float(time >= settings.tail_start), *schedule.piece_values(time)]
            for time in edges[:-1].tolist()
        ]
        return Segments(edges, np.array(shared))

    def refuse_own_times(self, switches: TimeSwitches) -> None:
        """Refuse to compute members side by side that each switch at times of their own.

        Raises
        ------
        MethodUnavailable
        """
        if switches.of_members:
            raise MethodUnavailable(
                "members switch at times of their own (a formula of t and of drawn numbers under "
                "abs, sign, min or max), so each is run alone"
            )

    def _ends_at_events(
        self, switches: TimeSwitches, numbers: Mapping[sympy.Symbol, float]
    ) -> np.ndarray:
        """Times at which steps end so that they see short events of times that members draw.

        They are as dense as the shortest events of a few members ask for, all over the run.

        Raises
        ------
        MethodUnavailable
            If they would be too many.
        """
        nodes, shortest = np.array([0.0, self.end]), self.end
        _, drawn = self.members.table(0, SCANNED_MEMBERS)
        for formula in switches.formulas_of_members:
            for k in range(SCANNED_MEMBERS):
                known = {**numbers, **{s: float(v[k]) for s, v in drawn.items()}}
                known = {s: known[s] for s in formula.free_symbols - {TIME}}
                events = scan(formula, nodes, known, {}, self.tolerance)
                if len(events.marks):
                    shortest = min(shortest, events.shortest)
        count = math.ceil(self.end / (CELLS_PER_STEP * shortest))
        if count > MAX_EVENT_STEPS:
            raise MethodUnavailable(
                "members have very short events at times of their own (a formula of t and of "
                "drawn numbers), so each is run alone"
            )
        return np.linspace(0.0, self.end, count + 1)[1:-1]

    @property
    def varying(self) -> dict[sympy.Symbol, np.ndarray]:
        """The parameters that differ between members, with the first member's values."""
        _, table = self.members.table(0, 1)
        return table

    def starts_and_parameters(
        self, begin: int, end: int
    ) -> tuple[np.ndarray, dict[sympy.Symbol, np.ndarray]]:
        """Starts (S, N) of the members begin ... end-1, and what varies between them, by symbol."""
        starts, table = self.members.table(begin, end)
        band = np.full(end - begin, self._settling_band)
        amplitude = table.get(AMPLITUDE)
        if self.system.settings.band is None and amplitude is not None:
            band *= np.abs(amplitude)
        table[SETTLING_BAND] = band
        return starts, table

    def metrics(self, totals: dict[str, np.ndarray]) -> np.ndarray:
        """Metrics from what the integrators total, in the order of METRICS."""
        duration, outside = self.system.settings.duration, totals["last_outside"]
        never = outside >= duration * (1 - TIME_ROUNDING)
        mean_square = np.maximum(totals["integral_squared_error"], 0.0) / duration
        columns = totals | {
            "settling_time": np.where(never, np.nan, outside),
            "rms_error": np.sqrt(mean_square),
        }
        return np.array([columns[name] for name in METRICS])


def is_clearly_after(time: float | np.ndarray, end: float | np.ndarray) -> np.ndarray:
    """Whether a time lies after an event that rounding may have moved."""
    return np.asarray(time > np.asarray(end) * (1 + TIME_ROUNDING))
