"""Loops that switch and slide: one driver above the Taylor method and SciPy's.

A method follows the smooth rates of one mode (:mod:`certrack.loops.switching`). After every step
the driver looks, on the dense output, whether the mode still held; the first time at which it did
not ends the step there, and :class:`~certrack.integrators.switching.Surfaces` says what holds next.
So steps are as long as the method's own between two events, and the order of the method is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.heyoka import quiet_heyoka
from certrack.core.lowering import extract_switches, to_heyoka
from certrack.integrators.base import ESCAPING, Outcome, Problem, Trajectory
from certrack.integrators.event_location import EVENT_TIME_ROUNDING, first_event
from certrack.integrators.single.scipy import MAX_EVALUATIONS, SolverFactory, SteppedOutput
from certrack.integrators.single.switches import Switches
from certrack.integrators.single.taylor import SampledSteps, TaylorSeries, safe_step
from certrack.integrators.switching import ModeRecord, Rush, SlidingRefused, Surfaces
from certrack.loops.continuous import INTEGRALS, ClosedLoop
from certrack.loops.switching import Switching

#: A step is at most this part of the run and this many time constants of the fastest error pole: so
#: formulas of time that pull at a stuck state, whose own rates are zero, are seen.
LONGEST_STEP, TIME_CONSTANTS = 1 / 50, 2.0


class Stepper(Protocol):
    """A method that follows smooth rates step by step and keeps what it needs of every step."""

    method: str

    def begin(self, problem: Problem) -> None:
        """Forget the run before."""

    def restart(self, t: float, stop: float, x: np.ndarray, p: np.ndarray, m: np.ndarray) -> None:
        """Go on from a state with parameters p in modes m, at most until `stop`."""

    def step(self, left: float) -> tuple[float, Outcome]:
        """Try a step of at most `left`; its length, and why there is none."""

    def states(self, since: np.ndarray) -> np.ndarray:
        """States on the last step, (S, N), at times since its begin."""

    def kinks(self, since: np.ndarray) -> np.ndarray:
        """What is negative on the last step after a kink that the method cannot cross, (L, N)."""

    def keep(self, length: float) -> bool:
        """Keep the last step until `length`; whether more steps are allowed."""

    def dense(self) -> Callable[[np.ndarray], np.ndarray]:
        """The solution so far."""


class SlidingIntegrator:
    """A closed loop with switching surfaces; an :class:`~certrack.integrators.base.Integrator`.

    Parameters
    ----------
    loop : ClosedLoop
    switching : Switching
        Of the loop's rates.
    method : {"taylor", "scipy", "implicit"}
    tolerance : float
        Of the Taylor method.
    """

    def __init__(
        self, loop: ClosedLoop, switching: Switching, method: str, tolerance: float
    ) -> None:
        self._surfaces = Surfaces(switching, [TIME, loop.states, loop.parameters])
        self._stepper: Stepper = (
            _TaylorStepper(loop, switching, tolerance)
            if method == "taylor"
            else _ScipyStepper(loop, switching, implicit=method == "implicit")
        )

    def integrate(self, problem: Problem) -> Trajectory:
        """Solve `problem`, from event to event."""
        stepper, surfaces = self._stepper, self._surfaces
        stepper.begin(problem)
        x, K = np.array(problem.start, dtype=float), surfaces.count
        modes = np.concatenate([np.ones(K), np.zeros(K)])
        times, record = [0.0], [(0.0, modes)]
        outcome, rush = Outcome.finished, Rush()
        for begin, stop in problem.segments:
            p = np.concatenate([problem.parameters, problem.schedule.piece_values(begin)])
            t = begin
            reached: tuple[int, ...] = ()
            while outcome is Outcome.finished and t < stop:
                try:
                    x, modes = surfaces.settled([t, x, p], modes, reached)
                except SlidingRefused:
                    outcome = Outcome.chattering
                    break
                record.append((t, modes))
                stepper.restart(t, stop, x, p, modes)
                t, x, reached, outcome = self._follow(t, stop, p, modes, problem, times)
                if reached:
                    try:
                        rush.add(t)
                    except SlidingRefused:
                        outcome = Outcome.chattering
            if outcome is not Outcome.finished:
                break
        begins = np.array([t for t, _ in record])
        last = np.append(begins[1:] > begins[:-1], True)  # of several at a time the last one
        mode_record = ModeRecord(
            surfaces.names, begins[last], np.array([m for _, m in record])[last]
        )
        return Trajectory(
            np.array(times), stepper.dense(), outcome, stepper.method, modes=mode_record
        )

    def _follow(
        self,
        t: float,
        stop: float,
        p: np.ndarray,
        modes: np.ndarray,
        problem: Problem,
        times: list[float],
    ) -> tuple[float, np.ndarray, tuple[int, ...], Outcome]:
        """Step in one mode until an event or `stop`; time, state, surfaces reached, outcome."""
        stepper, surfaces, n = self._stepper, self._surfaces, problem.plant_order
        longest = min(problem.duration * LONGEST_STEP, TIME_CONSTANTS / problem.fastest_pole)
        x = stepper.states(np.zeros(1))[:, 0]
        limit = surfaces.threshold([t, x, p], modes)
        while t < stop:
            left = min(stop - t, longest)
            length, outcome = stepper.step(left)
            if outcome is not Outcome.finished:
                return t, x, (), outcome
            begin = t

            def holds(since: np.ndarray, begin: float = begin) -> np.ndarray:
                """What is negative where the mode or a kink's side holds no more."""
                states = stepper.states(since)
                rows = surfaces.watch([begin + since, states, p], modes, len(since))
                kinks = stepper.kinks(since) + limit.max(initial=0.0)
                return np.vstack([rows + limit[:, None], kinks])

            event = first_event(holds, length, EVENT_TIME_ROUNDING * max(abs(begin), length))
            if event is not None:
                length, row = event
            more = stepper.keep(length)
            t = stop if event is None and length == stop - begin else begin + length
            times.append(t)
            x = stepper.states(np.array([length]))[:, 0]
            problem.progress(t, problem.duration, None)
            if not np.abs(x[:n]).max() <= problem.max_state:
                return t, x, (), Outcome.escaped
            if not more:
                return t, x, (), Outcome.step_limit
            if event is not None:
                reached = (row,) if row < surfaces.count and not modes[surfaces.count + row] else ()
                return t, x, reached or (-1,), Outcome.finished
        return t, x, (), Outcome.finished


