"""The adversarial closed loop: compiled once, every number of the adversary a parameter."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.lowering import NumpyFunction, numpy_callable
from certrack.integrators.base import MemberOutcome, MethodUnavailable
from certrack.integrators.many.numpy_batch import NumpyBatch
from certrack.integrators.many.taylor_batch import TaylorBatch
from certrack.laws.leakage import leak_matrix
from certrack.loops.continuous import close_loop
from certrack.studies.falsifier.adversary import Adversary
from certrack.studies.falsifier.draft import ParameterTable, SystemDraft
from certrack.studies.falsifier.lanes import WORTH_LANES, AdversaryLanes
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
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
    runs : int
        How many are expected.
    output : SoughtOutput
        What is made large.

    Attributes
    ----------
    adversary : Adversary
    """

    def __init__(self, system: System, runs: int = 1, output: SoughtOutput = ERROR) -> None:
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
        self._output, self._signal = output, output.formula(self._loop)
        self._tail = (transient, duration)
        self._lanes = None if runs < WORTH_LANES else self._compiled(middle)
        if self._lanes is None:
            _ = self._integrator  # which refuses a loop that is not smooth

    @cached_property
    def _integrator(self) -> TaylorBatch | NumpyBatch:
        return batch_of(self._loop, HUNT_TOLERANCE)

    def _compiled(self, point: np.ndarray) -> AdversaryLanes | None:
        """The loop in C; None where that cannot be."""
        table, max_state = self._table(point[:, None]), self._settings.max_state
        try:
            return AdversaryLanes(
                self._loop, table.values[:, 0], table.written, max_state, self._signal
            )
        except MethodUnavailable:
            return None

    def _table(self, points: np.ndarray) -> ParameterTable:
        """The parameters of every point."""
        table = ParameterTable(self._loop, self._template, points.shape[1])
        for part, where in self.adversary.slices():
            part.write_parameters(points[where], table)
        return table

    def case(self, point: np.ndarray) -> System:
        """The system against the adversary with these numbers, written out."""
        return self._with(point, named=False)

    def named_case(self, point: np.ndarray) -> System:
        """The same with the numbers as constants: all such cases have the formulas of one loop."""
        return self._with(point, named=True)

    def _with(self, point: np.ndarray, *, named: bool) -> System:
        draft, values = SystemDraft(self._system), point.tolist()
        for part, where in self.adversary.slices():
            part.write_system(values[where], draft, named=named)
        return draft.finish(self._settings)

    def errors(self, points: np.ndarray) -> np.ndarray:
        """Largest |e_1|, or output, after the transient of every member; points (G, N)."""
        parameters = self._table(points).values
        count = points.shape[1]
        if self._lanes is None:
            return self._errors_on_grid(points, parameters)
        starts = np.repeat(np.array(self._template.start)[:, None], count, axis=1)
        worst, outcomes = self._lanes.tail_errors(starts, parameters, *self._tail)
        worst[outcomes == MemberOutcome.escaped] = ESCAPE_SCORE
        alone = np.flatnonzero(outcomes == MemberOutcome.run_alone)
        if alone.size:
            worst[alone] = self._errors_on_grid(points[:, alone], parameters[:, alone])
        return worst

    def _errors_on_grid(self, points: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """The same by an integrator that needs no compiler, at :data:`TAIL_POINTS` times."""
        count, shape = points.shape[1], self.adversary.reference
        waves = shape.waves(points[: len(shape.variables)])
        start = np.array([*self._template.start, 0.0, 0.0, 0.0])  # the integrals begin at zero
        worst = np.zeros(count)

        def observe(states: np.ndarray, escaped: np.ndarray, members: slice) -> None:
            if self._output == ERROR:
                y_d = shape.reference(waves[:, members], self._times[1:])
                output = states[1:, 0] - y_d
            else:
                output = self._outputs(states[1:], parameters[:, members])
            # a run cut short shows what it has
            seen = np.nan_to_num(np.abs(output), nan=0.0).max(axis=0)
            worst[members] = np.where(escaped, ESCAPE_SCORE, seen)

        starts = np.repeat(start[:, None], count, axis=1)
        self._integrator.over_time(starts, parameters, self._times, observe)
        return worst

    def _outputs(self, states: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """The output (T, N) along states (T, S, N)."""
        times, count = self._times[1:, None], states.shape[2]
        with np.errstate(all="ignore"):
            (output,) = self._formula(times, list(states.swapaxes(0, 1)), list(parameters))
        return np.broadcast_to(output, (len(times), count))

    @cached_property
    def _formula(self) -> NumpyFunction:
        arguments = [TIME, self._loop.states, self._loop.parameters]
        return numpy_callable(arguments, [self._signal])


def slowest_time_constant(system: System) -> float:
    """Slowest time constant of the error and of the estimates' leaks, s."""
    controller = system.controller
    rates = [-controller.coordinates.poles.real.max()]
    leaks = -np.linalg.eigvals(leak_matrix(controller)).real
    return 1.0 / max(SLOWEST_RATE, float(min([*rates, *leaks[leaks > 0]])))
