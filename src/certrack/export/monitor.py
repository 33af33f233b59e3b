"""The premises of a certificate, watched on the drive: one description for C, FMUs and ST.

A bound is proven for references within their bounds, an input that is nowhere limited, states
within the proven box and the gains of the design. A flag goes up where one of these does not hold,
for the sample at hand and, while the controller is enabled, latched until somebody has seen it.
Here is what a flag watches, what a controller does while it is disabled, and what a reset sets; the
languages print it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.keys import set_fields
from certrack.core.rationals import exact_rational
from certrack.core.spelling import hint
from certrack.export.program import ControllerProgram, controller_program, sampled_system
from certrack.loops.controller import COMMAND, SAMPLE_NUMBER, differenced
from certrack.systems.system import System

#: The command of the sample before.
COMMAND_BEFORE = symbol("ctl_u_before")

#: What the rate limit remembers of it.
LAST_INPUT = symbol("ctl_u_last")

#: The names of the flags that are no condition on a number.
HELD, PARAMETERS_CHANGED = "held", "parameters_changed"


@dataclass(frozen=True)
class Monitor:
    """What an exported controller has besides its law, on a drive.

    The controller can then be enabled and disabled, its estimates can be reset, and flags tell
    which premise of its certificate does not hold: a reference beyond its bounds, a limited input,
    a state outside of the box, a sample that was held, parameters that were changed.

    Parameters
    ----------
    box : mapping of names of states to pairs (low, high), optional
        The box of states within which the certificate was proven; states that are left out are not
        watched. Of a state that is not measured the value by differences is.
    limit_reference : bool
        Limit y_d and each derivative to its bound. What is limited is no longer the derivative of
        what stands before it, so the flag stays up: this keeps the input small, and proves nothing.
    parameters : bool
        Gains are parameters at run time, with the values of the design to begin with.

    Raises
    ------
    InputError

    Examples
    --------
    >>> import certrack
    >>> certrack.Monitor(box={"x1": (-1, "1/3")}).box
    (('x1', (-1.0, 0.3333333333333333)),)
    """

    box: Any = ()
    limit_reference: bool = False
    parameters: bool = False

    def __post_init__(self) -> None:
        pairs = checks.name_value_pairs("monitor.box", self.box)
        box = tuple((name, _interval(f"monitor.box.{name}", ends)) for name, ends in pairs)
        for key in ("limit_reference", "parameters"):
            if not isinstance(getattr(self, key), bool):
                raise InputError(f"monitor.{key}", "must be True or False", getattr(self, key))
        set_fields(self, box=box)


def _interval(key: str, ends: Any) -> tuple[float, float]:
    """Two ends, of which the texts keep their rationals; irrational ends are rounded inward."""
    low, high = checks.sequence(key, ends, 2, "[low, high]")
    pair = checks.real(f"{key}[0]", low, side=1), checks.real(f"{key}[1]", high, side=-1)
    if not exact_rational(pair[0]) < exact_rational(pair[1]):
        raise InputError(key, "low must be less than high", checks.as_written([low, high]))
    return pair


@dataclass(frozen=True)
class Within:
    """The condition low <= value <= high, or low < value < high.

    Its formulas are of the inputs, the states after the sample, ``COMMAND`` and ``COMMAND_BEFORE``;
    it does not hold for what is not a number.
    """

    value: sympy.Expr
    low: sympy.Expr
    high: sympy.Expr
    strict: bool = False


@dataclass(frozen=True)
class Flag:
    """What is true as long as a premise does not hold.

    Attributes
    ----------
    name, meaning : str
    premises : conditions
        The flag is up where one of them does not hold; none for a sample that was held.
    of_command : bool
        Judged only while the controller is enabled.
    always : bool
        Judged at samples that were held, too; at these nothing else but ``held`` is up.
    """

    name: str
    meaning: str
    premises: tuple[Within, ...] = ()
    of_command: bool = False
    always: bool = False


@dataclass(frozen=True)
class MonitorProgram:
    """What a monitored controller does besides its law.

    Attributes
    ----------
    flags : flags
        ``held`` is the first one.
    reference_bounds : floats
        Y_i as numbers of the type, rounded up.
    limit_reference : bool
    off : float
        The command while the controller is disabled: the system's initial input.
    disabled : mapping
        States that do not go on while the controller is disabled, and what they are then: None
        for those that stand still. All others (differences, filters) go on. The last input is
        `off` then, as before the first sample; the time of a law begins anew.
    restarted : mapping
        States that a reset of the estimates sets, and their numbers.
    """

    flags: tuple[Flag, ...]
    reference_bounds: tuple[float, ...]
    limit_reference: bool
    off: float
    disabled: dict[sympy.Symbol, float | None]
    restarted: dict[sympy.Symbol, float]


def wanted_parameters(monitor: Any) -> bool:
    """Whether a monitor, if there is one, wants gains as parameters at run time.

    Raises
    ------
    InputError
        If it is something else.
    """
    if monitor is not None and not isinstance(monitor, Monitor):
        raise InputError("monitor", "must be a Monitor", monitor, "certrack.Monitor makes one")
    return monitor is not None and monitor.parameters


def monitor_program(
    monitor: Monitor, system: System, program: ControllerProgram, real: str = "double"
) -> MonitorProgram:
    """The monitor of a program whose numbers have the type `real`.

    Raises
    ------
    InputError
        If the box has a state that the plant has not, or a bound is not finite.
    """
    implementation = system.implementation
    assert implementation is not None
    controller, start = program.controller, dict(zip(program.states, program.start, strict=True))
    bounds = tuple(
        rounded_to_type(value, real, up=True)
        for value in system.reference.bounds(len(program.Y) - 1).values
    )
    going_on = set(system.controller.equations.filters)
    still: dict[sympy.Symbol, float | None] = dict.fromkeys(
        z for z in controller.estimates if z not in going_on
    )
    anew = {name: start[name] for name in (SAMPLE_NUMBER, LAST_INPUT) if name in start}
    return MonitorProgram(
        flags=tuple(_flags(monitor, system, program, bounds, real)),
        reference_bounds=bounds,
        limit_reference=monitor.limit_reference,
        off=implementation.initial_input,
        disabled=still | anew,
        restarted={z: start[z] for z in still},
    )


def _flags(
    monitor: Monitor,
    system: System,
    program: ControllerProgram,
    bounds: tuple[float, ...],
    real: str,
) -> Iterator[Flag]:
    yield Flag(HELD, "an input, the answer or the next state was not finite: all was held")
    for i, (y, bound) in enumerate(zip(program.Y, bounds, strict=True)):
        name = f"y_d_{i}" if i else "y_d"
        number = sympy.Float(bound)
        meaning = f"|{name}| is above {bound!r}, its bound Y_{i}"
        yield Flag(f"{name}_exceeded", meaning, (Within(y, -number, number),))
    numbers = {symbol.name: sympy.Float(value) for symbol, value in program.constants.items()}
    if "ctl_u_low" in numbers:
        limits = numbers["ctl_u_low"], numbers["ctl_u_high"]
        inside = Within(COMMAND, *limits, strict=True)
        yield Flag("saturated", "u is at a limit", (inside,), of_command=True)
    if "ctl_u_step" in numbers:
        step = numbers["ctl_u_step"]
        inside = Within(COMMAND, COMMAND_BEFORE - step, COMMAND_BEFORE + step, strict=True)
        yield Flag("rate_limited", "u changes at its limit", (inside,), of_command=True)
    for state, (low, high) in monitor.box:
        value = _value_of(state, system, program)
        ends = rounded_to_type(low, real, up=True), rounded_to_type(high, real, up=False)
        yield Flag(
            f"{state}_outside",
            f"{state} is outside of [{ends[0]!r}, {ends[1]!r}]",
            (Within(value, *map(sympy.Float, ends)),),
        )
    if program.parameters:
        values = [sympy.Float(program.constants[name]) for name in program.parameters]
        same = zip(program.parameters, values, values, strict=True)
        meaning = "a parameter is not that of the certificate"
        yield Flag(PARAMETERS_CHANGED, meaning, tuple(Within(*each) for each in same), always=True)


def _value_of(state: str, system: System, program: ControllerProgram) -> sympy.Expr:
    """What the controller takes for a state, of the inputs and the states after the sample."""
    names = system.plant.states
    if state not in names:
        remedy = f"{hint(state, names)}States are {', '.join(names)}"
        raise InputError(f"monitor.box.{state}", "is no state of the plant", remedy=remedy)
    value: sympy.Expr = program.measured[names.index(state)]
    assert system.implementation is not None
    if state not in system.implementation.velocity:
        return value
    known: dict[sympy.Symbol, sympy.Expr] = {
        name: sympy.Float(number) for name, number in program.constants.items()
    }
    for name in names:  # the next speed is the filtered difference of this sample
        known[symbol(f"ctl_filtered_{name}")] = symbol(f"ctl_speed_{name}")
    for name, formula in program.controller.steps:
        known[name] = known.get(name, formula.xreplace(known))
    return known[differenced(state)]


def rounded_to_type(value: float, real: str, *, up: bool) -> float:
    """The number of the type that lies just above, or below, what `value` stands for.

    Raises
    ------
    InputError
        If the type has none.
    """
    if not math.isfinite(value):
        raise InputError("monitor", "needs finite bounds", value, "State reference.bounds")
    kind = np.float32 if real == "float" else np.float64
    exact, side = exact_rational(value), math.inf if up else -math.inf
    with np.errstate(over="ignore"):
        near = kind(value)
    if not np.isfinite(near):
        raise InputError("--real", f"float cannot hold the number {value:g}", remedy="Use double")
    while (Fraction(float(near)) < exact) if up else (Fraction(float(near)) > exact):
        near = np.nextafter(near, kind(side))
    return float(near)


def default_parameters(system: System, *, period: float | None = None) -> dict[str, float]:
    """The run-time parameters of an exported controller, with the values of the design.

    Those of a system with other gains are what has to be sent to a drive that runs the code of
    `system`: a complete and consistent set, made as that of the code was.

    Parameters
    ----------
    system : System
    period : float > 0, s, optional
        Instead of that of the implementation; needed if the system has none.

    Returns
    -------
    dict
        Name in the exported program and value. Coefficients that are zero are none.

    Raises
    ------
    InputError
        If there is no period.

    Examples
    --------
    >>> import certrack
    >>> from certrack.export.monitor import default_parameters
    >>> default_parameters(certrack.load("example1"), period=0.001)["leak_gain"]
    0.6
    """
    program = controller_program(sampled_system(system, period), parameters=True)
    return {program.labels[name]: program.constants[name] for name in program.parameters}
