"""Quantities of a nonlinear loop, by simulation: the peak input from a corner, and the energy."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.laws.base import Law
from certrack.model.implementation import Implementation
from certrack.simulation.metrics import Metrics
from certrack.simulation.simulator import Simulator
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.quantities import Quantity, logarithm

#: Tolerance of runs in a search, and the step of their differences in logarithms of gains: well
#: above what that tolerance leaves.
RUN_TOLERANCE, RUN_DIFFERENCE = 1e-8, 1e-3

#: In a search the input's peak is looked for in this part of the run: it is in the transient.
TRANSIENT_PART = 0.25

#: Corners of the box that a search looks at: those with the largest peaks at its start.
MOST_CORNERS = 4

#: Corners of a box that are run at all; of one with more, every so-many-th.
ALL_CORNERS = 256


def corners(box: np.ndarray) -> np.ndarray:
    """Corners of a box, (count, n)."""
    points = np.array(list(product(*(sorted({float(a), float(b)}) for a, b in box))))
    return points[:: math.ceil(len(points) / ALL_CORNERS)]


class CompiledRuns:
    """Runs of the continuous loop for any gains, compiled once; kept by law and start."""

    def __init__(self, system: System) -> None:
        self._simulator = Simulator(system)
        self._metrics: dict[tuple[Law, tuple[float, ...], float], Metrics | None] = {}

    def metrics(
        self, candidate: Candidate, x0: tuple[float, ...], duration: float, tail: float
    ) -> Metrics | None:
        """Of one run; None if it did not finish."""
        key = candidate.law, x0, duration
        if key not in self._metrics:
            base = candidate.base
            settings = replace(
                base.settings, x0=x0, duration=duration, tail=tail, tolerance=RUN_TOLERANCE
            )
            run = self._simulator.run(base.replace(law=candidate.law, settings=settings))
            finished = run.outcome is Outcome.finished
            self._metrics[key] = run.metrics if finished else None
        return self._metrics[key]


class RunQuantity(Quantity):
    """A metric of a run; its gradient is by wider differences, on one side."""

    def __init__(self, runs: CompiledRuns, x0: tuple[float, ...], duration: float) -> None:
        self._runs, self._x0, self._duration = runs, x0, duration

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        here = logarithm(self.value(candidate))
        gradient = np.zeros(len(candidate.v))
        gains = len(candidate.v) - candidate.family.has_share
        for i in range(gains):
            v = candidate.v.copy()
            v[i] += RUN_DIFFERENCE
            moved = Candidate(candidate.family, candidate.base, v)
            gradient[i] = (logarithm(self.value(moved)) - here) / RUN_DIFFERENCE
        return gradient

    def _metrics(self, candidate: Candidate) -> Metrics | None:
        return self._runs.metrics(candidate, self._x0, self._duration, 0.0)


class CornerPeak(RunQuantity):
    """The largest |u| from one start."""

    name = "peak input"

    def value(self, candidate: Candidate) -> float:
        metrics = self._metrics(candidate)
        return math.inf if metrics is None else metrics.peak_input


class RunEnergy(RunQuantity):
    """Integral of u^2 from the file's start."""

    name = "energy"

    def value(self, candidate: Candidate) -> float:
        metrics = self._metrics(candidate)
        return math.inf if metrics is None else metrics.input_energy


class Held:
    """Whether the loop still works when its input is held: by simulation at one period.

    It must finish, with an error in the tail of at most :data:`WORSE` times that of the continuous
    loop. There is no exact edge for a nonlinear loop.
    """

    def __init__(self, system: System, implementation: Implementation) -> None:
        self._base, self._implementation = system, implementation
        self._runs = CompiledRuns(system)
        self._simulator: Simulator | None = None

    def holds(self, candidate: Candidate) -> bool:
        """Whether it does, from the file's start."""
        settings = candidate.base.settings
        duration, tail = settings.duration, settings.tail_start
        longest = HELD_SAMPLES * self._implementation.period
        if duration > longest:
            duration, tail = longest, longest / 2
        plain = self._runs.metrics(candidate, settings.x0, duration, tail)
        if plain is None:
            return False
        settings = replace(settings, duration=duration, tail=tail)
        try:
            held = self._base.replace(
                law=candidate.law, settings=settings, implementation=self._implementation
            )
        except InputError:
            return False  # its estimates forget too fast for this period
        if self._simulator is None:
            self._simulator = Simulator(held)
        run = self._simulator.run(held)
        finished = run.outcome is Outcome.finished
        return finished and run.metrics.tail_error <= WORSE * plain.tail_error


#: How much larger the tail error of the held loop may be, and so many samples of it are run.
WORSE, HELD_SAMPLES = 2.0, 20_000
