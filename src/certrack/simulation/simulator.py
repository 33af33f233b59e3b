"""Run a system: choose a method, integrate, return the :class:`certrack.simulation.run.Run`."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.base import Integrator, Outcome, Problem
from certrack.integrators.single.scipy import ScipyIntegrator
from certrack.integrators.single.taylor import TaylorIntegrator, available
from certrack.loops.continuous import INTEGRALS, ClosedLoop, close_loop, parameter_values
from certrack.loops.sampled import sample_loop
from certrack.model.truth import Truth
from certrack.references import pieces_at
from certrack.simulation.run import Run
from certrack.simulation.sampled import SampledSimulator
from certrack.systems.system import System

#: A design is stiff if its fastest pole has more time constants than this in a run: an explicit
#: method would have to follow them all.
STIFF = 2e5

#: Functions with kinks that show as switches.
KINKS = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.asin, sympy.acos, sympy.atan2)

#: Functions with jumps or branch points that do not show as switches.
BRANCHING = (sympy.asin, sympy.acos, sympy.atan2, sympy.tan)


class Simulator:
    """A system's closed loop, compiled; runs it for any gains, truth, start and disturbance.

    Parameters
    ----------
    system : System

    Examples
    --------
    >>> import certrack, dataclasses
    >>> system = certrack.load("example1")
    >>> simulator = certrack.Simulator(system)
    >>> run = simulator.run()
    >>> stiffer = system.replace(law=dataclasses.replace(system.law, c=(2, 1)))
    >>> faster = simulator.run(stiffer)  # no recompilation
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self._sampled = None if system.implementation is None else SampledSimulator(system)
        self.loop: ClosedLoop = close_loop(system)
        self._integrators: dict[tuple[str, float], Integrator] = {}
        self._kinked = any(rate.has(*KINKS) for rate in self.loop.rates)
        self._parameters = parameter_values(self.loop, system)
        self._input = numpy_callable([TIME, self.loop.states, self.loop.parameters], [self.loop.u])

    def run(
        self,
        system: System | None = None,
        progress: Callable[[float], None] = lambda _share: None,
    ) -> Run:
        """Simulate `system`, by default the one given at construction.

        `progress` gets the share that is done of a sampled run, which may take long.

        Raises
        ------
        InputError
            If its structure (formulas, law, feed-forward order) differs from the compiled one.
        """
        system = self._accept(system)
        if self._sampled is not None:
            return self._sampled.run(system, progress)
        settings = system.settings
        parameters = (
            self._parameters if system is self.system else parameter_values(self.loop, system)
        )
        problem = Problem(
            start=np.concatenate([system.start, np.zeros(len(INTEGRALS))]),
            parameters=parameters,
            reference=system.reference,
            duration=settings.duration,
            tolerance=settings.tolerance,
            plant_order=self.loop.n,
            fastest_pole=system.controller.coordinates.fastest_pole,
            max_state=settings.max_state,
        )
        method, notes = self._choose(system)
        trajectory = self._integrator(method, settings.tolerance).integrate(problem)
        retry = _RETRY.get((method, trajectory.outcome)) if settings.integrator == "auto" else None
        if retry:
            method, reason = retry
            notes.append(f"{reason} at t = {trajectory.end:g} s; run again with {method}.")
            again = self._integrator(method, settings.tolerance).integrate(problem)
            missed = trajectory.outcome is Outcome.kink_missed
            trajectory = again if missed or again.end >= trajectory.end else trajectory
        inputs = partial(self._inputs, system, parameters)
        smooth = method == "taylor" or not self._kinked
        return Run(system, trajectory, inputs, tuple(notes), smooth)

    def _accept(self, system: System | None) -> System:
        if system is None or system is self.system:
            return self.system
        mine = self.system
        same = (
            system.plant == mine.plant
            and type(system.law) is type(mine.law)
            and system.controller.equations == mine.controller.equations
            and system.reference == mine.reference
            and _same_form(system.truth, mine.truth)
        )
        if (not same and close_loop(system) != self.loop) or not self._same_implementation(
            system, same
        ):
            raise InputError(
                "system", "has another structure than the compiled one", remedy="Make a Simulator"
            )
        return system

    def _same_implementation(self, system: System, same: bool) -> bool:
        """Whether the compiled loop serves the implementation of `system`."""
        if self._sampled is None or system.implementation is None:
            return self._sampled is None and system.implementation is None
        unchanged = same and system.implementation == self.system.implementation
        return unchanged or sample_loop(system) == self._sampled.loop

    def _choose(self, system: System) -> tuple[str, list[str]]:
        """Method for `system`, and why if it is not the usual one."""
        wanted = system.settings.integrator
        if wanted != "auto":
            if wanted == "taylor" and not available():
                raise InputError(
                    "simulation.integrator",
                    "the Taylor method needs heyoka, which is not installed",
                    remedy="Use scipy, or install heyoka (conda-forge has it for all systems)",
                )
            return wanted, []
        fastest = system.controller.coordinates.fastest_pole
        slowest = system.controller.coordinates.slowest_pole
        if fastest * system.settings.duration > STIFF and fastest > 1e3 * slowest:
            return "implicit", [
                f"The design is stiff (fastest error pole {fastest:.3g} /s): implicit method used."
            ]
        if any(rate.has(*BRANCHING) for rate in self.loop.rates):
            return "scipy", [
                "asin, acos, atan2, tan have branch points unseen by Taylor steps: SciPy."
            ]
        if not available():
            warnings.warn(
                "heyoka is not installed: using SciPy, which is about 60 times slower",
                stacklevel=3,
            )
            return "scipy", []
        return "taylor", []

    def _integrator(self, method: str, tolerance: float) -> Integrator:
        key = (method, tolerance if method == "taylor" else 0.0)
        if key not in self._integrators:
            self._integrators[key] = (
                TaylorIntegrator(self.loop, tolerance)
                if method == "taylor"
                else ScipyIntegrator(self.loop, implicit=method == "implicit")
            )
        return self._integrators[key]

    def _inputs(
        self, system: System, parameters: np.ndarray, t: np.ndarray, states: np.ndarray
    ) -> np.ndarray:
        """Control input u at times t, shape (N,)."""
        with np.errstate(all="ignore"):
            values = self._input(t, states, [*parameters.tolist(), *pieces_at(system.reference, t)])
        return rows(values, len(t))[0]


def _same_form(a: Truth, b: Truth) -> bool:
    """Whether two truths of one plant surely differ in numbers only."""
    if a.states:
        forms = [(v.states, v.rates, v.outputs, [name for name, _ in v.constants]) for v in (a, b)]
        return forms[0] == forms[1]
    return a.omega == b.omega and not b.states and not a.constants  # these may fill a coupling


#: Where the automatic choice failed: what to try next, and what to say.
_RETRY = {
    ("taylor", Outcome.undefined): (
        "scipy",
        "The solution has no Taylor series (for example sqrt at zero)",
    ),
    ("taylor", Outcome.kink_missed): ("scipy", "A kink of abs, sign, min or max was missed"),
    ("taylor", Outcome.step_limit): ("implicit", "The explicit method reached its step limit"),
}


def simulate(system: System, **settings: Any) -> Run:
    """Simulate a system once.

    Parameters
    ----------
    system : System
    **settings
        Override entries of :class:`certrack.Settings`, e.g. ``duration=5``.

    Returns
    -------
    Run
    """
    if settings:
        system = replace(system, settings=replace(system.settings, **settings))
    return Simulator(system).run()
