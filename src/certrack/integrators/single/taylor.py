"""Adaptive Taylor method (heyoka): compiled once per closed loop, reused for every run.

A step is never taken across a break of the reference (it stops and takes the next piece) or across
a kink of the state (an event stops it and flips the switch, see :mod:`certrack.core.lowering`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certrack.core.heyoka import quiet_heyoka
from certrack.core.lowering import extract_switches, to_heyoka
from certrack.integrators.base import (
    ESCAPING,
    Outcome,
    Problem,
    Trajectory,
    fractions,
    parts_of,
)
from certrack.integrators.single.switches import Switches
from certrack.loops.continuous import INTEGRALS, ClosedLoop

#: With careful steps, which are many, a run is not followed beyond states of this size.
MAX_CAREFUL_STATE = 1e9

#: More steps in a row that do not move time are the brink of a finite escape and end a run; an
#: event may cut a few that short.
MAX_STALLED_STEPS = 50

#: More steps of no length in a row: the run rests on a kink, whose event fires for ever.
MAX_EMPTY_STEPS = 3

#: Length of the step by the Taylor series that leaves such a kink, s.
LEAVING_STEP = 1e-6

#: Room for so many more steps at least when a record is full.
ROOM_AT_LEAST = 256

#: Steps whose samples are computed at once: the intermediate results stay small.
STEPS_AT_ONCE = 8192

#: Times at which the series are evaluated at once, for the same reason.
TIMES_AT_ONCE = 4096

#: Steps after which the progress is reported.
STEPS_PER_REPORT = 1024


class TaylorIntegrator:
    """A compiled closed loop; an :class:`~certrack.integrators.base.Integrator`.

    Not for two threads at once: make one per thread.

    Parameters
    ----------
    loop : ClosedLoop
    tolerance : float
        Fixes the order of the method, hence part of the compilation.
    """

    def __init__(self, loop: ClosedLoop, tolerance: float) -> None:
        hy = quiet_heyoka()
        rates, kinks = extract_switches(loop.rates)
        used = set().union(*(f.free_symbols for f in (*rates, *(f for _, f in kinks))))
        count = len(loop.parameters) - loop.pieces
        indices = [i for i, symbol in enumerate(loop.parameters[:count]) if symbol in used]
        self._used = np.array(indices, dtype=int)  # heyoka refuses parameters that nothing uses
        parameters = [
            *(loop.parameters[i] for i in indices),
            *loop.parameters[count:],
            *(symbol for symbol, _ in kinks),
        ]
        self._piece = slice(len(indices), len(indices) + loop.pieces)
        names = [state.name for state in loop.states]
        variables = [hy.expression(name) for name in names]
        known = {symbol: hy.par[i] for i, symbol in enumerate(parameters)}
        known |= dict(zip(loop.states, variables, strict=True))
        self._moving = len(loop.states) - len(INTEGRALS)
        self._switches: Switches | None = None
        events = []
        if kinks:
            functions = [inside for _, inside in kinks]
            self._switches = Switches(loop.states, parameters, rates, functions)
            events = self._switches.events(hy, to_heyoka(functions, known))
        self._integrator = hy.taylor_adaptive(
            list(zip(variables, to_heyoka(rates, known), strict=True)),
            [0.0] * len(variables),
            tol=tolerance,
            pars=[0.0] * len(parameters),
            t_events=events,
        )

    def integrate(self, problem: Problem) -> Trajectory:
        """Solve `problem`; stops early at an escape, an undefined rate or the step limit."""
        trajectory, steps = self._attempt(problem, careful=False)
        lengths = np.diff(trajectory.times)
        size = np.abs(steps.table[: len(lengths), : problem.plant_order, 0]).max(
            axis=1, initial=0.0
        )
        tame = int(np.argmax(np.append(size > ESCAPING, True)))  # an escape's last steps are wild
        if tame and _excess(steps, self._moving, lengths[:tame]) > RERUN * SLACK:
            trajectory, steps = self._attempt(problem, careful=True)
        switches = self._switches
        if switches is not None and len(trajectory.times) > 1:
            middle = (trajectory.times[:-1] + trajectory.times[1:]) / 2
            if switches.missed(middle, trajectory.interpolate(middle)):
                return replace(trajectory, outcome=Outcome.kink_missed)
        return trajectory

    def _attempt(self, problem: Problem, *, careful: bool) -> tuple[Trajectory, SampledSteps]:
        """Integrate from the start; with `careful`, shorten steps that are too long."""
        ta, switches = self._integrator, self._switches
        ta.state[:] = problem.start
        ta.pars[: self._piece.start] = problem.parameters[self._used]
        steps = SampledSteps(ta.tc.shape)
        end, outcome = 0.0, Outcome.finished
        if switches is not None:
            switches.begin()
        for begin, stop in problem.segments:
            ta.pars[self._piece] = problem.schedule.piece_values(begin)
            ta.time = begin
            if switches is not None:
                switches.set(ta)
            end, outcome = self._segment(begin, stop, problem, steps, careful)
            if outcome is not Outcome.finished:
                break
        return _trajectory(steps, end, outcome, problem), steps

    def _segment(
        self, begin: float, stop: float, problem: Problem, steps: SampledSteps, careful: bool
    ) -> tuple[float, Outcome]:
        """Step from `begin` to `stop`, recording the Taylor coefficients of every step."""
        ta, switches = self._integrator, self._switches
        step, tc, k, starts, table = ta.step, ta.tc, steps.count, steps.starts, steps.table
        empty, stalled, max_steps = 0, 0, problem.max_steps
        while True:  # the hot loop: heyoka's step takes about as long as two Python calls
            if switches is not None:
                switches.record(ta)
            left = stop - begin
            outcome, length = step(left, True)
            if careful and not abs(tc[:, 0]).max() < MAX_CAREFUL_STATE:
                result = begin, Outcome.undefined
                break
            if careful and length > (safe := safe_step(tc[: self._moving], length)):
                ta.state[:], ta.time = tc[:, 0], begin
                outcome, length = step(safe, True)
            if switches is not None:
                empty = empty + 1 if length == 0.0 else 0
                if empty > MAX_EMPTY_STEPS:
                    empty, length = 0, min(LEAVING_STEP, left)
                    ta.state[:] = tc @ length ** np.arange(tc.shape[1])
                    ta.time = begin + length
            if length != length:  # NaN: the rates are not finite
                result = begin, Outcome.undefined
                break
            if k == len(starts):
                starts, table = steps.grow()
            starts[k], table[k] = begin, tc
            k += 1
            if length == left:
                result = stop, Outcome.finished
                break
            stalled = stalled + 1 if begin + length == begin else 0
            if stalled > MAX_STALLED_STEPS:
                result = begin, Outcome.undefined
                break
            begin += length
            if k >= max_steps:
                result = begin, Outcome.step_limit
                break
            if not k % STEPS_PER_REPORT:
                problem.progress(begin, problem.duration, None)
            if switches is not None and int(outcome) >= 0:
                switches.set(ta, skip=int(outcome))
        steps.count = k
        return result


# heyoka takes the step h from the last two Taylor coefficients c_p and c_{p-1} alone, such that
# |c_j| h^j ~ max(1, |x|) exp(-2 j) there: at rest x = 0 counts as 1, too. Where these two happen to
# vanish, as from x = 0 in x' = 1 + x^3 whose series has only every third term, the step is far too
# long. So the few coefficients before them are held to the same rule, with some slack because they
# usually exceed it a little.
SLACK = 100.0

#: Coefficients before the last two that are looked at.
ORDERS_BEFORE = 5

#: A run whose steps exceed the rule with slack by more than this is repeated with careful steps.
RERUN = 10.0


def _orders(count: int) -> range:
    """The orders j that are looked at, of `count` coefficients."""
    return range(max(2, count - 1 - ORDERS_BEFORE), count - 1)


def _excess(steps: SampledSteps, moving: int, lengths: np.ndarray) -> float:
    """Largest |c_j| h^j / (max(1, |x|) exp(-2 j)) over all steps."""
    table = steps.table[: len(lengths), :moving]
    orders = _orders(table.shape[2])
    begin, late = table[:, :, :2], table[:, :, orders.start : orders.stop]
    with np.errstate(all="ignore"):  # an escape overflows; an event may end a step at its begin
        squares = np.einsum("sij,sij->sj", begin, begin)  # Euclidean norms: several times faster
        size = np.maximum(1.0, np.maximum(squares[:, 0], squares[:, 1] * lengths**2))
        reach = np.log(lengths) + 2.0
        growth = np.exp(2.0 * reach[:, None] * np.arange(orders.start, orders.stop))
        terms = np.einsum("sij,sij->sj", late, late) * growth
        return float(np.sqrt((terms / size[:, None]).max()))


def safe_step(coefficients: np.ndarray, length: float) -> float:
    """Longest step, s, by the rule above, from the Taylor coefficients of each state in a row."""
    table = np.abs(coefficients)
    size = max(1.0, table[:, 0].max(), table[:, 1].max() * length)
    j = np.array(_orders(table.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):  # 0/0 at rest: no limit
        limits = (SLACK * size / table[:, j].max(axis=0)) ** (1.0 / j) * np.exp(-2.0)
    return float(limits.min())


class SampledSteps:
    """Growing record of steps: begin and Taylor coefficients."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = 0
        self.starts = np.empty(128)
        self.table = np.empty((128, *shape))

    def grow(self) -> tuple[np.ndarray, np.ndarray]:
        """More room; where there is space behind a table nothing is copied."""
        room = len(self.starts) + max(len(self.starts) // 4, ROOM_AT_LEAST)
        self.starts.resize(room, refcheck=False)
        self.table.resize((room, *self.table.shape[1:]), refcheck=False)
        return self.starts, self.table


def _trajectory(steps: SampledSteps, end: float, outcome: Outcome, problem: Problem) -> Trajectory:
    """Cut the record where a plant state first passes the limit."""
    count = steps.count
    starts, table = steps.starts[:count], steps.table[:count]
    if not count:
        starts, table = np.zeros(1), problem.start[None, :, None]
        return Trajectory(np.zeros(1), TaylorSeries(starts, table), outcome, "taylor")
    size = np.abs(table[:, : problem.plant_order, 0]).max(axis=1)
    beyond = np.flatnonzero(~(size <= problem.max_state))
    if beyond.size and beyond[0] > 0:
        k = int(beyond[0])
        end, outcome = float(starts[k]), Outcome.escaped
        starts, table = starts[:k], table[:k]
    elif outcome is Outcome.undefined and size[-1] > ESCAPING:
        outcome = Outcome.escaped
    series = TaylorSeries(starts, table)
    parts = parts_of(len(starts))
    return Trajectory(np.append(starts, end), series, outcome, "taylor", parts)


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
        states = np.empty((self.table.shape[1], len(t)))
        for first in range(0, len(t), TIMES_AT_ONCE):
            part = slice(first, first + TIMES_AT_ONCE)
            k = np.maximum(self.starts.searchsorted(t[part], side="right") - 1, 0)
            since = t[part] - self.starts[k]
            orders = np.ascontiguousarray(self.table[k].transpose(2, 1, 0))
            value = orders[-1]
            for coefficient in orders[-2::-1]:  # Horner's rule, in place
                value *= since
                value += coefficient
            states[:, part] = value
        return states

    def subdivided(self, times: np.ndarray, parts: int) -> np.ndarray:
        """States at :func:`certrack.integrators.base.subdivide` of the steps, much faster."""
        steps, size, orders = self.table.shape
        series = fractions(parts) ** np.arange(orders)[:, None]
        states = np.empty((size, steps, parts + 1))
        for first in range(0, steps, STEPS_AT_ONCE):
            part = slice(first, first + STEPS_AT_ONCE)
            table = self.table[part]
            powers = np.empty((len(table), 1, orders))  # h^k, by products: pow() is slow
            powers[:, 0, 0], powers[:, 0, 1:] = 1.0, np.diff(times)[part, None]
            np.multiply.accumulate(powers, axis=2, out=powers)
            values = (table * powers).reshape(-1, orders) @ series  # all steps at once
            states[:, part] = values.reshape(len(table), size, parts + 1).transpose(1, 0, 2)
        states[:, 0, 0] = self.table[0, :, 0]
        states[:, -1, -1] = (self.table[-1] * powers[-1]).sum(axis=1)
        return states.reshape(size, -1)
