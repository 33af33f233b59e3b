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

from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.export.program import Program
from certrack.integrators.many.sampled_maps import Maps, Scalar
from certrack.loops.controller import COMMAND, controller_values
from certrack.loops.sampled import SampledLoop, resolved
from certrack.simulation.sampled import SampledSimulator
from certrack.systems.system import System

Array = np.ndarray

#: Largest deviation over its scale.
TOLERANCE = {"double": 1e-12, "float": 5e-6}

#: The error that must be caught, relative; a number shows well where it passes the tolerance by
#: this factor.
MUTATION, CLEARLY = 3e-3, 10.0

#: Samples of the carried run, of the run that they come from, random candidates, points of the run.
CARRIED, LONGEST, CANDIDATES, EXCERPTS = 40, 2000, 4000, 20

#: Smaller answers may be lost to underflow.
SMALLEST = {"double": 1e-280, "float": 1e-20}

#: Relative changes that sensitivities are taken by: somewhat more than rounding.
SMALL = {"double": 1e-9, "float": 3e-6}

#: Part of a state's own size that its scale contains: the rounding of state + rise.
OWN_SHARE = 0.05


#: A number of the code, and what it is multiplied by.
Change = tuple[int, float] | None

#: Answers (1 + m, N) for x, Y, states and changed numbers.
Evaluate = Callable[..., Array]


@dataclass(frozen=True)
class Golden:
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


def golden(
    system: System, made: Program, real: str = "double", *, seed: int = 0, thin: bool = True
) -> Golden:
    """Golden vectors of a program, for code with numbers of type `real`.

    With `thin`, only as many of the random points as it takes to see every number.

    Raises
    ------
    InputError
        If the law has no finite value anywhere.
    """
    evaluate, numbers = _probe(system, made)
    kind = np.dtype("float32" if real == "float" else "float64")
    inputs, count, given = _inputs(evaluate, system, made, kind, np.random.default_rng(seed))
    effects, answers, scales = _judge(evaluate, len(numbers), inputs, count, real)
    usable = np.isfinite(answers).all(axis=0) & np.isfinite(scales).all(axis=0)
    usable &= (np.abs(answers) < 1e12).all(axis=0)
    usable[:count] &= np.logical_and.accumulate(usable[:count])
    effects = np.where(usable, effects / TOLERANCE[real], 0.0)
    rest = _cover(effects, given) if thin else given + np.flatnonzero(usable[given:])
    keep = [*np.flatnonzero(usable[:given]), *rest]
    if not keep:
        raise InputError("law", "has no finite value at any of the points that were tried")
    best = effects[:, keep].max(axis=1, initial=0.0)
    blind = tuple(name for name, value in zip(numbers, best, strict=True) if value < 1.0)
    x, Y, states = (part[:, keep] for part in inputs)
    carried = int(usable[:count].sum())
    return Golden(carried, x, Y, states, answers[:, keep], scales[:, keep], blind)


def _inputs(
    evaluate: Evaluate, system: System, made: Program, kind: np.dtype, random: np.random.Generator
) -> tuple[list[Array], int, int]:
    """x, Y and states of all candidates; how many are carried, and how many are given.

    All are numbers of the type `kind`, but for the states that are carried.
    """
    x, Y, states = (part.astype(kind).astype(float) for part in recorded(system, made))
    count = min(CARRIED, x.shape[1])
    carried = np.empty((len(states), count))
    carried[:, 0] = made.start
    for k in range(count - 1):
        column = (part[:, k : k + 1] for part in (x, Y, carried))
        carried[:, k + 1] = evaluate(*column)[1:, 0]
    chosen = np.unique(np.linspace(0, x.shape[1] - 1, EXCERPTS).astype(int))
    points = _candidates(random, x, Y, states, made)
    parts = zip((x, Y, states), (x[:, :count], Y[:, :count], carried), points, strict=True)
    inputs = [
        np.concatenate([first, part[:, chosen], point.astype(kind).astype(float)], axis=1)
        for part, first, point in parts
    ]
    return inputs, count, count + len(chosen)


def reference_answers(system: System, made: Program) -> Callable[[Array, Array, Array], Array]:
    """The controller as the simulation has it: u and the next states, for columns of inputs."""
    controller, implementation = made.controller, system.implementation
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


def _probe(system: System, made: Program) -> tuple[Evaluate, list[str]]:
    """The controller, and the names of the numbers in its code.

    It answers for changed numbers, too; without, as the simulation's own description does.
    """
    names: list[sympy.Symbol] = list(made.constants)
    values = list(made.constants.values())
    labels = [made.labels[name] for name in names]

    def marked(expr: sympy.Expr) -> sympy.Expr:
        if not expr.args or expr.is_number:
            return expr
        args = []
        for arg in expr.args:
            if arg.is_number and arg != 0 and not expr.is_Pow and (expr.is_Add or arg != -1):
                names.append(symbol(f"literal_{len(names)}"))
                values.append(float(arg))
                labels.append(f"{float(arg):g}")
                args.append(names[-1])
            else:
                args.append(marked(arg))
        return expr.func(*args)

    known: dict[sympy.Symbol, sympy.Expr] = {}
    for step in (*made.steps, *made.rates):
        known[step.name] = marked(step.formula).xreplace(known)
    formulas = [known[COMMAND], *(marked(f).xreplace(known) for f in made.update)]
    function = numpy_callable([made.measured, made.Y, made.states, names], formulas)
    exact = reference_answers(system, made)

    def evaluate(x: Array, Y: Array, states: Array, change: Change = None) -> Array:
        if change is None:
            return exact(x, Y, states)
        p = np.array(values)
        p[change[0]] *= change[1]
        with np.errstate(all="ignore"):
            return rows(function(x, Y, states, p), x.shape[1])

    return evaluate, labels


