"""An optimal control problem as a nonlinear program, which CasADi differentiates exactly, twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import InputError
from certrack.laws.plant_coordinates import output_derivatives
from certrack.studies.optimal.collocation import COLLOCATION_DEGREE, CollocationGrid
from certrack.studies.optimal.goal import Goal
from certrack.studies.optimal.law_run import LawRun

#: A state or input that is smaller than this all along is scaled by it.
SMALLEST_SCALE = 1e-6

#: The shortest and the longest time that is searched, over the guess.
SHORTEST_STRETCH, LONGEST_STRETCH = 1e-2, 3.0


@dataclass(frozen=True)
class GridValues:
    """Where a search begins, and the scales of what is searched.

    Attributes
    ----------
    begins : (S, E + 1) array
        States at the ends of the elements.
    inner : (d, S, E) array
        States at the Gauss points.
    inputs : (2, E) array
        Inputs at the begin and at the end of the elements, straight between.
    """

    begins: Array
    inner: Array
    inputs: Array

    @property
    def state_scale(self) -> Array:
        """Largest magnitude of each state, (S,) array."""
        largest = np.abs(self.begins).max(axis=1)
        return np.where(largest < SMALLEST_SCALE, 1.0, largest)

    @property
    def input_scale(self) -> float:
        """Largest magnitude of the input."""
        return max(float(np.abs(self.inputs).max()), SMALLEST_SCALE)


@dataclass(frozen=True)
class PlantMotion:
    """States and input of a plant over a time.

    Attributes
    ----------
    states : callable
        At times, shape (S, N).
    inputs : callable
        At times, shape (N,).
    end : float, s
    """

    states: Callable[[Array], Array]
    inputs: Callable[[Array], Array]
    end: float


def guess_on(grid: CollocationGrid, motion: PlantMotion) -> GridValues:
    """A motion on a grid; of its input the line nearest to it on each element."""
    inner = np.array([motion.states(row) for row in grid.times])
    at_nodes = motion.inputs(grid.times.reshape(-1)).reshape(grid.times.shape)
    weights, since = grid.scheme.weights, grid.scheme.nodes - 0.5
    mean, half_rise = weights @ at_nodes, 6.0 * (weights * since) @ at_nodes
    return GridValues(
        motion.states(grid.ends), inner, np.array([mean - half_rise, mean + half_rise])
    )


def motion_on(grid: CollocationGrid, values: GridValues) -> PlantMotion:
    """Values on a grid as a motion, linear between its points."""
    times = np.vstack([grid.ends[:-1], grid.times]).T.reshape(-1)
    table = np.concatenate([values.begins[None, :, :-1], values.inner])  # (d + 1, S, E)
    rows = table.transpose(1, 2, 0).reshape(len(values.begins), -1)
    times, rows = np.append(times, grid.ends[-1]), np.hstack([rows, values.begins[:, -1:]])

    def states(t: Array) -> Array:
        return np.array([np.interp(t, times, row) for row in rows])

    def inputs(t: Array) -> Array:
        element = np.clip(np.searchsorted(grid.ends, t, "right") - 1, 0, grid.elements - 1)
        share = (t - grid.ends[element]) / grid.lengths[element]
        first, last = values.inputs[:, element]
        line: Array = first + share * (last - first)
        return line

    return PlantMotion(states, inputs, float(grid.ends[-1]))


@dataclass(frozen=True)
class Searched:
    """What is searched, each of order one.

    Attributes
    ----------
    begins, inner, inputs : matrices
        As those of :class:`Guess`, over its scales.
    peak : scalar
        Bound of the inputs' magnitudes.
    stretch : scalar
        Factor of the time: 1 but where the time is minimised.
    """

    begins: Any
    inner: list[Any]
    inputs: Any
    peak: Any
    stretch: Any

    def vector(self, ca: Any) -> Any:
        """All of them."""
        blocks = [self.begins, *self.inner, self.inputs]
        return ca.vertcat(*map(ca.vec, blocks), self.peak, self.stretch)


@dataclass(frozen=True)
class NonlinearProgram:
    """A nonlinear program: the least objective with low <= z <= high and lower <= g <= upper.

    Attributes
    ----------
    vector, objective, constraints : of CasADi
        z, what is minimised, and g.
    start, low, high : (Z,) arrays
        Of z.
    lower, upper : (G,) arrays
        Of g.
    """

    vector: Any
    objective: Any
    constraints: Any
    start: Array
    low: Array
    high: Array
    lower: Array
    upper: Array


class ConstraintRows:
    """Constraints while they are gathered."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self.lower: list[float] = []
        self.upper: list[float] = []

    def add(self, rows: Any, lower: float, upper: float) -> None:
        """lower <= each of the rows <= upper."""
        self.rows.append(rows)
        self.lower += [lower] * rows.numel()
        self.upper += [upper] * rows.numel()


