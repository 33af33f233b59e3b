"""Golden vectors: what the exported code must answer, and how far from it is too far.

The answers are computed in double precision from the one description of the controller, the
:class:`~certrack.loops.controller.SampledController`: some along a closed-loop run with the state
carried from sample to sample, some at points where every single number in the code shows. For a
change of 0.3 % in a number to be caught it must change an answer by more than the tolerance; from
many random points, those are taken where the numbers do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.core.printing import recognise_selection, selection_of
from certrack.export.program import ControllerProgram
from certrack.export.undecided import undecided_jumps
from certrack.integrators.sampled.maps import SampledMaps, Scalar
from certrack.loops.controller import COMMAND, FIRST, SAMPLE_NUMBER, resolved
from certrack.loops.controller_values import controller_values
from certrack.loops.sampled import SampledLoop
from certrack.simulation.sampled import SampledSimulator
from certrack.systems.system import System

#: Largest deviation over its scale.
GOLDEN_TOLERANCE = {"double": 1e-12, "float": 5e-6}

#: The error of a number in the code that must be caught, relative.
MUTATION = 3e-3

#: A number shows clearly where that error passes the tolerance by this factor.
CLEAR_FACTOR = 10.0

#: Samples whose state is carried along.
MAX_CARRIED = 40

#: Samples of the closed-loop run that they come from: enough to see it settle.
MAX_GOLDEN_SAMPLES = 2000

#: Points of that run that stand alone.
EXCERPTS = 20

#: Random points, of which those are taken where numbers show.
CANDIDATES = 4000

#: Of the numbers of a random point, so many are zero: the formulas' terms then show one by one.
ZEROS_SHARE = 0.35

#: Of the random points, so many are first samples, where differences are not known.
FIRST_SHARE = 0.1

#: A larger answer is no test: the law is far from where it works.
MAX_ANSWER = 1e12

#: Smaller answers may be lost to underflow.
MIN_SCALE = {"double": 1e-280, "float": 1e-20}

#: Relative changes that sensitivities are taken by: somewhat more than rounding.
PROBE_CHANGE = {"double": 1e-9, "float": 3e-6}

#: Part of a state's size that its scale contains: the rounding of state + rise.
STATE_SHARE = 0.05


#: Equal within the rounding of a quotient.
QUOTIENT_ROUNDING = 1e-9

#: A number of the code, and what it is multiplied by.
Change = tuple[int, float] | None

#: Answers (1 + m, N) for x, Y, states and changed numbers.
Evaluate = Callable[..., Array]


@dataclass(frozen=True)
class GoldenVectors:
    """Inputs and answers, one column per sample.

    Attributes
    ----------
    carried : int
        So many samples from the first one follow each other; the others stand alone.
    x, Y, states : arrays
        Inputs; the states of a carried sample are the answers of the one before it.
    answers : (1 + m, N) array
        u, then the next states.
    scales : (1 + m, N) array
        What a deviation is relative to: the sum of all that the answer is made of.
    blind : names
        Numbers in the code of which an error of 0.3 % would not be noticed.
    """

    carried: int
    x: Array
    Y: Array
    states: Array
    answers: Array
    scales: Array
    blind: tuple[str, ...]


def golden_vectors(
    system: System,
    program: ControllerProgram,
    real: str = "double",
    *,
    seed: int = 0,
    thin: bool = True,
) -> GoldenVectors:
    """Golden vectors of a program, for code with numbers of type `real`.

    With `thin`, only as many of the random points as it takes to see every number.

    Raises
    ------
    InputError
        If the law has no finite value anywhere.
    """
    evaluate, numbers = _perturbed_controller(system, program)
    kind = np.dtype("float32" if real == "float" else "float64")
    random = np.random.default_rng(seed)
    inputs, carried, of_run = _candidate_inputs(evaluate, system, program, kind, random)
    effects, answers, scales = _sensitivities(evaluate, len(numbers), inputs, carried, real)
    usable = np.isfinite(answers).all(axis=0) & np.isfinite(scales).all(axis=0)
    usable &= (np.abs(answers) < MAX_ANSWER).all(axis=0)
    usable &= ~_undecided(system, program, inputs, real)
    usable[:carried] &= np.logical_and.accumulate(usable[:carried])
    effects = np.where(usable, effects / GOLDEN_TOLERANCE[real], 0.0)
    random_points = (
        _covering_points(effects, of_run) if thin else of_run + np.flatnonzero(usable[of_run:])
    )
    chosen = [*np.flatnonzero(usable[:of_run]), *random_points]
    if not chosen:
        raise InputError("law", "has no finite value at any of the points that were tried")
    best = effects[:, chosen].max(axis=1, initial=0.0)
    blind = tuple(name for name, value in zip(numbers, best, strict=True) if value < 1.0)
    x, Y, states = (part[:, chosen] for part in inputs)
    count = int(usable[:carried].sum())
    return GoldenVectors(count, x, Y, states, answers[:, chosen], scales[:, chosen], blind)


def _undecided(
    system: System, program: ControllerProgram, inputs: Sequence[Array], real: str
) -> Array:
    """Points where rounding decides on a jump of the controller."""
    controller, implementation = program.controller, system.implementation
    assert implementation is not None
    command, update = resolved(controller)
    arguments = (controller.measured, controller.Y, controller.states, controller.parameters)
    values = controller_values(controller, system.plant, system.law, implementation)
    return undecided_jumps([command, *update], arguments, inputs, values, real)


def _candidate_inputs(
    evaluate: Evaluate,
    system: System,
    program: ControllerProgram,
    kind: np.dtype,
    random: np.random.Generator,
) -> tuple[list[Array], int, int]:
    """x, Y and states of all candidates; how many are carried, and how many are of the run.

    All are numbers of the type `kind`, but for the states that are carried.
    """
    x, Y, states = (part.astype(kind).astype(float) for part in recorded_run(system, program))
    count = min(MAX_CARRIED, x.shape[1])
    carried = np.empty((len(states), count))
    carried[:, 0] = program.start
    for k in range(count - 1):
        column = (part[:, k : k + 1] for part in (x, Y, carried))
        carried[:, k + 1] = evaluate(*column)[1:, 0]
    chosen = np.unique(np.linspace(0, x.shape[1] - 1, EXCERPTS).astype(int))
    points = _random_points(random, x, Y, states, program)
    parts = zip((x, Y, states), (x[:, :count], Y[:, :count], carried), points, strict=True)
    inputs = [
        np.concatenate([first, part[:, chosen], point.astype(kind).astype(float)], axis=1)
        for part, first, point in parts
    ]
    return inputs, count, count + len(chosen)


def reference_answers(
    system: System, program: ControllerProgram
) -> Callable[[Array, Array, Array], Array]:
    """The controller as the simulation has it: u and the next states, for columns of inputs."""
    controller, implementation = program.controller, system.implementation
    assert implementation is not None
    command, update = resolved(controller)
    function = numpy_callable(
        [controller.measured, controller.Y, controller.states, controller.parameters],
        [command, *update],
    )
    p = controller_values(controller, system.plant, system.law, implementation)

    def answers(x: Array, Y: Array, states: Array) -> Array:
        with np.errstate(all="ignore"):
            return rows(function(x, Y, states, p), x.shape[1])

    return answers


def _perturbed_controller(system: System, program: ControllerProgram) -> tuple[Evaluate, list[str]]:
    """The controller, and the names of the numbers in its code.

    It answers for changed numbers, too; without, as the simulation's own description does.
    """
    names: list[sympy.Symbol] = list(program.constants)
    values = list(program.constants.values())
    labels = [program.labels[name] for name in names]

    def marked(expr: sympy.Expr) -> sympy.Expr:
        if not expr.args or expr.is_number:
            return expr
        usual = recognise_selection(expr)  # the code has each of its arguments once
        args = []
        for arg in expr.args if usual is None else usual[1]:
            if arg.is_number and arg != 0 and not expr.is_Pow and (expr.is_Add or arg != -1):
                names.append(symbol(f"literal_{len(names)}"))
                values.append(float(arg))
                labels.append(f"{float(arg):g}")
                args.append(names[-1])
            else:
                args.append(marked(arg))
        return expr.func(*args) if usual is None else selection_of(usual[0], tuple(args))

    values_of: dict[sympy.Symbol, sympy.Expr] = {}
    for step in (*program.steps, *program.rates):
        values_of[step.name] = marked(step.formula).xreplace(values_of)
    formulas = [values_of[COMMAND], *(marked(f).xreplace(values_of) for f in program.update)]
    function = numpy_callable([program.measured, program.Y, program.states, names], formulas)
    exact = reference_answers(system, program)

    def evaluate(x: Array, Y: Array, states: Array, change: Change = None) -> Array:
        if change is None:
            return exact(x, Y, states)
        p = np.array(values)
        p[change[0]] *= change[1]
        with np.errstate(all="ignore"):
            return rows(function(x, Y, states, p), x.shape[1])

    return evaluate, labels


def _sensitivities(
    evaluate: Evaluate, numbers: int, inputs: Sequence[Array], carried: int, real: str
) -> tuple[Array, Array, Array]:
    """Effect of each number (P, N) over the scale, the answers and their scales.

    The scale of an answer is what it would change by if all that it depends on changed by 100 %,
    each to its disadvantage; so rounding is a few units of the last place of the scale.
    """
    small = PROBE_CHANGE[real]
    answers = evaluate(*inputs)
    states = inputs[2]
    scales, changes = np.zeros_like(answers), []
    for i in range(numbers):
        scales += np.abs(evaluate(*inputs, (i, 1 + small)) - answers) / small
        changes.append(np.abs(evaluate(*inputs, (i, 1 + MUTATION)) - answers))
    for which, part in enumerate(inputs):
        for row in range(len(part)):
            changed = [each.copy() for each in inputs]
            changed[which][row] *= 1 + small
            change = evaluate(*changed) - answers
            if part is inputs[-1]:  # the states: an answer holds their rise
                change[1 + row] -= changed[2][row] - states[row]
            scales += np.abs(change) / small
    share = np.full(answers.shape[1], STATE_SHARE)
    share[:carried] = 1.0
    scales[1:] += share * np.maximum(np.abs(states), np.abs(answers[1:]))
    scales = np.maximum(scales, np.abs(answers) * STATE_SHARE)
    scales[scales < MIN_SCALE[real]] = 1.0
    with np.errstate(all="ignore"):
        effects = np.array([(change / scales).max(axis=0) for change in changes])
    return np.nan_to_num(effects.reshape(len(changes), answers.shape[1])), answers, scales


def _covering_points(effects: Array, of_run: int) -> list[int]:
    """Samples from number `of_run` on, such that every number shows clearly where it can."""
    best = effects.max(axis=1, initial=0.0)
    least = np.minimum(CLEAR_FACTOR, best) * (1 - QUOTIENT_ROUNDING)
    seen = effects[:, :of_run].max(axis=1, initial=0.0) >= least
    chosen: list[int] = []
    while not seen.all():
        shows = effects >= least[:, None]
        shows[seen] = False
        point = int(np.argmax(shows.sum(axis=0)))
        chosen.append(point)
        seen |= shows[:, point]
    return chosen


def _random_points(
    random: np.random.Generator, x: Array, Y: Array, states: Array, program: ControllerProgram
) -> list[Array]:
    """Points of all magnitudes around the run, with many zeros."""
    columns = random.integers(0, x.shape[1], CANDIDATES)

    def spread(part: Array) -> Array:
        base = part[:, columns]
        typical = np.abs(part).max(axis=1, initial=0.0) + 1.0 * (len(part) > 0)
        size = typical[:, None] * 10.0 ** random.uniform(-2, 1, (1, CANDIDATES))
        changed = base * random.integers(0, 2, (1, CANDIDATES)) + size * random.normal(
            size=base.shape
        )
        return np.where(random.random(base.shape) < ZEROS_SHARE, 0.0, changed)

    points = [spread(part) for part in (x, Y, states)]
    for row, name in enumerate(program.states):
        if name == FIRST:
            points[2][row] = (random.random(CANDIDATES) < FIRST_SHARE) * 1.0
        if name == SAMPLE_NUMBER:  # time does not run before the start
            points[2][row] = np.abs(points[2][row])
    return points


class _RecordingMaps:
    """Maps that remember what the controller was given."""

    def __init__(self, maps: SampledMaps) -> None:
        self._maps = maps
        self.times: list[float] = []
        self.inputs: list[tuple[Array, Array]] = []

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        self.times.append(float(np.max(t)))
        self.inputs.append((measured[:, 0].copy(), states[:, 0].copy()))
        return self._maps.control(t, measured, states, p)

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        return self._maps.step(t, h, allowed, x, u, totals, p)


def recorded_run(system: System, program: ControllerProgram) -> tuple[Array, Array, Array]:
    """Measurements, reference and states at the samples of a closed-loop run."""
    implementation = system.implementation
    assert implementation is not None
    duration = min(
        system.settings.duration, implementation.offset + MAX_GOLDEN_SAMPLES * implementation.period
    )
    settings = replace(system.settings, duration=duration, tail=None)
    short = system.replace(settings=settings)
    recorders: list[_RecordingMaps] = []

    def listen(maps: SampledMaps, _: SampledLoop) -> SampledMaps:
        recorders.append(_RecordingMaps(maps))
        return recorders[0]

    SampledSimulator(short, around=listen, controller=program.controller).run(short)
    (recorder,) = recorders
    x = np.array([measured for measured, _ in recorder.inputs]).T
    states = np.array([states for _, states in recorder.inputs]).reshape(len(recorder.inputs), -1).T
    inside = np.isfinite(x).all(axis=0) & np.isfinite(states).all(axis=0)
    Y = system.reference.values(np.array(recorder.times), len(program.Y) - 1)
    return x[:, inside], Y[:, inside], states[:, inside]