class _TaylorStepper:
    """heyoka's Taylor method; kinks of abs, min and max are switches of it besides."""

    method = "taylor"

    def __init__(self, loop: ClosedLoop, switching: Switching, tolerance: float) -> None:
        hy = quiet_heyoka()
        rates, kinks = extract_switches(switching.rates)
        functions = [inside for _, inside in kinks]
        everything = [*loop.parameters, *switching.modes, *(symbol for symbol, _ in kinks)]
        used = set().union(*(f.free_symbols for f in (*rates, *functions)))
        self._used = np.array([i for i, name in enumerate(everything) if name in used], dtype=int)
        parameters = [everything[i] for i in self._used]
        self._count = len(loop.parameters) + len(switching.modes)
        self._switches: Switches | None = None
        if kinks:
            self._switches = Switches(loop.states, everything, rates, functions)
        names = [state.name for state in loop.states]
        variables = [hy.expression(name) for name in names]
        known = {symbol: hy.par[i] for i, symbol in enumerate(parameters)}
        known |= dict(zip(loop.states, variables, strict=True))
        self._ta = hy.taylor_adaptive(
            list(zip(variables, to_heyoka(rates, known), strict=True)),
            [0.0] * len(variables),
            tol=tolerance,
            pars=[0.0] * len(parameters),
        )
        self._moving = len(loop.states) - len(INTEGRALS)
        self._all = np.zeros(len(everything))
        self._all[self._count :] = 1.0
        self._fresh = True

    def begin(self, problem: Problem) -> None:
        self._steps = SampledSteps(self._ta.tc.shape)
        self._max_steps, self._start = problem.max_steps, problem.start
        self._all[self._count :] = 1.0

    def restart(self, t: float, stop: float, x: np.ndarray, p: np.ndarray, m: np.ndarray) -> None:
        ta = self._ta
        ta.state[:], ta.time = x, t
        self._all[: self._count] = np.concatenate([p, m])
        self.time, self.state, self.pars = t, x, self._all
        if self._switches is not None:
            self._switches.set(self)
            self._all = self.pars
        ta.pars[:] = self._all[self._used]
        self._begin, self._fresh = t, True

    def step(self, left: float) -> tuple[float, Outcome]:
        ta = self._ta
        self._begin = begin = ta.time
        _, length = ta.step(left, True)
        if length == length and length > (safe := safe_step(ta.tc[: self._moving], length)):
            ta.state[:], ta.time = ta.tc[:, 0], begin
            _, length = ta.step(safe, True)
        self._fresh = False
        if length != length or begin + length == begin:
            large = np.abs(ta.tc[: self._moving, 0]).max() > ESCAPING
            return 0.0, Outcome.escaped if large else Outcome.undefined
        return length, Outcome.finished

    def states(self, since: np.ndarray) -> np.ndarray:
        if self._fresh:
            return np.repeat(self._ta.state[:, None], len(since), axis=1)
        tc = self._ta.tc
        value = np.repeat(tc[:, -1:], len(since), axis=1)
        for order in range(tc.shape[1] - 2, -1, -1):
            value = value * since + tc[:, order : order + 1]
        return value

    def kinks(self, since: np.ndarray) -> np.ndarray:
        if self._switches is None:
            return np.empty((0, len(since)))
        return self._switches.held(self._begin + since, self.states(since), self._all)

    def keep(self, length: float) -> bool:
        steps = self._steps
        if steps.count == len(steps.starts):
            steps.grow()
        steps.starts[steps.count], steps.table[steps.count] = self._begin, self._ta.tc
        steps.count += 1
        return steps.count < self._max_steps

    def dense(self) -> Callable[[np.ndarray], np.ndarray]:
        count = self._steps.count
        if not count:
            return TaylorSeries(np.zeros(1), self._start[None, :, None])
        return TaylorSeries(self._steps.starts[:count], self._steps.table[:count])