def transcribe(
    ca: Any, law_run: LawRun, goal: Goal, grid: CollocationGrid, guess: GridValues
) -> NonlinearProgram:
    """The program of a goal.

    Parameters
    ----------
    ca : module
        ``casadi``.
    law_run : LawRun
    goal : Goal
    grid : CollocationGrid
    guess : GridValues
    """
    size, count = law_run.plant.n, grid.elements
    z = Searched(
        ca.MX.sym("x", size, count + 1),
        [ca.MX.sym(f"x_{i}", size, count) for i in range(COLLOCATION_DEGREE)],
        ca.MX.sym("u", 2, count),
        ca.MX.sym("peak"),
        ca.MX.sym("stretch"),
    )
    scale = ca.DM(guess.state_scale)
    X, inner = _scaled(ca, scale, z.begins), [_scaled(ca, scale, block) for block in z.inner]
    U, H = guess.input_scale * z.inputs, ca.DM(grid.lengths[None, :]) * z.stretch

    gathered = ConstraintRows()
    motion = _motion(ca, law_run, grid, X, inner, U, H, z.stretch)
    for residual in (X[:, 0] - ca.DM(law_run.start), *motion):
        gathered.add(ca.vec(_scaled(ca, 1 / scale, residual)), 0.0, 0.0)
    quantities = {
        "squared_error": _squared_error(ca, law_run, goal, grid, inner, H, z.stretch),
        "energy": ca.sum2(H * (U[0, :] ** 2 + U[0, :] * U[1, :] + U[1, :] ** 2)) / 3,
        "peak": z.peak,
        "time": z.stretch,
    }
    units = {name: max(getattr(law_run.law, name), 1e-12) for name in ("squared_error", "energy")}
    for name in ("squared_error", "energy"):
        if name in goal.limits:
            gathered.add(quantities[name] / units[name], -np.inf, goal.limits[name] / units[name])
    if goal.minimised == "peak":
        gathered.add(ca.vec(z.inputs - z.peak), -np.inf, 0.0)
        gathered.add(ca.vec(z.inputs + z.peak), 0.0, np.inf)
    if goal.minimised == "time":
        gathered.add(_arrival(ca, law_run, X[:, -1], grid.ends[-1] * z.stretch), 0.0, 0.0)

    limit = np.inf if goal.peak is None else goal.peak / guess.input_scale
    free = np.full(size * (count + 1 + COLLOCATION_DEGREE * count), np.inf)
    held = np.full(2 * count, limit)
    times = (SHORTEST_STRETCH, LONGEST_STRETCH) if goal.minimised == "time" else (1.0, 1.0)
    return NonlinearProgram(
        vector=z.vector(ca),
        objective=quantities[goal.minimised] / units.get(goal.minimised, 1.0),
        constraints=ca.vertcat(*gathered.rows),
        start=_starting_vector(guess, limit),
        low=np.concatenate([-free, -held, [0.0, times[0]]]),
        high=np.concatenate([free, held, [np.inf, times[1]]]),
        lower=np.array(gathered.lower),
        upper=np.array(gathered.upper),
    )


def solution(guess: GridValues, answer: Array) -> tuple[GridValues, float]:
    """States and inputs of a solved program's z, in the shape of the guess, and the stretch."""
    size, ends = guess.begins.shape
    blocks = [ends, *[ends - 1] * COLLOCATION_DEGREE]
    cuts = np.cumsum([size * columns for columns in blocks] + [2 * (ends - 1), 1])
    *states, inputs, _, stretch = np.split(answer, cuts)
    begins, *inner = (part.reshape(-1, size).T * guess.state_scale[:, None] for part in states)
    lines = inputs.reshape(-1, 2).T * guess.input_scale
    return GridValues(begins, np.array(inner), lines), float(stretch[0])


