"""The system as blocks of python-control: plant, controller, reference, and the loop they make.

python-control does not mix continuous and discrete time. Without an implementation all blocks are
continuous; with one all have its period T as time step: the controller as it runs every T, and the
plant, with actuator and sensors, by its solution from one sample to the next. Every block is a pure
function of time, state and input; what acts later (a delay) or happened before is part of a state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import CertrackError, MissingExtra
from certrack.core.expressions import TIME, symbol
from certrack.core.lowering import numpy_callable
from certrack.integrators.sampled.events import event_timeline
from certrack.integrators.sampled.run import SampledProblem, SampledRun, sensed
from certrack.laws.baselines.mpc import require_formula
from certrack.loops.controller import (
    SampledController,
    resolved,
    sampled_controller,
    starting_state,
)
from certrack.loops.controller_values import controller_values
from certrack.loops.plant import INPUT, plant_values, simulated_plant
from certrack.loops.sampled import loop_values
from certrack.model.implementation import Implementation
from certrack.model.noise import keys
from certrack.simulation.sampled import SampledSimulator
from certrack.systems.system import System, require_system

#: A time this close before a break of the reference, relatively, is the break: what rounding does
#: to a multiple of the period.
BREAK_TOLERANCE = 1e-12


@dataclass(frozen=True)
class ControlBlocks:
    """A system for python-control; all blocks are ``control.NonlinearIOSystem``.

    Attributes
    ----------
    plant
        From ``u`` to the measured states, which bear their names.
    controller
        From the measured states and ``y_d``, ``y_d_1`` ... (the reference and its derivatives) to
        ``u``; its states are the estimates and what else a sampled controller keeps.
    reference
        Without input, to ``y_d``, ``y_d_1`` ...
    loop
        The three joined; without input, to the measured states, ``u`` and ``y_d``.
    X0 : array
        Initial state of `loop`: that of the plant, then that of the controller.
    start : float, s
        When `X0` holds: zero, or the time of the first sample.
    """

    plant: Any
    controller: Any
    reference: Any
    loop: Any
    X0: Array
    start: float


def to_control(system: System) -> ControlBlocks:
    """The system as blocks of python-control.

    Parameters
    ----------
    system : System
        With an implementation the blocks are discrete, else continuous.

    Returns
    -------
    ControlBlocks

    Raises
    ------
    MissingExtra
        If python-control is not installed.
    CertrackError
        Also by the plant's block, where its solution leaves ``simulation.max_state``.

    Examples
    --------
    >>> import certrack
    >>> blocks = certrack.to_control(certrack.load("example1"))
    >>> blocks.loop.output_labels
    ['x1', 'x2', 'u', 'y_d']
    """
    try:
        import control
    except ImportError:
        raise MissingExtra("python-control", "control", "to_control") from None
    require_system(system)

    implementation, x = system.implementation, list(system.plant.states)
    Y = ["y_d", *(f"y_d_{i}" for i in range(1, len(system.controller.signals.Y)))]
    start, dt = (
        (0.0, 0.0) if implementation is None else (implementation.offset, implementation.period)
    )

    def block(name: str, parts: _BlockFunctions, inputs: list[str], outputs: list[str]) -> Any:
        return control.nlsys(
            parts.update if parts.states else None,
            parts.output,
            name=name,
            inputs=inputs or 0,
            states=parts.states or None,
            outputs=outputs,
            dt=dt,
        )

    if implementation is None:
        plant_parts, controller_parts = _continuous_blocks(system)
    else:
        plant_parts, controller_parts = _discrete_blocks(system, implementation)
    plant = block("plant", plant_parts, ["u"], x)
    controller = block("controller", controller_parts, [*x, *Y], ["u"])
    reference = block("reference", _reference_block(system), [], Y)
    loop = control.interconnect(
        [plant, controller, reference],
        name="loop",
        connections=[
            ["plant.u", "controller.u"],
            *([f"controller.{name}", f"plant.{name}"] for name in x),
            *([f"controller.{name}", f"reference.{name}"] for name in Y),
        ],
        inplist=[],
        outlist=[*(f"plant.{name}" for name in x), "controller.u", "reference.y_d"],
        outputs=[*x, "u", "y_d"],
    )
    X0 = np.concatenate([plant_parts.start, controller_parts.start])
    return ControlBlocks(plant, controller, reference, loop, X0, start)


@dataclass(frozen=True)
class _BlockFunctions:
    """Rates or next states, and outputs: functions of time, state, input and unused parameters."""

    states: list[str]
    start: Array
    update: Callable[[float, Array, Array, Any], Array]
    output: Callable[[float, Array, Array, Any], Array]


def _reference_block(system: System) -> _BlockFunctions:
    reference = system.reference
    formulas = reference.formulas(len(system.controller.signals.Y) - 1)
    names = [TIME, reference.parameter_symbols, reference.piece_symbols]
    evaluate, numbers = numpy_callable(names, formulas), reference.parameter_values

    def output(t: float, _x: Array, _u: Array, _: Any) -> Array:
        pieces = reference.piece_values(t * (1 + BREAK_TOLERANCE))
        return np.array(evaluate(t, numbers, pieces), dtype=float)

    return _BlockFunctions([], np.empty(0), lambda *_: np.empty(0), output)


def _continuous_blocks(system: System) -> tuple[_BlockFunctions, _BlockFunctions]:
    """Plant and controller."""
    plant, law = simulated_plant(system), system.controller
    true = plant_values(plant, system)
    rates = numpy_callable([TIME, plant.states, [INPUT], plant.parameters], plant.rates)
    outputs = numpy_callable([plant.states, plant.parameters], plant.outputs)

    names, numbers = [*law.symbols], [*law.values]
    for name, value in system.plant.constant_values.items():
        names.append(symbol(name))
        numbers.append(float(value))
    arguments = [TIME, law.states, [*law.signals.x, *law.signals.Y], names]
    as_applied = {law.signals.applied: law.equations.u}
    rates_of_law = [rate.xreplace(as_applied) for _, rate in law.equations.update]
    update = numpy_callable(arguments, rates_of_law)
    u = numpy_callable(arguments, [law.equations.u])
    return (
        _BlockFunctions(
            [state.name for state in plant.states],
            np.array(system.settings.x0),
            lambda t, x, u, _: np.array(rates(t, x, u, true), dtype=float),
            lambda _t, x, _u, _: np.array(outputs(x, true), dtype=float),
        ),
        _BlockFunctions(
            [state.name for state in law.states],
            np.array(system.estimates),
            lambda t, z, inputs, _: np.array(update(t, z, inputs, numbers), dtype=float),
            lambda t, z, inputs, _: np.array(u(t, z, inputs, numbers), dtype=float),
        ),
    )


def _discrete_blocks(
    system: System, implementation: Implementation
) -> tuple[_BlockFunctions, _BlockFunctions]:
    """Plant and controller."""
    require_formula(system.law, implementation, "block")
    controller = sampled_controller(system.plant, system.controller, implementation)
    numbers = controller_values(controller, system.plant, system.law, implementation)
    command, update = resolved(controller)
    inputs = [*controller.measured, *controller.Y]
    arguments = [controller.states, inputs, controller.parameters]
    u, after = numpy_callable(arguments, [command]), numpy_callable(arguments, update)
    block = _BlockFunctions(
        [state.name for state in controller.states],
        starting_state(controller, system.estimates, implementation),
        lambda _t, s, inputs, _: np.array(after(s, inputs, numbers), dtype=float),
        lambda _t, s, inputs, _: np.array(u(s, inputs, numbers), dtype=float),
    )
    return _SampledPlant(system, implementation, controller).block(), block


class _SampledPlant:
    """The plant from sample to sample.

    A command acts from `delay` periods after its sample. Its whole periods and one more for its
    fraction are states: the latest commands, the last one first.
    """

    def __init__(
        self, system: System, implementation: Implementation, controller: SampledController
    ) -> None:
        simulator = SampledSimulator(system, controller=controller, with_switches=False)
        self._system, self._implementation, self._maps = system, implementation, simulator.maps
        self._states = [state.name for state in simulator.loop.plant.states]
        self._problem = SampledProblem(
            x=np.array(system.settings.x0)[:, None],
            states=np.empty((0, 1)),
            totals=np.zeros((len(simulator.loop.totals), 1)),
            parameters=loop_values(simulator.loop, system)[:, None],
            implementation=implementation,
            timeline=event_timeline(
                implementation, implementation.period, np.empty(0), np.empty(0)
            ),  # python-control's own
            outputs=simulator.outputs,
            pieces=system.reference.piece_values,  # of what is totalled, which is not used
            keys=keys(implementation.seed, implementation.stream, 1),
            tolerance=system.settings.tolerance,
            max_state=system.settings.max_state,
            surfaces=simulator.surfaces,
        )
        self._p = SampledRun(simulator.maps, self._problem).parameters
        whole_periods = math.floor(implementation.run_delay)
        self._fraction = implementation.run_delay - whole_periods
        self._commands = whole_periods + (self._fraction > 0)

    def block(self) -> _BlockFunctions:
        """Its states and functions."""
        first = self._implementation.initial_input
        x = np.array(self._system.settings.x0)
        x = self._advance(0.0, self._implementation.offset, x, first)
        command_names = [f"u_before_{i + 1}" for i in range(self._commands)]
        start = np.concatenate([x, np.full(self._commands, first)])
        return _BlockFunctions([*self._states, *command_names], start, self._update, self._output)

    def _update(self, t: float, state: Array, command: Array, _: Any) -> Array:
        """States and latest commands one period later."""
        n, T = len(self._states), self._implementation.period
        u = self._implementation.converted(command)
        commands = np.concatenate([u, state[n:]])  # the last one acts first
        x, middle, end = state[:n], t + self._fraction * T, t + T
        if self._fraction:
            x = self._advance(t, middle, x, commands[-1])
            x = self._advance(middle, end, x, commands[-2])
        else:
            x = self._advance(t, end, x, commands[-1])
        return np.concatenate([x, commands[: self._commands]])

    def _output(self, t: float, state: Array, _u: Array, _: Any) -> Array:
        """What the sensors show."""
        implementation, x = self._implementation, state[: len(self._states), None]
        true = x if self._problem.outputs is None else self._problem.outputs(x, self._p)
        errors = implementation.sensor_errors(np.array([t]))
        return sensed(
            true,
            implementation,
            self._problem.keys,
            round((t - implementation.offset) / implementation.period),
            None if errors is None else errors[:, 0],
        )[:, 0]

    def _advance(self, begin: float, end: float, x: Array, u: float) -> Array:
        """The states at the end of an interval of constant input.

        python-control takes what is not a number for an algebraic loop: better to stop here.
        """
        if begin >= end:
            return x
        run = SampledRun(self._maps, replace(self._problem, x=x[:, None]))
        run.u = np.array([u])
        if not run.advance(begin, end):
            raise CertrackError(f"stopped at t = {begin:.6g} s: {run.outcomes[0].value}")
        return run.x[:, 0]
