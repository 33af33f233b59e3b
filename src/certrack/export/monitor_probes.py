"""What the flags of a monitor must be: at golden vectors, and at and just beyond every limit.

Computed by NumPy from the conditions, for the acceptance test of a monitored controller. Where a
number that is computed lies so close to a limit that rounding decides, nothing is expected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.export.golden_vectors import GOLDEN_TOLERANCE, GoldenVectors, reference_answers
from certrack.export.monitor import (
    COMMAND_BEFORE,
    LAST_INPUT,
    Flag,
    MonitorProgram,
    Within,
)
from certrack.export.program import ControllerProgram
from certrack.loops.controller import COMMAND, LAW_INPUT
from certrack.systems.system import System

#: A flag that is up, down, or left to rounding.
DOWN, UP, UNDECIDED = 0, 1, 2

#: What is computed decides if it is so many tolerances of the golden vectors away from its limit.
CLEAR_TOLERANCES = 100.0


#: As :func:`reference_answers` returns them.
Answers = Callable[[Array, Array, Array], Array]


@dataclass(frozen=True)
class MonitorProbes:
    """Samples of an enabled controller, one column each, and its flags at them.

    Attributes
    ----------
    x, Y, states : arrays
        As of :class:`~certrack.export.golden_vectors.GoldenVectors`; each stands alone.
    before : (N,) array
        The last command.
    expected : (flags, N) array
        :data:`DOWN`, :data:`UP` or :data:`UNDECIDED`.
    """

    x: Array
    Y: Array
    states: Array
    before: Array
    expected: Array


def monitor_probes(
    system: System,
    program: ControllerProgram,
    monitor: MonitorProgram,
    vectors: GoldenVectors,
    real: str,
) -> MonitorProbes:
    """Probes for a monitor: the golden vectors, then both sides of every limit of an input."""
    edges = _edges(program, monitor, "float32" if real == "float" else "float64")
    x, Y, states = (
        np.concatenate([part, edge], axis=1)
        for part, edge in zip((vectors.x, vectors.Y, vectors.states), edges, strict=True)
    )
    before = np.full(x.shape[1], monitor.off)
    if LAST_INPUT in program.states:
        before = states[program.states.index(LAST_INPUT)]
    bounds = np.array(monitor.reference_bounds)[:, None]
    followed = np.clip(Y, -bounds, bounds) if monitor.limit_reference else Y
    answers = reference_answers(system, program)(x, followed, states)
    asked = _law_input(system, program)(x, followed, states)[0]
    given = [*x, *Y, *answers[1:], answers[0], before]
    values, share = _premise_values(program, given), CLEAR_TOLERANCES * GOLDEN_TOLERANCE[real]
    expected = [_expected(flag, monitor.flags, values, asked, share) for flag in monitor.flags]
    good = np.isfinite(answers).all(axis=0)
    return MonitorProbes(
        x[:, good], Y[:, good], states[:, good], before[good], np.array(expected)[:, good]
    )


def _edges(program: ControllerProgram, monitor: MonitorProgram, kind: str) -> list[Array]:
    """x, Y and states at the start: at rest but for one input, at a limit or just beyond it."""
    inputs = (*program.measured, *program.Y)
    points = []
    for premise in (premise for flag in monitor.flags for premise in flag.premises):
        if premise.value not in inputs:
            continue
        number = np.dtype(kind).type
        low, high = number(premise.low), number(premise.high)
        infinity = number(np.inf)
        for value in (low, np.nextafter(low, -infinity), high, np.nextafter(high, infinity)):
            point = np.zeros(len(inputs))
            point[inputs.index(premise.value)] = float(value)
            points.append(point)
    table = np.array(points).T
    start = np.repeat(np.array(program.start)[:, None], len(points), axis=1)
    return [table[: len(program.measured)], table[len(program.measured) :], start]


def _law_input(system: System, program: ControllerProgram) -> Answers:
    """The input that the law asks for, as :func:`reference_answers` gives u."""
    steps = (*program.controller.steps[:-1], (COMMAND, LAW_INPUT))
    unlimited = replace(program.controller, steps=steps)
    return reference_answers(system, replace(program, controller=unlimited))


def _expected(
    flag: Flag, flags: Sequence[Flag], values: Callable[[Within], Array], asked: Array, share: float
) -> Array:
    """The flag at every probe; `share` of a limit is what rounding may move."""
    up, decided = np.zeros(len(asked), dtype=bool), np.ones(len(asked), dtype=bool)
    for premise in flag.premises:
        value, low, high = values(premise)
        inside = (value > low) & (value < high)
        up |= ~(inside if premise.strict else (value >= low) & (value <= high))
        if flag.of_command:  # u may be what the law asks for, or any of the limits
            others = [other for other in flags if other.of_command and other is not flag]
            limits = [values(each)[1:] for other in others for each in other.premises]
            computed = np.concatenate([asked[None], *limits])
        else:
            computed = value[None] if not premise.value.is_Symbol else np.empty((0, len(asked)))
        for limit in (low, high):
            decided &= (np.abs(computed - limit) > share * (1 + np.abs(limit))).all(axis=0)
    return np.where(decided, np.where(up, UP, DOWN), UNDECIDED)


def _premise_values(program: ControllerProgram, given: Sequence[Array]) -> Callable[..., Array]:
    """Value, low and high of a condition at every probe."""
    names: list[sympy.Symbol] = [*program.measured, *program.Y, *program.states]
    names += [COMMAND, COMMAND_BEFORE, *program.parameters]
    count = len(given[0])
    constants = [np.full(count, program.constants[c]) for c in program.parameters]

    def values(premise: Within) -> Array:
        formulas = (premise.value, premise.low, premise.high)
        numbers = list(set().union(*(formula.atoms(sympy.Float) for formula in formulas)))
        places = [symbol(f"number_{i}") for i in range(len(numbers))]  # code rounds numbers
        replaced = [f.xreplace(dict(zip(numbers, places, strict=True))) for f in formulas]
        function = numpy_callable([[*names, *places]], replaced)
        exact = [np.full(count, float(number)) for number in numbers]
        with np.errstate(all="ignore"):
            return rows(function([*given, *constants, *exact]), count)

    return values