class _ScipyStepper:
    """DOP853 or Radau of SciPy; its error control follows the kinks of abs, min and max."""

    def __init__(self, loop: ClosedLoop, switching: Switching, *, implicit: bool) -> None:
        self.method = "implicit" if implicit else "scipy"
        self._solvers = SolverFactory(
            loop.states, [loop.parameters, switching.modes], switching.rates, implicit=implicit
        )

    def begin(self, problem: Problem) -> None:
        self._problem, self._evaluations = problem, 0
        self._times: list[float] = [0.0]
        self._pieces: list[Any] = []
        self._last = np.array(problem.start, dtype=float)

    def restart(self, t: float, stop: float, x: np.ndarray, p: np.ndarray, m: np.ndarray) -> None:
        self._last, self._dense, self._now = x, None, t
        self._defined = self._solvers.are_defined(t, x, p, m)
        if not self._defined:
            return
        longest = self._problem.duration * LONGEST_STEP
        make = self._solvers.of(self._problem, p, m, max_step=longest)
        with np.errstate(all="ignore"):
            self._solver = make(t, x, stop)
        self._evaluated = 0

    def step(self, left: float) -> tuple[float, Outcome]:
        if not self._defined:
            return 0.0, Outcome.undefined
        solver = self._solver
        self._now = begin = solver.t
        with np.errstate(all="ignore"):
            solver.step()
        if solver.status == "failed":
            large = np.abs(solver.y[: self._problem.plant_order]).max() > ESCAPING
            return 0.0, Outcome.escaped if large else Outcome.undefined
        self._dense = solver.dense_output()
        return solver.t - begin, Outcome.finished

    def states(self, since: np.ndarray) -> np.ndarray:
        if self._dense is None:
            return np.repeat(self._last[:, None], len(since), axis=1)
        states: np.ndarray = self._dense(self._now + since)
        return states

    def kinks(self, since: np.ndarray) -> np.ndarray:
        return np.empty((0, len(since)))

    def keep(self, length: float) -> bool:
        self._times.append(self._now + length)
        self._pieces.append(self._dense)
        self._last = self.states(np.array([length]))[:, 0]
        self._evaluations += self._solver.nfev - self._evaluated
        self._evaluated = self._solver.nfev
        return self._evaluations <= MAX_EVALUATIONS

    def dense(self) -> Callable[[np.ndarray], np.ndarray]:
        return SteppedOutput(self._times, self._pieces, self._last)
