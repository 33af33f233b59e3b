"""One run as the optimum needs it: the plant as it really is, its reference, and what the law does.

An optimum is compared with a run of the law from the same start, under the same disturbance, and
the search begins with that run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.casadi_forms import casadi_callable
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable
from certrack.core.progress import Progress
from certrack.integrators.base import Outcome
from certrack.laws.plant_coordinates import output_derivatives
from certrack.loops.continuous import close_loop, parameter_values
from certrack.loops.plant import INPUT, SimulatedPlant, measured, plant_values, simulated_plant
from certrack.loops.schedule import make_schedule
from certrack.loops.time_switches import switched_loop
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.optimal.goal import TrajectoryCost
from certrack.systems.system import System


@dataclass(frozen=True)
class LawRun:
    """A plant with its start and reference over a horizon, and what a law does there.

    Attributes
    ----------
    run : Run
        The law's own, up to the horizon.
    plant : SimulatedPlant
    law : TrajectoryCost
        What that run costs.
    breaks : (K,) array, s
        Where reference or disturbance have a kink or a jump in time.
    """

    run: Run
    plant: SimulatedPlant
    law: TrajectoryCost
    breaks: Array

    @property
    def system(self) -> System:
        """Whose simulation ends at the horizon."""
        return self.run.system

    @property
    def horizon(self) -> float:
        """End of the run, s."""
        return self.system.settings.duration

    @property
    def start(self) -> Array:
        """States at t = 0."""
        return np.array(self.system.settings.x0)

    def distance(self) -> float:
        """Largest of |y^(i) - y_d^(i)|, i < n, at the start, without w."""
        plant = self.system.plant
        start = measured(self.system, self.start[:, None])[:, 0]
        Y = self.system.reference.values(np.zeros(1), plant.n - 1)[:, 0]
        return float(np.abs(output_derivatives(plant) @ start - Y).max())

    def states(self, t: Array) -> Array:
        """States of the simulated plant in the law's run at times, shape (S, N)."""
        return self.run.trajectory.interpolate(t)[: self.plant.n]

    def inputs(self, t: Array) -> Array:
        """The law's input at times, shape (N,)."""
        return self.run.input_of(t, self.run.trajectory.interpolate(t))

    def reference(self, t: Array) -> Array:
        """y_d at times, in a row."""
        return self.system.reference.values(t, 0)

    def rates(self) -> Callable[[float, Array, float], list[Any]]:
        """x' = f(t, x, u) in floats."""
        return numpy_callable([TIME, self.plant.states, INPUT], self._numeric(self.plant.rates))

    def output(self) -> Callable[[Array], list[Any]]:
        """The measured output x_1 in floats."""
        return numpy_callable([self.plant.states], self._numeric(self.plant.outputs[:1]))

    def rates_in_casadi(self, module: Any) -> Callable[..., list[Any]]:
        """f(t, x, u) of CasADi's symbols."""
        formulas = self._numeric(self.plant.rates)
        return casadi_callable(module, [TIME, self.plant.states, INPUT], formulas)

    def outputs_in_casadi(self, module: Any) -> Callable[..., list[Any]]:
        """The measured states, of CasADi's symbols of x."""
        return casadi_callable(module, [self.plant.states], self._numeric(self.plant.outputs))

    def _numeric(self, formulas: Any) -> list[Any]:
        """The plant's formulas with its numbers."""
        numbers = plant_values(self.plant, self.system).tolist()
        known = dict(zip(self.plant.parameters, numbers, strict=True))
        return [formula.xreplace(known) for formula in formulas]


def law_run_of(system: System, horizon: float | None, progress: Progress) -> LawRun:
    """Run the law of a system up to a horizon.

    Parameters
    ----------
    system : System
    horizon : float, optional, s
        Default: the duration of its simulation.
    progress : callable

    Raises
    ------
    InputError
        Where the law's run does not reach the horizon.
    """
    if horizon is not None:
        system = system.with_settings(duration=horizon)
    run = simulate(system, progress=progress)
    if run.outcome is not Outcome.finished:
        raise InputError(
            "horizon",
            f"the law's own run ends before it: {run.message}",
            system.settings.duration,
            "An optimum is searched around that run: shorten the horizon or mend the design",
        )
    metrics = run.metrics
    law = TrajectoryCost(
        metrics.integral_squared_error,
        metrics.input_energy,
        metrics.peak_input,
        metrics.settling_time,
    )
    return LawRun(run, simulated_plant(system), law, _breaks(system))


def _breaks(system: System) -> Array:
    """Times inside of the run at which reference or disturbance may jump, s."""
    loop = close_loop(system)
    numbers = dict(zip(loop.parameters, parameter_values(loop, system).tolist(), strict=False))
    settings = system.settings
    _, switches = switched_loop(loop)
    schedule = make_schedule(
        system.reference, switches, numbers, settings.duration, settings.tolerance
    )
    return schedule.breaks(0.0, settings.duration)
