"""The adversarial closed loop: compiled once, every number of the adversary a parameter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certrack.laws.leakage import leak_matrix
from certrack.loops.continuous import close_loop
from certrack.studies.falsifier.adversary import Adversary
from certrack.studies.falsifier.draft import ParameterTable, SystemDraft
from certrack.studies.falsifier.side_by_side import batch_of
from certrack.systems.system import System

#: Tolerance of the integrator: the replay has the usual one.
HUNT_TOLERANCE = 1e-7

#: Times after the transient at which |e_1| is looked at.
TAIL_POINTS = 600

#: Score of a run that escapes: above the error of any that does not.
ESCAPE_SCORE = 1e3

#: Length of the transient, in time constants of the slowest mode: e^-25 is left of the start.
TRANSIENT_TIME_CONSTANTS = 25.0

#: Transients longer than this are cut, s.
MAX_TRANSIENT = 500.0

#: Length of the tail after it, in time constants of the slowest mode, but at least and at most so
#: many s: 12 s hold two periods of a pattern of 1 rad/s, more than 100 s would cost too much.
TAIL_TIME_CONSTANTS, MIN_TAIL, MAX_TAIL = 4.0, 12.0, 100.0

#: Slower modes count as this slow, 1/s: their transient is cut anyhow.
SLOWEST_RATE = 1e-9


class AdversarialLoop:
    """A system against its adversary.

    Parameters
    ----------
    system : System
        Without an implementation.

    Attributes
    ----------
    adversary : Adversary
    """

    def __init__(self, system: System) -> None:
        self.adversary = Adversary.against(system)
        slowest = slowest_time_constant(system)
        transient = min(MAX_TRANSIENT, TRANSIENT_TIME_CONSTANTS * slowest)
        tail = min(MAX_TAIL, max(TAIL_TIME_CONSTANTS * slowest, MIN_TAIL))
        duration = transient + tail
        self._system = system
        self._settings = replace(
            system.settings, duration=duration, tail=transient, integrator="auto"
        )
        self._times = np.concatenate([[0.0], np.linspace(transient, duration, TAIL_POINTS)])
        middle = np.array([v.middle for v in self.adversary.variables])
        self._template = self._with(middle, named=True)
        self._loop = close_loop(self._template)
        self._integrator = batch_of(self._loop, HUNT_TOLERANCE)

    def case(self, point: np.ndarray) -> System:
        """The system against the adversary with these numbers, written out."""
        return self._with(point, named=False)

    def _with(self, point: np.ndarray, *, named: bool) -> System:
        draft, values = SystemDraft(self._system), point.tolist()
        for part, where in self.adversary.slices():
            part.write_system(values[where], draft, named=named)
        return draft.finish(self._settings)

    def errors(self, points: np.ndarray) -> np.ndarray:
        """Largest |e_1| after the transient of every member; points (G, N)."""
        count = points.shape[1]
        table = ParameterTable(self._loop, self._template, count)
        for part, where in self.adversary.slices():
            part.write_parameters(points[where], table)
        shape = self.adversary.reference
        waves = shape.waves(points[: len(shape.variables)])
        start = np.array([*self._template.start, 0.0, 0.0, 0.0])  # the integrals begin at zero
        worst = np.zeros(count)

        def observe(states: np.ndarray, escaped: np.ndarray, members: slice) -> None:
            y_d = shape.reference(waves[:, members], self._times[1:])
            error = np.abs(states[1:, 0] - y_d)
            seen = np.nan_to_num(error, nan=0.0).max(axis=0)  # a run cut short shows what it has
            worst[members] = np.where(escaped, ESCAPE_SCORE, seen)

        starts = np.repeat(start[:, None], count, axis=1)
        self._integrator.over_time(starts, table.values, self._times, observe)
        return worst


def slowest_time_constant(system: System) -> float:
    """Slowest time constant of the error and of the estimates' leaks, s."""
    controller = system.controller
    rates = [-controller.coordinates.poles.real.max()]
    leaks = -np.linalg.eigvals(leak_matrix(controller)).real
    return 1.0 / max(SLOWEST_RATE, float(min([*rates, *leaks[leaks > 0]])))
