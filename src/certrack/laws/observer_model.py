"""The numbers of an observer: the plant over one period, and how measurements correct it.

The plant that the observer counts on is linear but for what is evaluated once a period,

    x' = A x + b u + sum_k e_k d_k + e_n remainder(x),

with A the chain, the couplings and what is linear in h + phi^T theta. Over a period of the input's
delay, x_{k+1} = F x_k + B_new u_{k-m} + B_old u_{k-m-1} + G d + G_n remainder(x_k). Constant d are
compensated by the input and states P d, U d that leave x_1 as it is,

    A P + b U + E = 0,    e_1' P = 0.

The numbers are computed with many more digits than a float has and then rounded, so they are the
same on every machine: a certificate takes these floats for exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import flint
import numpy as np
import sympy

from certrack.core.errors import DesignError
from certrack.core.powers import put_in
from certrack.core.rationals import exact_rational
from certrack.laws.base import Law
from certrack.laws.observer import DOB, Observer
from certrack.laws.observer_gains import (
    ball_of_number,
    gains_of_dob,
    signal_weights,
    stationary_gains,
    unseen,
)
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant

#: Bits of the numbers.
MODEL_BITS = 384


@dataclass(frozen=True)
class ObserverModel:
    """The numbers of the module's text, as floats; see also :class:`Observer`.

    Attributes
    ----------
    F, G : (n, n) and (n, rows) arrays
    new, old, remainder : (n,) arrays
        B_new, B_old and G_n.
    correction : (n + rows, sensors) array
        By what the sensors differ from what was predicted: what is added to the states and to d.
        Of ``dob``: (rows, rows), of d alone.
    P, U : (n, rows) and (rows,) arrays
    """

    F: np.ndarray
    G: np.ndarray
    new: np.ndarray
    old: np.ndarray
    remainder: np.ndarray
    correction: np.ndarray
    P: np.ndarray
    U: np.ndarray


def linear_part(plant: Plant, theta: Sequence[Any]) -> tuple[list[Any], sympy.Expr]:
    """Slopes of h + phi^T theta by the states, and the remainder of it, as formulas.

    Parameters
    ----------
    plant : Plant
    theta : formulas or numbers
    """
    total = plant.drift.expr
    for phi, value in zip(plant.regressor, theta, strict=True):
        total += phi.expr * value
    slopes: list[Any] = [sympy.S.Zero] * plant.n
    remainder = sympy.S.Zero
    for term in sympy.Add.make_args(sympy.expand(total)):
        states = [i for i, x in enumerate(plant.symbols) if term.has(x)]
        slope = sympy.diff(term, plant.symbols[states[0]]) if len(states) == 1 else None
        if (
            slope is not None
            and slope * plant.symbols[states[0]] == term
            and not slope.has(*plant.symbols)
        ):
            slopes[states[0]] += slope
        else:
            remainder += term
    return slopes, remainder


def known_plant(plant: Plant, law: Law) -> tuple[Any, tuple[Any, ...]]:
    """g_n and theta that an observer counts on: the plant's, or the law's prior guesses.

    Raises
    ------
    DesignError
        If neither is there.
    """
    gain = None if plant.input_gain is None else plant.input_gain.expr
    if gain is None and (guess := getattr(law, "delta0", 0.0)):
        gain = 1 / _exact(guess)
    if gain is None:
        raise DesignError(
            "law.observer",
            "must know the input gain",
            remedy="State plant.input_gain, or law.delta0 near 1/g_n",
        )
    if plant.theta is not None:
        return gain, tuple(value.expr for value in plant.theta)
    guesses = getattr(law, "theta0", None) or (0.0,) * plant.r
    return gain, tuple(map(_exact, guesses))


def _exact(value: float) -> sympy.Expr:
    exact = exact_rational(value)
    return sympy.Rational(exact.numerator, exact.denominator)


def observer_model(plant: Plant, law: Law, implementation: Implementation) -> ObserverModel:
    """The numbers of a law's observer.

    Parameters
    ----------
    plant : Plant
        Of the design.
    law : Law
        Has an observer.
    implementation : Implementation

    Raises
    ------
    DesignError
        If what it shall estimate cannot be told from what is measured, or not be compensated.
    """
    assert law.observer is not None
    observer = law.observer.bound_to(plant, implementation)
    gain, theta = known_plant(plant, law)
    return _model(
        plant,
        observer,
        gain,
        theta,
        implementation.period,
        implementation.design_delay,
        implementation.velocity,
    )


def plant_over_a_period(
    plant: Plant, law: Law, implementation: Implementation
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """F, B_new and B_old of the module's text for the implementation's delay, and g_n."""
    gain, theta = known_plant(plant, law)
    with flint.ctx.workprec(MODEL_BITS):
        A, b = _rates(plant, gain, theta)
        T, delay = ball_of_number(implementation.period), implementation.design_delay
        over, new, old = _held(A, b, T, delay)
        known_gain = b[plant.n - 1, 0]
    return _floats(over), _floats(new)[:, 0], _floats(old)[:, 0], float(known_gain.mid())


def _held(
    A: flint.arb_mat, b: flint.arb_mat, T: flint.arb, delay: float
) -> tuple[flint.arb_mat, flint.arb_mat, flint.arb_mat]:
    """F, B_new and B_old."""
    part = ball_of_number(delay) - math.floor(delay)
    after = (1 - part) * T
    old = (A * after).exp() * _forced(A, b, part * T)
    return (A * T).exp(), _forced(A, b, after), old


@lru_cache(maxsize=64)
def _model(
    plant: Plant,
    observer: Observer,
    gain: Any,
    theta: tuple[Any, ...],
    period: float,
    delay: float,
    velocity: tuple[str, ...],
) -> ObserverModel:
    with flint.ctx.workprec(MODEL_BITS):
        return _computed(plant, observer, gain, theta, period, delay, velocity)


def _computed(
    plant: Plant,
    observer: Observer,
    gain: Any,
    theta: tuple[Any, ...],
    period: float,
    delay: float,
    velocity: tuple[str, ...],
) -> ObserverModel:
    n, T = plant.n, ball_of_number(period)
    rows = [plant.states.index(name) for name in observer.rows]
    A, b = _rates(plant, gain, theta)
    E = flint.arb_mat(n, len(rows))
    for j, i in enumerate(rows):
        E[i, j] = 1
    last = flint.arb_mat([[int(i == n - 1)] for i in range(n)])
    F, new, old = _held(A, b, T, delay)
    G, remainder = _forced(A, E, T), _forced(A, last, T)
    if observer.kind == DOB:
        correction = gains_of_dob(observer, G, rows, T)
    else:
        measured = [i for i in range(n) if plant.states[i] not in velocity]
        weights = signal_weights(plant, observer, A, period, measured, rows)
        correction = stationary_gains(F, G, measured, weights)
    P, U = _compensation(A, b, E)
    floats = [_floats(matrix) for matrix in (F, G, new, old, remainder, correction, P, U)]
    if not all(np.isfinite(table).all() for table in floats):
        raise unseen(observer.rows)
    F, G, new, old, remainder, correction, P, U = floats
    return ObserverModel(F, G, new[:, 0], old[:, 0], remainder[:, 0], correction, P, U[0])


def _rates(plant: Plant, gain: Any, theta: Sequence[Any]) -> tuple[flint.arb_mat, flint.arb_mat]:
    """A and b."""
    n, known = plant.n, plant.constant_values
    numbers = {sympy.Symbol(name, real=True): value for name, value in known.items()}

    def number(formula: Any) -> flint.arb:
        formula = sympy.sympify(formula)
        named = {s: numbers[s] for s in formula.free_symbols if s in numbers}
        return ball_of_number(put_in(formula, named) if named else formula)

    A, b = flint.arb_mat(n, n), flint.arb_mat(n, 1)
    for i, g in enumerate(plant.chain):
        for j, value in enumerate(plant.linear[i] if plant.linear else ()):
            A[i, j] = number(value.expr)
        A[i, i + 1] = A[i, i + 1] + number(g.expr)
    for j, slope in enumerate(linear_part(plant, theta)[0]):
        A[n - 1, j] = number(slope)
    b[n - 1, 0] = number(gain)
    return A, b


def _forced(A: flint.arb_mat, B: flint.arb_mat, t: flint.arb) -> flint.arb_mat:
    """int_0^t e^{A s} ds B."""
    n, m = B.nrows(), B.ncols()
    block = flint.arb_mat(n + m, n + m)
    for i in range(n):
        for j in range(n):
            block[i, j] = A[i, j] * t
        for j in range(m):
            block[i, n + j] = B[i, j] * t
    over = block.exp()
    return flint.arb_mat(n, m, [over[i, n + j] for i in range(n) for j in range(m)])


def _compensation(
    A: flint.arb_mat, b: flint.arb_mat, E: flint.arb_mat
) -> tuple[flint.arb_mat, flint.arb_mat]:
    """P and U."""
    n, count = A.nrows(), E.ncols()
    if not count:
        return flint.arb_mat(n, 0), flint.arb_mat(1, 0)
    block, right = flint.arb_mat(n + 1, n + 1), flint.arb_mat(n + 1, count)
    for i in range(n):
        for j in range(n):
            block[i, j] = A[i, j]
        block[i, n] = b[i, 0]
        for j in range(count):
            right[i, j] = -E[i, j]
    block[n, 0] = 1
    try:
        solution = block.solve(right).tolist()
    except ZeroDivisionError:
        nothing = [[flint.arb("nan")] * count for _ in range(n + 1)]
        solution = nothing
    return flint.arb_mat(solution[:n]), flint.arb_mat(solution[n:])


def _floats(matrix: flint.arb_mat) -> np.ndarray:
    """The nearest floats; what may be zero is zero."""
    values = [0.0 if v.contains(0) and v.is_finite() else float(v.mid()) for v in matrix.entries()]
    return np.array(values, dtype=float).reshape(matrix.nrows(), matrix.ncols())
