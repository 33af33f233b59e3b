"""SciPy integrators: the independent check, the portable fallback, and the implicit method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.kinks import without_minmax
from certrack.core.lowering import jacobian, numpy_callable, rows
from certrack.integrators.base import ESCAPING, Outcome, Problem, Trajectory, parts_of
from certrack.loops.continuous import INTEGRAL_SCALE, INTEGRALS, ClosedLoop

#: Evaluations of the rates in one segment of the reference; a run with more would take minutes.
MAX_EVALUATIONS = 400_000

#: Samples of a step between which kinks of the state are looked for, its begin and end included.
KINK_SAMPLES = np.linspace(0.0, 1.0, 6)

#: Halvings that locate a kink, and the part of the time within which it is where a step begins or
#: ends.
KINK_BISECTIONS, AT_BEGIN = 50, 1e-10

#: The methods get this part of the tolerance. The error of the explicit one between the ends of a
#: step is some 30 times that at the ends; the errors of the many steps of the implicit one add up.
EXPLICIT_SHARE, IMPLICIT_SHARE = 0.03, 0.05

#: SciPy refuses smaller relative tolerances (100 times the rounding of a double).
MIN_RELATIVE_TOLERANCE = 3e-14


class SolverFactory:
    """Solvers of SciPy for the rates of a loop, to the accuracy of a run.

    Parameters
    ----------
    states : symbols
    others : symbols, or nested lists of them
        What the rates depend on besides the time and the states.
    rates : formulas
    implicit : bool
        Radau (order 5, with the exact Jacobian) instead of DOP853 (explicit, order 8).
    """

    def __init__(
        self, states: Sequence[Any], others: Sequence[Any], rates: Sequence[Any], *, implicit: bool
    ) -> None:
        arguments = [TIME, states, *others]
        self._rates = numpy_callable(arguments, rates)
        self._size, self._share = len(states), IMPLICIT_SHARE if implicit else EXPLICIT_SHARE
        self._jacobian = numpy_callable(arguments, jacobian(rates, states)) if implicit else None

    def rates(self, t: float, y: np.ndarray, *values: np.ndarray) -> np.ndarray:
        """The rates at values of what else they depend on."""
        with np.errstate(all="ignore"):
            return np.array(self._rates(t, y, *values), dtype=float)

    def are_defined(self, t: float, y: np.ndarray, *values: np.ndarray) -> bool:
        """Whether every rate is finite."""
        return bool(np.isfinite(self.rates(t, y, *values)).all())

    def of(
        self, problem: Problem, *values: np.ndarray, max_step: float = np.inf
    ) -> Callable[[float, np.ndarray, float], Any]:
        """Makes a solver for a begin, a state and an end."""
        from scipy.integrate import DOP853, Radau

        tolerance = problem.tolerance * self._share
        absolute = np.full(self._size, tolerance)
        absolute[-len(INTEGRALS) :] /= INTEGRAL_SCALE
        options: dict[str, Any] = {
            "rtol": max(tolerance, MIN_RELATIVE_TOLERANCE),
            "atol": absolute,
            "max_step": max_step,
        }
        if self._jacobian is None:  # its interpolant is poor on steps that only stability limits
            options["max_step"] = min(max_step, 1.0 / problem.fastest_pole)
        else:
            options["jac"] = lambda t, y: self._jacobian_at(t, y, *values)
        return partial(
            DOP853 if self._jacobian is None else Radau,
            lambda t, y: self.rates(t, y, *values),
            **options,
        )

    def _jacobian_at(self, t: float, y: np.ndarray, *values: np.ndarray) -> np.ndarray:
        assert self._jacobian is not None
        with np.errstate(all="ignore"):
            entries = np.array(self._jacobian(t, y, *values), dtype=float)
        return np.nan_to_num(entries.reshape(self._size, self._size))


class ScipyIntegrator:
    """A closed loop as NumPy functions; an :class:`~certrack.integrators.base.Integrator`.

    Parameters
    ----------
    loop : ClosedLoop
    implicit : bool
        Radau instead of DOP853.
    """

    def __init__(self, loop: ClosedLoop, implicit: bool = False) -> None:
        kinks = set().union(*(without_minmax(rate).atoms(sympy.Abs) for rate in loop.rates))
        inside = sorted((kink.args[0] for kink in kinks), key=sympy.default_sort_key)
        arguments = [TIME, loop.states, loop.parameters]
        self._kinks = numpy_callable(arguments, inside) if inside else None
        self._solvers = SolverFactory(loop.states, [loop.parameters], loop.rates, implicit=implicit)
        self.implicit = implicit

    def integrate(self, problem: Problem) -> Trajectory:
        """Solve `problem`; stops early at an escape, an undefined rate or the step limit."""
        method = "implicit" if self.implicit else "scipy"
        times: list[float] = [0.0]
        pieces: list[Any] = []
        y, outcome = np.array(problem.start, dtype=float), Outcome.finished
        for begin, stop in problem.segments:
            p = np.concatenate([problem.parameters, problem.schedule.piece_values(begin)])
            if not self._solvers.are_defined(begin, y, p):
                outcome = Outcome.undefined
                break
            make = self._solvers.of(problem, p)
            kinks = None if self._kinks is None else partial(self._kink_values, p)
            y, outcome = _advance(make, (begin, y, stop), problem, times, pieces, kinks)
            if outcome is not Outcome.finished:
                break
        output, parts = SteppedOutput(times, pieces, y), parts_of(len(pieces))
        return Trajectory(np.array(times), output, outcome, method, parts)

    def _kink_values(self, p: np.ndarray, t: np.ndarray, y: np.ndarray) -> np.ndarray:
        """What stands under abs, or under min and max as a difference; shape (K, N)."""
        assert self._kinks is not None
        with np.errstate(all="ignore"):
            return rows(self._kinks(t, y, p), len(t))


#: Values whose change of sign is a kink, of times and states.
Kinks = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _advance(
    make: Callable[[float, np.ndarray, float], Any],
    segment: tuple[float, np.ndarray, float],
    problem: Problem,
    times: list[float],
    pieces: list[Any],
    kinks: Kinks | None,
) -> tuple[np.ndarray, Outcome]:
    """Step to the end of a segment (begin, state, end), and from kink to kink of the state.

    `make` makes a solver for a begin, a state and an end. The last state is returned.
    """
    begin, y, stop = segment
    solver, used = make(begin, y, stop), 0
    while True:
        problem.progress(times[-1], problem.duration, None)
        begin, y = solver.t, solver.y
        with np.errstate(all="ignore"):
            solver.step()
        if solver.status == "failed":
            large = np.abs(solver.y[: problem.plant_order]).max() > ESCAPING
            return solver.y, Outcome.escaped if large else Outcome.undefined
        dense = solver.dense_output()
        kink = None if kinks is None else _first_kink(kinks, dense, begin, solver.t)
        if kink is None:
            pieces.append(dense)
            times.append(solver.t)
            if not np.abs(solver.y[: problem.plant_order]).max() <= problem.max_state:
                return solver.y, Outcome.escaped
            if solver.t == stop:
                return solver.y, Outcome.finished
        if used + solver.nfev > MAX_EVALUATIONS or len(pieces) >= problem.max_steps:
            return solver.y if kink is None else y, Outcome.step_limit
        if kink is not None:  # the error control may not have seen it: step up to it instead
            used += solver.nfev
            solver = make(begin, y, kink)
        elif solver.status == "finished":
            used += solver.nfev
            solver = make(solver.t, solver.y, stop)


def _first_kink(
    kinks: Kinks, dense: Callable[[np.ndarray], np.ndarray], begin: float, end: float
) -> float | None:
    """The first time well inside a step at which a kink's value changes its sign."""
    near = AT_BEGIN * max(1.0, abs(end))
    times = begin + (end - begin) * KINK_SAMPLES
    values = kinks(times, dense(times))
    crossings = []
    for k, j in np.argwhere(values[:, :-1] * values[:, 1:] < 0).tolist():
        low, high, rising = times[j], times[j + 1], values[k, j] < 0
        for _ in range(KINK_BISECTIONS):
            middle = np.array([(low + high) / 2])
            above = kinks(middle, dense(middle))[k, 0] > 0
            low, high = (low, middle[0]) if above == rising else (middle[0], high)
        if begin + near < high < end - near:
            crossings.append(float(high))
    return min(crossings, default=None)


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
