"""One run as the optimum needs it: the plant as it really is, its reference, and what the law does.

An optimum is compared with a run of the law from the same start, under the same disturbance, and
the search begins with that run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.casadi_forms import casadi_callable
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.kinks import kink_arguments, smoothed, without_minmax
from certrack.core.lowering import numpy_callable, rows
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
from certrack.studies.optimal.mesh import MESH_SAMPLES
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
    smoothing : float
        Width of kinks of the plant in its states, over the largest size of their arguments in the
        run; 0 for none.
    over_time : bool
        Whether kinks and jumps in time count as well: where the time itself is searched.
    """

    run: Run
    plant: SimulatedPlant
    law: TrajectoryCost
    breaks: Array
    smoothing: float = 0.0
    over_time: bool = False

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
        """x' = f(t, x, u) in floats; jumps in the states as wide as the smoothing says."""
        formulas = [self._smoothed(rate, sympy.sign) for rate in self._numeric(self.plant.rates)]
        return numpy_callable([TIME, self.plant.states, INPUT], formulas)

    def output(self) -> Callable[[Array], list[Any]]:
        """The measured output x_1 in floats."""
        return numpy_callable([self.plant.states], self._numeric(self.plant.outputs[:1]))

    def rates_in_casadi(self, module: Any) -> Callable[..., list[Any]]:
        """f(t, x, u) of CasADi's symbols."""
        return self._in_casadi(
            module, [TIME, self.plant.states, INPUT], self._numeric(self.plant.rates)
        )

    def outputs_in_casadi(self, module: Any) -> Callable[..., list[Any]]:
        """The measured states, of CasADi's symbols of x."""
        return self._in_casadi(module, [self.plant.states], self._numeric(self.plant.outputs))

    def reference_in_casadi(self, module: Any) -> Callable[..., list[Any]]:
        """y_d and its first n - 1 derivatives, of CasADi's time."""
        return self._in_casadi(module, [TIME], self._reference_formulas)

    @property
    def has_kinks(self) -> bool:
        """Whether anything is to be smoothed."""
        return bool(self._kink_sizes)

    @property
    def has_jumping_rates(self) -> bool:
        """Whether the plant's rates have a jump in its states, as dry friction has."""
        rates = map(without_minmax, self._numeric(self.plant.rates))
        jumps = set().union(*(rate.atoms(sympy.sign) for rate in rates))
        return any(jump.args[0] in self._kink_sizes for jump in jumps)

    @property
    def _reference_formulas(self) -> list[sympy.Expr]:
        reference = self.system.reference
        known = dict(zip(reference.parameter_symbols, reference.parameter_values, strict=True))
        order = self.system.plant.n - 1
        return [formula.xreplace(known) for formula in reference.formulas(order)]

    @cached_property
    def _kink_sizes(self) -> dict[sympy.Expr, float]:
        """Arguments of the kinks, and their largest sizes in the run."""
        formulas = [*self._numeric(self.plant.rates), *self._numeric(self.plant.outputs)]
        moving = {*self.plant.states, INPUT}
        if self.over_time:
            moving.add(TIME)
            formulas += self._reference_formulas
        arguments = kink_arguments(formulas, moving)
        if not arguments:
            return {}
        t = np.linspace(0.0, self.horizon, MESH_SAMPLES)
        values = numpy_callable([TIME, self.plant.states, INPUT], arguments)
        with np.errstate(all="ignore"):
            table = rows(values(t, self.states(t), self.inputs(t)), len(t))
        sizes = np.nan_to_num(np.abs(table)).max(axis=1)
        return {a: float(size) or 1.0 for a, size in zip(arguments, sizes, strict=True)}

    def _smoothed(self, formula: sympy.Expr, *kinds: type[sympy.Function]) -> sympy.Expr:
        """The formula with its kinks (of these kinds) as wide as the smoothing says."""
        if not self.smoothing:
            return formula
        widths = {argument: self.smoothing * size for argument, size in self._kink_sizes.items()}
        return smoothed(formula, widths, kinds or (sympy.Abs, sympy.sign))

    def _in_casadi(
        self, module: Any, arguments: Sequence[Any], formulas: Sequence[sympy.Expr]
    ) -> Callable[..., list[Any]]:
        return casadi_callable(module, arguments, [self._smoothed(f) for f in formulas])

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