def _starting_vector(guess: GridValues, limit: float) -> Array:
    """The z of a guess."""
    blocks = [block / guess.state_scale[:, None] for block in (guess.begins, *guess.inner)]
    inputs = np.clip(guess.inputs / guess.input_scale, -limit, limit)
    parts = [block.T.reshape(-1) for block in (*blocks, inputs)]
    return np.concatenate([*parts, [np.abs(inputs).max(), 1.0]])


def _scaled(ca: Any, scale: Any, block: Any) -> Any:
    """Each row times its scale."""
    return ca.repmat(scale, 1, block.shape[1]) * block


def _motion(
    ca: Any,
    law_run: LawRun,
    grid: CollocationGrid,
    X: Any,
    inner: list[Any],
    U: Any,
    H: Any,
    stretch: Any,
) -> list[Any]:
    """What vanishes for a motion of the plant: at the Gauss points, and between the elements."""
    rates = law_run.rates_in_casadi(ca)
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", law_run.plant.n), ca.SX.sym("u")
    one = ca.Function("rates", [t, x, u], [ca.vertcat(*rates(t, ca.vertsplit(x), u))])
    on_all, scheme = one.map(grid.elements), grid.scheme
    residuals = []
    for i, row in enumerate(grid.times):
        slope = scheme.slopes[0, i] * X[:, :-1]
        for weight, block in zip(scheme.slopes[1:, i], inner, strict=True):
            slope += weight * block
        at, share = ca.DM(row[None, :]) * stretch, float(scheme.nodes[i])
        u_i = (1 - share) * U[0, :] + share * U[1, :]
        residuals.append(slope - on_all(at, inner[i], u_i) * ca.repmat(H, law_run.plant.n, 1))
    end = scheme.last[0] * X[:, :-1]
    for weight, block in zip(scheme.last[1:], inner, strict=True):
        end += weight * block
    return [*residuals, X[:, 1:] - end]


def _squared_error(
    ca: Any,
    law_run: LawRun,
    goal: Goal,
    grid: CollocationGrid,
    inner: list[Any],
    H: Any,
    stretch: Any,
) -> Any:
    """The integral of e_1^2."""
    outputs = law_run.outputs_in_casadi(ca)
    x = ca.SX.sym("x", law_run.plant.n)
    output = ca.Function("output", [x], [outputs(ca.vertsplit(x))[0]]).map(grid.elements)
    if goal.minimised == "time":
        t = ca.SX.sym("t")
        on_all = ca.Function("y_d", [t], [_reference_formulas(ca, law_run)(t)[0]]).map(
            grid.elements
        )
        references = [on_all(ca.DM(row[None, :]) * stretch) for row in grid.times]
    else:
        references = [ca.DM(law_run.reference(row)[:1]) for row in grid.times]
    integral = 0
    for weight, block, known in zip(grid.scheme.weights, inner, references, strict=True):
        integral += weight * ca.sum2(H * (output(block) - known) ** 2)
    return integral


def _arrival(ca: Any, law_run: LawRun, state: Any, time: Any) -> Any:
    """What is zero where the output moves as y_d does: y^(i) - y_d^(i), i < n, without w."""
    outputs = law_run.outputs_in_casadi(ca)
    measured = ca.vertcat(*outputs(ca.vertsplit(state)))
    Y = ca.vertcat(*_reference_formulas(ca, law_run)(time))
    return ca.mtimes(ca.DM(output_derivatives(law_run.system.plant)), measured) - Y


def _reference_formulas(ca: Any, law_run: LawRun) -> Callable[[Any], list[Any]]:
    """y_d and its derivatives as functions of CasADi's time."""
    reference = law_run.system.reference
    if reference.piece_symbols:
        raise InputError(
            "objective",
            "the shortest time needs a reference that is one formula, not pieces",
            "time",
            "Minimise the squared error under a limit of the peak input instead",
        )
    if reference.order < law_run.system.plant.n - 1:
        raise InputError(
            "objective",
            f"the shortest time needs {law_run.system.plant.n - 1} derivatives of the reference, "
            "which it reaches with the output",
            "time",
        )
    return law_run.reference_in_casadi(ca)
