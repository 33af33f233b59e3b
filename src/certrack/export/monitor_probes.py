"""What the flags of a monitor must be: at golden vectors, and at and just beyond every limit.

Computed by NumPy from the conditions, for the acceptance test of a monitored controller. Where a
number that is computed lies so close to a limit that rounding decides, nothing is expected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.export.golden_vectors import (
    GOLDEN_TOLERANCE,
    MUTATION,
    GoldenVectors,
    reference_answers,
)
from certrack.export.monitor import (
    COMMAND_BEFORE,
    LAST_INPUT,
    Flag,
    MonitorProgram,
    Within,
)
from certrack.export.program import ControllerProgram
from certrack.loops.controller import COMMAND, FIRST, LAW_INPUT
from certrack.systems.system import System

#: A flag that is up, down, or left to rounding.
DOWN, UP, UNDECIDED = 0, 1, 2

#: What is computed decides if it is so many tolerances of the golden vectors away from its limit.
CLEAR_TOLERANCES = 10.0

#: A speed beside its limit is off by this part of it, less than the error that must be noticed; and
#: of a limit near zero as if it were of this size.
SPEED_MARGIN, LEAST_SPEED_LIMIT = MUTATION / 2, 1e-3

#: A reference that is limited is so many times its bound: far enough to show in u.
BEYOND_BOUND = 1.5

#: How the names of a speed and of the position before begin.
SPEED, BEFORE = "ctl_speed_", "ctl_before_"

#: As :func:`reference_answers` returns them.
Answers = Callable[[Array, Array, Array], Array]

#: x, Y and states, one column per sample.
Inputs = tuple[Array, Array, Array]


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
    """Probes for a monitor: the golden vectors, then both sides of every limit."""
    kind = "float32" if real == "float" else "float64"

    def samples(*inputs: Array) -> _Samples:
        return _Samples(
            system, program, monitor, *(part.astype(kind).astype(float) for part in inputs)
        )

    golden = samples(vectors.x, vectors.Y, vectors.states)
    parts = [
        (golden.x, golden.Y, golden.states),
        _input_edges(program, monitor, kind),
        *_speed_edges(program, monitor, samples),
        *_rate_edges(program, golden),
        *_limited_references(program, monitor, golden, samples),
    ]
    joined = (np.concatenate(rows_of, axis=1) for rows_of in zip(*parts, strict=True))
    probes = samples(*joined)
    expected = np.array([_expected(flag, monitor.flags, probes, real) for flag in monitor.flags])
    good = np.isfinite(probes.answers).all(axis=0)
    x, Y, states = (part[:, good] for part in (probes.x, probes.Y, probes.states))
    return MonitorProbes(x, Y, states, probes.before[good], expected[:, good])


class _Samples:
    """Samples, one column each, what the controller answers, and what the conditions compare."""

    def __init__(
        self,
        system: System,
        program: ControllerProgram,
        monitor: MonitorProgram,
        x: Array,
        Y: Array,
        states: Array,
    ) -> None:
        self.x, self.Y, self.states = x, Y, states
        self.before = np.full(x.shape[1], monitor.off)
        if LAST_INPUT in program.states:
            self.before = states[program.states.index(LAST_INPUT)]
        bounds = np.array(monitor.reference_bounds)[:, None]
        followed = np.clip(Y, -bounds, bounds) if monitor.limit_reference else Y
        self.answers = reference_answers(system, program)(x, followed, states)
        self.asked = _law_input(system, program)(x, followed, states)[0]
        self._names: list[sympy.Symbol] = [*program.measured, *program.Y, *program.states]
        self._names += [COMMAND, COMMAND_BEFORE, *program.parameters]
        self._values = [*x, *Y, *self.answers[1:], self.answers[0], self.before]
        self._values += [np.full(x.shape[1], program.constants[c]) for c in program.parameters]

    def values(self, premise: Within) -> Array:
        """Value, low and high of a condition at every sample."""
        formulas, count = (premise.value, premise.low, premise.high), self.x.shape[1]
        numbers = list(set().union(*(formula.atoms(sympy.Float) for formula in formulas)))
        places = [symbol(f"number_{i}") for i in range(len(numbers))]  # code rounds numbers
        replaced = [f.xreplace(dict(zip(numbers, places, strict=True))) for f in formulas]
        function = numpy_callable([[*self._names, *places]], replaced)
        exact = [np.full(count, float(number)) for number in numbers]
        with np.errstate(all="ignore"):
            return rows(function([*self._values, *exact]), count)


def _input_edges(program: ControllerProgram, monitor: MonitorProgram, kind: str) -> Inputs:
    """At the start, at rest but for one input: at a limit or just beyond it."""
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
    return table[: len(program.measured)], table[len(program.measured) :], start


def _speed_edges(
    program: ControllerProgram, monitor: MonitorProgram, samples: Callable[..., _Samples]
) -> Iterator[Inputs]:
    """All states 1, and the position one sample ago such that a speed lies beside its limit.

    The speed is affine in that position.
    """
    n, m, states = len(program.measured), len(program.Y), program.states
    for premise in (premise for flag in monitor.flags for premise in flag.premises):
        speeds = [s.name for s in states if s in premise.value.free_symbols]
        speeds = [name for name in speeds if name.startswith(SPEED)]
        if not speeds:
            continue
        place = states.index(symbol(speeds[-1].replace(SPEED, BEFORE)))

        def at(positions: Sequence[float], place: int = place) -> Inputs:
            states_before = np.repeat(np.array(program.start)[:, None], len(positions), axis=1)
            states_before[states.index(FIRST)], states_before[place] = 0.0, positions
            return np.ones((n, len(positions))), np.zeros((m, len(positions))), states_before

        (zero, one), (low, _), (high, _) = samples(*at([0.0, 1.0])).values(premise)
        wanted = [
            end + side * max(abs(end), LEAST_SPEED_LIMIT) * SPEED_MARGIN
            for end in (low, high)
            for side in (-1, 1)
        ]
        yield at([(value - zero) / (one - zero) for value in wanted])


def _rate_edges(program: ControllerProgram, golden: _Samples) -> Iterator[Inputs]:
    """A golden vector whose last command lies far above, or below, what the law asks for."""
    if LAST_INPUT not in program.states:
        return
    k = int(np.argmin(np.abs(golden.asked)))
    states = np.repeat(golden.states[:, [k]], 2, axis=1)
    far = 3 * program.constants[symbol("ctl_u_step")]
    states[program.states.index(LAST_INPUT)] = golden.asked[k] + np.array([-far, far])
    yield np.repeat(golden.x[:, [k]], 2, axis=1), np.repeat(golden.Y[:, [k]], 2, axis=1), states


def _limited_references(
    program: ControllerProgram,
    monitor: MonitorProgram,
    golden: _Samples,
    samples: Callable[..., _Samples],
) -> Iterator[Inputs]:
    """Golden vectors with a derivative beyond its bound, where the bound decides on u."""
    commands = [p for flag in monitor.flags if flag.of_command for p in flag.premises]
    saturation = [p for p in commands if COMMAND_BEFORE not in p.low.free_symbols]
    for i, bound in enumerate(monitor.reference_bounds if monitor.limit_reference else ()):
        for side in (-1, 1):

            def asked(part: float, i: int = i, value: float = side * bound) -> _Samples:
                Y = golden.Y.copy()
                Y[i] = part * value
                return samples(golden.x, Y, golden.states)

            at_bound, beyond = asked(1.0), asked(BEYOND_BOUND)
            effect = np.abs(at_bound.asked - asked(1.0 - MUTATION).asked)
            for premise in saturation:
                value = at_bound.asked
                effect[(value <= float(premise.low)) | (value >= float(premise.high))] = 0.0
            k = int(np.argmax(np.nan_to_num(effect)))
            states = beyond.states[:, [k]].copy()
            if LAST_INPUT in program.states:
                states[program.states.index(LAST_INPUT)] = at_bound.asked[k]
            yield golden.x[:, [k]], beyond.Y[:, [k]], states


def _law_input(system: System, program: ControllerProgram) -> Answers:
    """The input that the law asks for, as :func:`reference_answers` gives u."""
    steps = (*program.controller.steps[:-1], (COMMAND, LAW_INPUT))
    unlimited = replace(program.controller, steps=steps)
    return reference_answers(system, replace(program, controller=unlimited))


def _expected(flag: Flag, flags: Sequence[Flag], probes: _Samples, real: str) -> Array:
    """The flag at every sample."""
    asked, tolerance = probes.asked, GOLDEN_TOLERANCE[real]
    up, decided = np.zeros(len(asked), dtype=bool), np.ones(len(asked), dtype=bool)
    for premise in flag.premises:
        value, low, high = probes.values(premise)
        inside = (value > low) & (value < high)
        up |= ~(inside if premise.strict else (value >= low) & (value <= high))
        computed = np.empty((0, len(asked)))
        if flag.of_command:  # u may be what the law asks for, or any of the limits
            others = [other for other in flags if other.of_command and other is not flag]
            limits = [probes.values(each)[1:] for other in others for each in other.premises]
            computed = np.concatenate([asked[None], *limits])
        elif not premise.value.is_Symbol:
            computed = value[None]
        for limit in (low, high):
            clear = CLEAR_TOLERANCES * tolerance * (1 + np.abs(limit))
            decided &= (np.abs(computed - limit) > clear).all(axis=0)
    return np.where(decided, np.where(up, UP, DOWN), UNDECIDED)
