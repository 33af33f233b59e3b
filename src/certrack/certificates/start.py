"""V(0): what the tube starts from, by ball arithmetic, so that it is never below the true value.

e = A x - B Y is a small difference of large terms where the start is near the orbit that the loop
settles to, and the entries of A grow doubly exponentially with the order of a damped design. A and
B are exact rationals here, and x and the reference at t = 0 are balls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import flint
import numpy as np
import sympy

from certrack.certificates.arithmetic import rational
from certrack.certificates.balls import ball_of, ball_precision, enclosing_ball, upper_rational
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.problem import ErrorProblem
from certrack.core.expressions import TIME, symbol
from certrack.core.once import once
from certrack.loops.plant import measured
from certrack.references.base import ROUNDED_UNITS
from certrack.systems.system import System

#: Balls of the states, and of y_d and its derivatives.
Start = tuple[list[Any], list[Any]]

#: The start is taken so much larger, relatively: a run begins at floats.
START_SLACK = rational("1e-9")

#: Radius of a ball around a value that is only known in floats, relatively; it proves nothing.
UNPROVEN_RADIUS = 1e-9


def reference_at_start(system: System, order: int) -> tuple[list[Any], bool]:
    """Balls of y_d(0) ... y_d^(order)(0), and whether they are proven.

    The pieces of a piecewise reference are numbers of a few roundings each.
    """
    return _reference_at_start(system, order, flint.ctx.prec)


@once
def _reference_at_start(system: System, order: int, _bits: int) -> tuple[list[Any], bool]:
    """The same at the precision that is set."""
    reference = system.reference
    values: dict[Any, Any] = {TIME: flint.arb(0)}
    constants = dict(getattr(reference, "constants", ()))
    for name, value in zip(reference.parameter_symbols, reference.parameter_values, strict=True):
        stated = constants.get(name.name.removeprefix("ref_"))
        try:
            values[name] = ball_of(value) if stated is None else enclosing_ball(stated.expr, {})
        except ValueError:
            values[name] = ball_of(value)
    pieces = reference.piece_values(0.0).tolist()
    for name, value in zip(reference.piece_symbols, pieces, strict=True):
        values[name] = ball_of(value, ROUNDED_UNITS)
    try:
        formulas = reference.formulas(order)
        if any(_turns(formula, values) for formula in formulas):
            raise ValueError("the reference has a kink where it begins")
        return [_with_its_float(enclosing_ball(f, values)) for f in formulas], True
    except ValueError:
        floats = reference.values(np.array([0.0]), order)[:, 0].tolist()
        return [_unproven(v) for v in floats], False


def _turns(formula: sympy.Expr, values: dict[Any, Any]) -> bool:
    """Whether a sign in a derivative of the reference may turn at t = 0.

    Then the derivative from the right, which the run begins with, may be another than the formula's
    value.
    """
    return any(
        part.args[0].has(TIME) and enclosing_ball(part.args[0], values).contains(0)
        for part in formula.atoms(sympy.sign)
    )


def states_at_start(system: System) -> tuple[list[Any], bool]:
    """Balls of the design's states at t = 0, and whether they are proven."""
    truth, x0 = system.truth, system.settings.x0
    if not truth.states:
        return [ball_of(v) for v in x0], True
    try:
        plant, true = system.plant, dict(truth.constants)
        shared = {name: v for name, v in true.items() if name in plant.constant_values}
        numbers = {name: v.expr for name, v in true.items()}
        numbers |= plant.with_constants(**shared).constant_values
        values = {symbol(name): enclosing_ball(v, {}) for name, v in numbers.items()}
        starts = zip(truth.states, x0, strict=True)
        values |= {symbol(name): flint.arb(rational(v)) for name, v in starts}
        outputs = truth.outputs or ()
        return [_with_its_float(enclosing_ball(f.expr, values)) for f in outputs], True
    except ValueError:
        floats = measured(system, np.array([x0]).T)[:, 0].tolist()
        return [_unproven(v) for v in floats], False


def _with_its_float(ball: Any) -> Any:
    """The ball, wide enough for the float that is nearest to it."""
    nearest = float(ball.mid())
    return ball + flint.arb(0, math.ulp(nearest) if nearest else 0)


def _unproven(value: float) -> Any:
    return flint.arb(value, abs(value) * UNPROVEN_RADIUS)


def errors_at_start(system: System, starts: Sequence[Start]) -> list[list[Any]]:
    """Balls of e = A x - B Y of each start, at the precision that is set."""
    exact = error_coordinates(system, rational)
    rows = list(zip(_balls(exact.A), _balls(exact.B), strict=True))
    return [[_dot(a, x) - _dot(b, Y) for a, b in rows] for x, Y in starts]


def starting_energy(
    system: System, problem: ErrorProblem, P: np.ndarray, starts: Sequence[Start]
) -> Any:
    """The largest V(0) of the starts, as a rational not below it.

    Parameters
    ----------
    system : System
    problem : ErrorProblem
        In exact rationals; of all rows, or of those of a cascade's last stage.
    P : (m, m) array of rationals
    starts : pairs (x, Y) of lists of balls
        States, and y_d ... y_d^(q) at t = 0.
    """
    with ball_precision():
        weights, energies = _balls(P), []
        for errors in errors_at_start(system, starts):
            e = errors[: problem.n]
            energies.append(upper_rational(_dot(e, [_dot(row, e) for row in weights]) / 2))
    total = max(energies)
    if problem.adaptation is not None:
        estimates = np.array([rational(v) for v in system.estimates], dtype=object)
        total = total + P[-1, -1] * problem.adaptation.energy(estimates)
    return total * (1 + START_SLACK)


def _balls(rows: np.ndarray) -> list[list[Any]]:
    return [[flint.arb(entry) for entry in row] for row in rows]


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum((left * right for left, right in zip(a, b, strict=True)), flint.arb(0))
