"""Adaptive Taylor method (heyoka): compiled once per closed loop, reused for every run.

A step is never taken across a break of the reference (it stops and takes the next piece) or across
a kink of the state (an event stops it and flips the switch, see :mod:`certrack.lowering`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.closed_loop import ClosedLoop
from certrack.expressions import TIME
from certrack.integrators.base import Outcome, Problem, Trajectory
from certrack.lowering import extract_switches, numpy_callable, to_heyoka


def available() -> bool:
    """Whether heyoka is installed (it has no wheels for macOS and Windows)."""
    from importlib.util import find_spec

    return find_spec("heyoka") is not None


class TaylorIntegrator:
    """A compiled closed loop. Not for two threads at once: make one per thread.

    Parameters
    ----------
    loop : ClosedLoop
    tolerance : float
        Fixes the order of the method, hence part of the compilation.
    """

    def __init__(self, loop: ClosedLoop, tolerance: float) -> None:
        import heyoka as hy

        rates, switches = extract_switches(loop.rates)
        symbols = [*loop.parameters, *(symbol for symbol, _ in switches)]
        known = {symbol: hy.par[i] for i, symbol in enumerate(symbols)}
        variables = hy.make_vars(*(state.name for state in loop.states))
        variables = [variables] if len(loop.states) == 1 else list(variables)
        known |= dict(zip(loop.states, variables, strict=True))
        self._first_switch = len(loop.parameters)
        if switches:
            arguments = [TIME, loop.states, symbols]
            self._kinks = numpy_callable(arguments, [inside for _, inside in switches])
            self._rates = numpy_callable(arguments, rates)
        events = [
            hy.t_event(inside, callback=_Flip(self._first_switch + k))
            for k, inside in enumerate(to_heyoka([f for _, f in switches], known))
        ]
        self._switches = len(switches)
        self._integrator = hy.taylor_adaptive(
            list(zip(variables, to_heyoka(rates, known), strict=True)),
            [0.0] * len(variables),
            tol=tolerance,
            pars=[0.0] * len(symbols),
            t_events=events,
        )
        self._clamped, self._failed = hy.taylor_outcome.time_limit, hy.taylor_outcome.err_nf_state

    def integrate(self, problem: Problem) -> Trajectory:
        """Solve `problem`; stops early at an escape, an undefined rate or the step limit."""
        ta = self._integrator
        state, pars = ta.state, ta.pars
        state[:] = problem.start
        count = len(problem.parameters)
        pars[:count] = problem.parameters
        starts: list[float] = []
        coefficients: list[np.ndarray] = []
        end, outcome = 0.0, Outcome.finished
        for begin, stop in problem.segments:
            pars[count : self._first_switch] = problem.reference.piece_values(begin)
            ta.time = begin
            self._set_switches(skip=None)
            end, outcome = self._segment(stop, problem, starts, coefficients)
            if outcome is not Outcome.finished:
                break
        table = np.array(coefficients) if coefficients else problem.start[None, :, None]
        dense = TaylorSeries(np.array(starts or [0.0]), table)
        return Trajectory(np.array([*starts, end]), dense, outcome, "taylor")

    def _segment(
        self, stop: float, problem: Problem, starts: list[float], coefficients: list[np.ndarray]
    ) -> tuple[float, Outcome]:
        """Step to `stop`; append the Taylor coefficients of every step."""
        ta, state, n = self._integrator, self._integrator.state, problem.plant_order
        step, clamped, failed, limit = ta.step, self._clamped, self._failed, problem.max_state
        while True:
            begin = ta.time
            outcome, _ = step(max_delta_t=stop - begin, write_tc=True)
            if outcome == failed:
                escaping = starts and np.abs(coefficients[-1][:n, 0]).max() > 1e3
                return begin, Outcome.escaped if escaping else Outcome.undefined
            starts.append(begin)
            coefficients.append(ta.tc.copy())
            if max(map(abs, state[:n].tolist())) > limit:
                return ta.time, Outcome.escaped
            if outcome == clamped:
                return stop, Outcome.finished
            if len(starts) >= problem.max_steps:
                return ta.time, Outcome.step_limit
            if self._switches and int(outcome) >= 0:
                self._set_switches(skip=int(outcome))

    def _set_switches(self, skip: int | None) -> None:
        """Set every switch to the sign of its function; one that was just flipped stays."""
        ta = self._integrator
        for k in range(self._switches if skip is None else 0):
            ta.pars[self._first_switch + k] = 1.0
        for _ in range(self._switches):  # later functions may contain earlier switches
            values = self._kinks(ta.time, ta.state, ta.pars)
            for k, value in enumerate(values):
                if k != skip and value != 0:
                    ta.pars[self._first_switch + k] = 1.0 if value > 0 else -1.0
                elif k != skip and skip is None:
                    ta.pars[self._first_switch + k] = self._departing_sign(k)

    def _departing_sign(self, k: int) -> float:
        """Sign that function k, now zero, takes a moment later."""
        ta, moment = self._integrator, 1e-6
        rates = np.array(self._rates(ta.time, ta.state, ta.pars), dtype=float)
        value = self._kinks(ta.time + moment, ta.state + moment * rates, ta.pars)[k]
        return -1.0 if value < 0 else 1.0


class _Flip:
    """Event callback: set a switch to the direction in which its function crossed zero."""

    def __init__(self, index: int) -> None:
        self.index = index

    def __call__(self, integrator: Any, direction: int) -> bool:
        if direction:
            integrator.pars[self.index] = float(direction)
        return True

    def __copy__(self) -> _Flip:
        return _Flip(self.index)

    def __deepcopy__(self, memo: object) -> _Flip:
        return _Flip(self.index)


@dataclass(frozen=True)
class TaylorSeries:
    """Piecewise Taylor series: the dense output of the method, at no extra cost.

    Attributes
    ----------
    starts : (K,) array, s
        Beginning of each step.
    table : (K, S, order + 1) array
        Taylor coefficients of the states.
    """

    starts: np.ndarray
    table: np.ndarray

    def __call__(self, t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        k = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, None)
        since = (t - self.starts[k])[:, None]
        value = self.table[k, :, -1]
        for order in range(self.table.shape[2] - 2, -1, -1):
            value = value * since + self.table[k, :, order]
        return value.T

    def subdivided(self, times: np.ndarray, parts: int) -> np.ndarray:
        """States at :func:`certrack.integrators.base.subdivide` of the steps, much faster."""
        fractions = np.diff(times)[:, None] * (np.arange(parts + 1) / parts)
        powers = fractions[:, None, :] ** np.arange(self.table.shape[2])[:, None]
        values = np.matmul(self.table, powers)  # (K, S, parts + 1)
        inner = values[:, :, :-1].transpose(1, 0, 2).reshape(self.table.shape[1], -1)
        return np.concatenate([inner, values[-1, :, -1:]], axis=1)
