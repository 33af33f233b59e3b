"""One run of the continuous closed loop: the choice of the method, and a second try with another.

The Taylor method is the usual one. It needs right-hand sides with a Taylor series wherever the
solution goes, and like every explicit method it follows each time constant of the loop: functions
with branch points go to a Runge-Kutta method, stiff designs to an implicit one. What cannot be
seen in advance shows in the outcome, and then the run is made again.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy

from certrack.core.branches import may_branch
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.lowering import NumpyFunction, numpy_callable, rows
from certrack.core.progress import Progress, silent
from certrack.integrators.base import Integrator, Outcome, Problem, Trajectory
from certrack.integrators.single.extremes import (
    SeriesSignals,
    SignalProgram,
    signal_program,
)
from certrack.integrators.single.scipy import ScipyIntegrator
from certrack.integrators.single.sliding import SlidingIntegrator
from certrack.integrators.single.taylor import TaylorIntegrator
from certrack.integrators.switching import ModeRecord, sticking_notes
from certrack.loops.continuous import INTEGRALS, ClosedLoop, close_loop, parameter_values
from certrack.loops.schedule import Schedule, make_schedule
from certrack.loops.switching import switching
from certrack.loops.time_switches import switched_loop
from certrack.simulation.run import Run
from certrack.systems.system import System

#: A design is stiff if its fastest pole has more time constants than this in a run: an explicit
#: method would have to follow them all.
STIFF_TIME_CONSTANTS = 2e5

#: ... and if its fastest pole is so many times its slowest; else every method needs short steps.
STIFF_POLE_RATIO = 1e3

#: Functions whose jumps and branch points may lie inside a step of SciPy's methods; at other kinks
#: they stop.
UNSEEN_KINKS = (sympy.sign, sympy.asin, sympy.acos, sympy.atan2)

#: Functions with jumps or branch points that do not show as switches.
BRANCHING_FUNCTIONS = (sympy.asin, sympy.acos, sympy.atan2, sympy.tan)

#: Where the automatic choice failed: what to try next, and what to say.
RETRIES = {
    ("taylor", Outcome.undefined): (
        "scipy",
        "The solution has no Taylor series (for example sqrt at zero)",
    ),
    ("taylor", Outcome.kink_missed): ("scipy", "A kink of abs, sign, min or max was missed"),
    ("taylor", Outcome.step_limit): ("implicit", "The explicit method reached its step limit"),
}


class ContinuousSimulator:
    """A system's continuous loop; every method is compiled when it is first used.

    An integrator serves one run at a time: threads that run at once have one each.

    Parameters
    ----------
    system : System
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.loop: ClosedLoop = close_loop(system)
        self._switched, self._switches = switched_loop(self.loop)
        self._idle: dict[tuple[str, float], list[Integrator]] = {}
        rates = self._switched.rates
        self._has_kinks = any(may_branch(rate, UNSEEN_KINKS) for rate in rates)
        self._branches = any(may_branch(rate, BRANCHING_FUNCTIONS) for rate in rates)
        self._parameters = parameter_values(self.loop, system)
        loop = self._switched
        arguments, u = [TIME, loop.states, loop.parameters], loop.u
        self._switching = switching(loop.rates, loop.states, smooth_rates=len(INTEGRALS))
        if self._switching is not None:
            arguments.append(self._switching.modes)
            (u,) = self._switching.resolved([u])
        self._input = numpy_callable(arguments, [u])

    @cached_property
    def _program(self) -> SignalProgram | None:
        """Error and input for the metrics; none where they depend on the sides of a run."""
        return signal_program(self._switched) if self._switching is None else None

    def run(self, system: System, progress: Progress = silent) -> Run:
        """Simulate a system whose loop is the compiled one in other numbers."""
        settings = system.settings
        parameters = (
            self._parameters if system is self.system else parameter_values(self.loop, system)
        )
        schedule = make_schedule(
            system.reference,
            self._switches,
            dict(zip(self.loop.parameters, parameters.tolist(), strict=False)),
            settings.duration,
            settings.tolerance,
        )
        problem = Problem(
            start=np.concatenate([system.start, np.zeros(len(INTEGRALS))]),
            parameters=parameters,
            schedule=schedule,
            duration=settings.duration,
            tolerance=settings.tolerance,
            plant_order=self.loop.n,
            fastest_pole=system.controller.fastest_pole,
            max_state=settings.max_state,
            progress=progress,
        )
        progress(0.0, settings.duration, None)
        method, notes = self._choose_method(system)
        notes.extend(schedule.notes)
        trajectory = self._integrated(method, problem)
        retry = RETRIES.get((method, trajectory.outcome)) if settings.integrator == "auto" else None
        if retry:
            method, reason = retry
            notes.append(f"{reason} at t = {trajectory.end:g} s; run again with {method}.")
            again = self._integrated(method, problem)
            missed = trajectory.outcome is Outcome.kink_missed
            trajectory = again if missed or again.end >= trajectory.end else trajectory
        modes = trajectory.modes
        inputs = InputOf(self._input, schedule, parameters, modes)
        if modes is not None:
            notes += sticking_notes(modes, trajectory.end)
        progress(settings.duration, settings.duration, None)
        smooth = method == "taylor" or not self._has_kinks
        signals, program = None, self._program
        if program is not None:
            signals = SeriesSignals(program, parameters, schedule.pieces_at)
        return Run(system, trajectory, inputs, tuple(notes), smooth, signals)

    def _choose_method(self, system: System) -> tuple[str, list[str]]:
        """Method for `system`, and why if it is not the usual one."""
        wanted = system.settings.integrator
        if wanted != "auto":
            if wanted == "taylor" and not has_heyoka():
                raise InputError(
                    "simulation.integrator",
                    "the Taylor method needs heyoka, which is not installed",
                    remedy="Use scipy, or install heyoka (conda-forge has it for all systems)",
                )
            return wanted, []
        fastest = system.controller.fastest_pole
        slowest = system.controller.coordinates.slowest_pole
        time_constants = fastest * system.settings.duration
        if time_constants > STIFF_TIME_CONSTANTS and fastest > STIFF_POLE_RATIO * slowest:
            return "implicit", [
                f"The design is stiff (fastest error pole {fastest:.3g} /s): implicit method used."
            ]
        if self._branches:
            return "scipy", [
                "asin, acos, atan2, tan may have branch points unseen by Taylor steps: SciPy."
            ]
        if not has_heyoka():
            warnings.warn(
                "heyoka is not installed: using SciPy, which is about 45 times slower",
                stacklevel=4,  # whoever called Simulator.run
            )
            return "scipy", []
        return "taylor", []

    def _integrated(self, method: str, problem: Problem) -> Trajectory:
        """The solution by a method, whose integrator is taken from the idle ones."""
        with self._integrator(method, problem.tolerance) as integrator:
            trajectory = integrator.integrate(problem)
        if trajectory.outcome is not Outcome.undefined:
            return trajectory
        last = trajectory.interpolate(np.array([trajectory.end]))[:, 0]
        estimates = np.abs(last[problem.plant_order : -len(INTEGRALS)])
        if (estimates <= problem.max_state).all():
            return trajectory
        return replace(trajectory, outcome=Outcome.controller_diverged)

    @contextmanager
    def _integrator(self, method: str, tolerance: float) -> Iterator[Integrator]:
        """An idle integrator, or a new one; the Taylor method's is for one tolerance only."""
        key = (method, tolerance if method == "taylor" else 0.0)
        idle = self._idle.setdefault(key, [])
        try:
            integrator = idle.pop()  # in one step: no other thread gets the same
        except IndexError:
            integrator = self._compiled(method, tolerance)
        try:
            yield integrator
        finally:
            idle.append(integrator)

    def _compiled(self, method: str, tolerance: float) -> Integrator:
        """A new integrator; loops that may slide have a driver above the method."""
        if self._switching is not None:
            return SlidingIntegrator(self._switched, self._switching, method, tolerance)
        if method == "taylor":
            return TaylorIntegrator(self._switched, tolerance)
        return ScipyIntegrator(self._switched, implicit=method == "implicit")


@dataclass(frozen=True)
class InputOf:
    """The control input u of a run at times t and states there, shape (N,).

    Attributes
    ----------
    law : NumpyFunction
        u as a function of time, states, and parameters with those of the piece.
    schedule : Schedule
    parameters : (P,) array
    modes : ModeRecord, optional
        Those of the run, where the law is a function of them, too.
    """

    law: NumpyFunction
    schedule: Schedule
    parameters: np.ndarray
    modes: ModeRecord | None = None

    def __call__(self, t: np.ndarray, states: np.ndarray) -> np.ndarray:
        pieces = self.schedule.pieces_at(t)
        modes = () if self.modes is None else (self.modes.at(t),)
        with np.errstate(all="ignore"):
            values = self.law(t, states, [*self.parameters.tolist(), *pieces], *modes)
        return rows(values, len(t))[0]