def _judge(
    evaluate: Evaluate, numbers: int, inputs: Sequence[Array], carried: int, real: str
) -> tuple[Array, Array, Array]:
    """Effect of each number (P, N) over the scale, the answers and their scales.

    The scale of an answer is what it would change by if all that it depends on changed by 100 %,
    each to its disadvantage; so rounding is a few units of the last place of the scale.
    """
    small = SMALL[real]
    answers = evaluate(*inputs)
    states = inputs[2]
    scales, changes = np.zeros_like(answers), []
    for i in range(numbers):
        scales += np.abs(evaluate(*inputs, (i, 1 + small)) - answers) / small
        changes.append(np.abs(evaluate(*inputs, (i, 1 + MUTATION)) - answers))
    for which, part in enumerate(inputs):
        for row in range(len(part)):
            moved = [each.copy() for each in inputs]
            moved[which][row] *= 1 + small
            change = evaluate(*moved) - answers
            if which == 2:
                change[1 + row] -= moved[2][row] - states[row]
            scales += np.abs(change) / small
    own = np.full(answers.shape[1], OWN_SHARE)
    own[:carried] = 1.0
    scales[1:] += own * np.maximum(np.abs(states), np.abs(answers[1:]))
    scales = np.maximum(scales, np.abs(answers) * OWN_SHARE)
    scales[scales < SMALLEST[real]] = 1.0
    with np.errstate(all="ignore"):
        effects = np.array([(change / scales).max(axis=0) for change in changes])
    return np.nan_to_num(effects.reshape(len(changes), answers.shape[1])), answers, scales


def _cover(effects: Array, given: int) -> list[int]:
    """Samples from number `given` on, such that every number shows clearly where it can."""
    best = effects.max(axis=1, initial=0.0)
    wanted = np.minimum(CLEARLY, best) * (1 - 1e-9)
    seen = effects[:, :given].max(axis=1, initial=0.0) >= wanted
    chosen: list[int] = []
    while not seen.all():
        shows = effects >= wanted[:, None]
        shows[seen] = False
        take = int(np.argmax(shows.sum(axis=0)))
        chosen.append(take)
        seen |= shows[:, take]
    return chosen


def _candidates(
    random: np.random.Generator, x: Array, Y: Array, states: Array, made: Program
) -> list[Array]:
    """Points of all magnitudes around the run, with many zeros."""
    some = random.integers(0, x.shape[1], CANDIDATES)

    def spread(part: Array) -> Array:
        base = part[:, some]
        typical = np.abs(part).max(axis=1, initial=0.0) + 1.0 * (len(part) > 0)
        size = typical[:, None] * 10.0 ** random.uniform(-2, 1, (1, CANDIDATES))
        moved = base * random.integers(0, 2, (1, CANDIDATES)) + size * random.normal(
            size=base.shape
        )
        return np.where(random.random(base.shape) < 0.35, 0.0, moved)

    found = [spread(part) for part in (x, Y, states)]
    for row, name in enumerate(made.states):
        if name.name == "ctl_first":
            found[2][row] = (random.random(CANDIDATES) < 0.1) * 1.0
    return found


class _Recorder:
    """Maps that remember what the controller was given."""

    def __init__(self, maps: Maps) -> None:
        self._maps = maps
        self.times: list[float] = []
        self.given: list[tuple[Array, Array]] = []

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        self.times.append(float(np.max(t)))
        self.given.append((measured[:, 0].copy(), states[:, 0].copy()))
        return self._maps.control(t, measured, states, p)

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        return self._maps.step(t, h, allowed, x, u, totals, p)


def recorded(system: System, made: Program) -> tuple[Array, Array, Array]:
    """Measurements, reference and states at the samples of a closed-loop run."""
    implementation = system.implementation
    assert implementation is not None
    duration = min(
        system.settings.duration, implementation.offset + LONGEST * implementation.period
    )
    settings = replace(system.settings, duration=duration, tail=None)
    short = system.replace(settings=settings)
    recorders: list[_Recorder] = []

    def listen(maps: Maps, _: SampledLoop) -> Maps:
        recorders.append(_Recorder(maps))
        return recorders[0]

    SampledSimulator(short, around=listen).run(short)
    (recorder,) = recorders
    x = np.array([measured for measured, _ in recorder.given]).T
    states = np.array([kept for _, kept in recorder.given]).reshape(len(recorder.given), -1).T
    inside = np.isfinite(x).all(axis=0) & np.isfinite(states).all(axis=0)
    Y = system.reference.values(np.array(recorder.times), len(made.Y) - 1)
    return x[:, inside], Y[:, inside], states[:, inside]
