"""What runs tell of one law with one set of gains: figures, and whether they keep the limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.core.errors import CertrackError, MissingExtra
from certrack.integrators.base import Outcome
from certrack.laws.base import Law
from certrack.loops.plant import measured
from certrack.model.implementation import Implementation
from certrack.simulation.metrics import REFERENCE_POINTS, Metrics
from certrack.simulation.simulator import Simulator
from certrack.systems.system import System
from certrack.tuning.runs import TRANSIENT_PART, WORSE, corners

#: Name of the limit of the largest |u|.
PEAK = "peak input"

#: Smaller numbers have no logarithm of interest.
LEAST_LOGGED = 1e-300

#: A search looks at so many corners of the box, those with the largest inputs.
SEARCHED_CORNERS = 4


@dataclass(frozen=True)
class SharedLimits:
    """What every law of a comparison must keep.

    Attributes
    ----------
    peak_input : float
        Of |u| over the box of starts, or from the file's start.
    input_variation : float
        Of the file's run, with the noise of its sensors.
    period : float, s
        Held so long the law must still work: with at most :data:`WORSE` times the tail error.
    """

    peak_input: float
    input_variation: float
    period: float


class Trials:
    """Runs of one law as sampled, compiled once, for any gains.

    Parameters
    ----------
    system : System
        With an implementation, and the law of any gains.
    box : (n, 2) array, optional
    """

    def __init__(self, system: System, box: np.ndarray | None) -> None:
        assert system.implementation is not None
        self.system, self.runs = system, 0
        self._simulators: dict[float, Simulator] = {}
        starts = [] if box is None else [tuple(map(float, corner)) for corner in corners(box)]
        self.starts: list[tuple[float, ...]] = starts

    def metrics(self, law: Law, period: float | None = None, **settings: Any) -> Metrics | None:
        """Of one run; None if it did not finish, or such a law does not exist."""
        drive = self.system.implementation
        assert drive is not None
        period = drive.period if period is None else period
        try:
            system = self.system.replace(law=law, implementation=replace(drive, period=period))
            return self._run(system.with_settings(**settings), period)
        except MissingExtra:
            raise  # nothing of the gains
        except CertrackError:
            return None  # a design that does not exist, or estimates that forget too fast

    def with_gain(self, law: Law, factor: float) -> Metrics | None:
        """Of the run where the true input gain is so many times as large."""
        truth, drive = self.system.truth, self.system.implementation
        if truth.input_gain is None or drive is None:
            return None
        changed: dict[str, Any] = {"input_gain": f"({truth.input_gain.text})*{factor:g}"}
        try:
            system = self.system.replace(law=law, truth=replace(truth, **changed))
        except CertrackError:
            return None
        return self._run(system, drive.period)

    def _run(self, system: System, period: float) -> Metrics | None:
        if period not in self._simulators:
            self._simulators[period] = Simulator(system)
        self.runs += 1
        run = self._simulators[period].run(system)
        return run.metrics if run.outcome is Outcome.finished else None

    def peak(self, law: Law, most: int | None = None) -> float:
        """The largest |u| from the corners of the box, the first `most` of them; inf if lost."""
        duration = TRANSIENT_PART * self.system.settings.duration
        largest = 0.0
        for start in self.starts[:most]:
            metrics = self.metrics(law, x0=start, duration=duration)
            if metrics is None:
                return math.inf
            largest = max(largest, metrics.peak_input)
        return largest

    def order_starts(self, law: Law) -> None:
        """The corners with the largest inputs of this law come first."""
        duration = TRANSIENT_PART * self.system.settings.duration

        def size(start: tuple[float, ...]) -> float:
            metrics = self.metrics(law, x0=start, duration=duration)
            return math.inf if metrics is None else metrics.peak_input

        self.starts.sort(key=lambda start: -size(start))


def resting_error(system: System) -> float:
    """The largest error of an output that stays at zero; of y_d = 0, one that stays at y(0)."""
    times = np.linspace(0.0, system.settings.duration, REFERENCE_POINTS)
    begin = measured(system, np.array(system.settings.x0)[:, None])[0, 0]
    largest = np.abs(system.reference.values(times, 0)[0]).max()
    return float(largest or abs(begin) or math.inf)


#: What a run that is lost counts, as a logarithm, and one that finishes and does not follow; the
#: slope by which a limit is felt, and the logarithm from which it is felt no more.
LOST_SCORE, ASTRAY_SCORE, PENALTY, LARGEST_EXCESS = 500.0, 200.0, 20.0, 4.0


@dataclass(frozen=True)
class Score:
    """How good one set of gains is.

    Attributes
    ----------
    value : float
        To be made small: the logarithm of the tail error, and what the limits add.
    exceeded : tuple of str
        Limits that are not kept.
    works : bool
        Whether all runs finish, and the error is smaller than that of an output that stays.
    """

    value: float
    exceeded: tuple[str, ...]
    works: bool


def score(trials: Trials, law: Law, limits: SharedLimits, resting: float) -> Score:
    """The score of one law; `resting` is the error of an output that stays at zero."""
    metrics = trials.metrics(law)
    if metrics is None or not math.isfinite(metrics.tail_error):
        return Score(LOST_SCORE, (), works=False)
    tail = metrics.tail_error
    peak = max(metrics.peak_input, trials.peak(law, SEARCHED_CORNERS))
    held = trials.metrics(law, limits.period)
    held_tail = math.inf if held is None else held.tail_error
    excesses = {
        PEAK: _excess(peak, limits.peak_input),
        "variation of input": _excess(metrics.input_variation, limits.input_variation),
        "period": _excess(held_tail, WORSE * tail),
    }
    exceeded = tuple(name for name, excess in excesses.items() if excess > 0)
    works = tail < resting and math.isfinite(peak)
    value = math.log(max(tail, LEAST_LOGGED)) + PENALTY * sum(
        max(0.0, v) for v in excesses.values()
    )
    return Score(value + (0.0 if works else ASTRAY_SCORE), exceeded, works)


def _excess(value: float, limit: float) -> float:
    """By how much a limit is exceeded, as a logarithm, at most a few."""
    if not math.isfinite(value):
        return LARGEST_EXCESS
    return min(LARGEST_EXCESS, math.log(max(value, LEAST_LOGGED) / limit))


def sampled(system: System, period: float) -> System:
    """The system as the file samples it, or with this period where it says nothing."""
    if system.implementation is not None:
        return system
    return system.replace(implementation=Implementation(period))
