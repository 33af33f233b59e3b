"""SciPy integrators: the independent check, the portable fallback, and the implicit method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.lowering import jacobian, numpy_callable
from certrack.integrators.base import ESCAPING, Outcome, Problem, Trajectory, parts_of
from certrack.loops.continuous import INTEGRAL_SCALE, INTEGRALS, ClosedLoop

#: Evaluations of the rates in one segment of the reference; a run with more would take minutes.
MAX_EVALUATIONS = 400_000

#: SciPy refuses smaller relative tolerances (100 times the rounding of a double).
MIN_RELATIVE_TOLERANCE = 3e-14


class ScipyIntegrator:
    """A closed loop as NumPy functions; an :class:`~certrack.integrators.base.Integrator`.

    Parameters
    ----------
    loop : ClosedLoop
    implicit : bool
        Radau (order 5, with the exact Jacobian) instead of DOP853 (explicit, order 8).
    """

    def __init__(self, loop: ClosedLoop, implicit: bool = False) -> None:
        arguments = [TIME, loop.states, loop.parameters]
        self._rates = numpy_callable(arguments, loop.rates)
        self._size = len(loop.states)
        self.implicit = implicit
        self._jacobian: Callable[..., list[Any]] | None = None
        if implicit:
            self._jacobian = numpy_callable(arguments, jacobian(loop.rates, loop.states))

    def integrate(self, problem: Problem) -> Trajectory:
        """Solve `problem`; stops early at an escape, an undefined rate or the step limit."""
        from scipy.integrate import DOP853, Radau

        method = "implicit" if self.implicit else "scipy"
        times: list[float] = [0.0]
        pieces: list[Any] = []
        y, outcome = np.array(problem.start, dtype=float), Outcome.finished
        absolute = np.full(self._size, problem.tolerance)
        absolute[-len(INTEGRALS) :] /= INTEGRAL_SCALE
        for begin, stop in problem.segments:
            p = np.concatenate([problem.parameters, problem.schedule.piece_values(begin)])

            def rates(t: float, y: np.ndarray, p: np.ndarray = p) -> np.ndarray:
                with np.errstate(all="ignore"):
                    return np.array(self._rates(t, y, p), dtype=float)

            if not np.isfinite(rates(begin, y)).all():
                outcome = Outcome.undefined
                break
            relative = max(problem.tolerance, MIN_RELATIVE_TOLERANCE)
            options: dict[str, Any] = {"rtol": relative, "atol": absolute}
            if not self.implicit:  # its interpolant is poor on steps that only stability limits
                options["max_step"] = 1.0 / problem.fastest_pole
            if self.implicit:
                options["jac"] = lambda t, y, p=p: self._jacobian_at(t, y, p)
            solver = (Radau if self.implicit else DOP853)(rates, begin, y, stop, **options)
            outcome = _advance(solver, problem, times, pieces)
            y = solver.y
            if outcome is not Outcome.finished:
                break
        output, parts = SteppedOutput(times, pieces, y), parts_of(len(pieces))
        return Trajectory(np.array(times), output, outcome, method, parts)

    def _jacobian_at(self, t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        assert self._jacobian is not None
        with np.errstate(all="ignore"):
            entries = np.array(self._jacobian(t, y, p), dtype=float)
        return np.nan_to_num(entries.reshape(self._size, self._size))


def _advance(solver: Any, problem: Problem, times: list[float], pieces: list[Any]) -> Outcome:
    """Step the solver to the end of its segment."""
    n = problem.plant_order
    while solver.status == "running":
        problem.progress(times[-1], problem.duration, None)
        with np.errstate(all="ignore"):
            solver.step()
        if solver.status == "failed":
            large = np.abs(solver.y[:n]).max() > ESCAPING
            return Outcome.escaped if large else Outcome.undefined
        pieces.append(solver.dense_output())
        times.append(solver.t)
        if not np.abs(solver.y[:n]).max() <= problem.max_state:
            return Outcome.escaped
        if solver.nfev > MAX_EVALUATIONS or len(pieces) >= problem.max_steps:
            return Outcome.step_limit
    return Outcome.finished


@dataclass(frozen=True)
class SteppedOutput:
    """SciPy's interpolants, one per step."""

    times: list[float]
    pieces: list[Any]
    last: np.ndarray

    def __call__(self, t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        states = np.empty((len(self.last), len(t)))
        if not self.pieces:
            states[:] = self.last[:, None]
            return states
        inner = np.array(self.times[1:-1])
        owner = np.searchsorted(inner, t, side="left")
        for k in np.unique(owner):
            states[:, owner == k] = self.pieces[k](t[owner == k])
        return states
