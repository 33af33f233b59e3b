"""Sampled feed-forward: coefficients of the reference for the loop as it runs.

Hold, delay and filters move x_1 behind y_d, so the law's own feed-forward leaves an error. With the
state chi before a sample and a reference that is a polynomial, (y_d ... y_d^(q)) move over a period
by the matrix Phi, and the loop by

    chi <- M chi + sum_j (b F_j + g_j) y_d^(j),

so chi = sum_j Pi_j y_d^(j), (M - 1) Pi_j = sum_{i<j} Pi_i Phi_ij - b F_j - g_j. The F_j are chosen
one after the other such that x_1 = y_d: the first entry of Pi_j is 1 for j = 0 and 0 else. With an
integral of the error F_j does not bear on that entry, but on the one of the next derivative. The
last one, of y_d^(q+1), is the law's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from certrack.core.errors import DesignError
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable
from certrack.core.memo import remembered
from certrack.core.rounding import in_digits
from certrack.laws.base import Controller, Law
from certrack.laws.equations import Equations
from certrack.laws.observer_model import plant_over_a_period
from certrack.loops.controller_numbers import plain_values
from certrack.loops.linear_controller import LinearController, linear_controller
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant

#: Digits of the coefficients: fewer than what differs between machines.
COEFFICIENT_DIGITS = 13

#: Stands for what is added to the input.
ADDED = symbol("law_added")


def sampled_feedforward(
    plant: Plant, controller: Controller, law: Law, implementation: Implementation
) -> np.ndarray:
    """What stands for nu_Y in the sampled controller.

    Parameters
    ----------
    plant : Plant
    controller : Controller
    law : Law
    implementation : Implementation

    Returns
    -------
    (q + 2,) array
        Of u = (nu - phi^T theta)/g_n.

    Raises
    ------
    DesignError
        If the law or the plant is not linear, or the loop does not follow a constant.
    """
    slopes = _slopes(_structure(plant, controller, law, implementation))
    linear = slopes.linear
    Lx, Ls, LY, Sx, Ss, SY, b_s = _tables(slopes, plant, law, implementation)
    n, memories = plant.n, len(linear.states)
    late = math.floor(implementation.design_delay)
    over, new, old, gain = plant_over_a_period(plant, law, implementation)
    size = n + memories + late + 1  # and the inputs of the samples before

    def moved(x: np.ndarray, s: np.ndarray, past: np.ndarray, added: np.ndarray) -> np.ndarray:
        u = Lx @ x + Ls @ s + added
        inputs = np.vstack([u, past])
        after = Sx @ x + Ss @ s + np.outer(b_s, added)
        x = over @ x + np.outer(new, inputs[late]) + np.outer(old, inputs[late + 1])
        return np.vstack([x, after, inputs[:-1]])

    eye, nothing = np.eye(size), np.zeros((1, size))
    M = moved(eye[:n], eye[n : n + memories], eye[n + memories :], nothing)
    zero = np.zeros((size, 1))
    b = moved(zero[:n], zero[n : n + memories], zero[n + memories :], np.ones((1, 1)))[:, 0]
    direct = SY - np.outer(b_s, LY)  # of the memories, besides what the command gives them
    q = LY.shape[1] - 2
    F = LY[0].copy()
    columns: list[np.ndarray] = []

    def column(j: int) -> np.ndarray:
        """Pi_j but for F_j, where the columns before it are known."""
        right = np.zeros(size)
        for i in range(j):
            order = j - i
            right = right + columns[i] * implementation.period**order / math.factorial(order)
        right[n : n + memories] -= direct[:, j]
        return np.linalg.solve(M - eye, right)

    of_F = np.linalg.solve(M - eye, -b)
    later = np.linalg.solve(M - eye, of_F * implementation.period)[0]  # of the next derivative
    for j in range(q + 1):
        without = column(j)
        if law.integral is None:
            F[j] = (float(j == 0) - without[0]) / of_F[0]
        else:
            columns.append(without)
            F[j] = -column(j + 1)[0] / later
            columns.pop()
        columns.append(without + of_F * F[j])
    if not np.isfinite(F).all():
        raise DesignError(
            "law.sampled_feedforward", "finds no steady motion of the loop", remedy="Leave it out"
        )
    return np.array([in_digits(v, COEFFICIENT_DIGITS) for v in F * gain])


@dataclass(frozen=True)
class _Slopes:
    """What depends on the structure of a loop, and not on its numbers.

    Attributes
    ----------
    linear : LinearController
    values : callable
        Of the controller's parameters: the slopes, row by row.
    """

    linear: LinearController
    values: Callable[..., list[Any]]


@dataclass(frozen=True)
class _Structure:
    """A loop; those are equal that differ in numbers alone.

    Attributes
    ----------
    plant : Plant
    equations : Equations
    estimated, of_drive : what else decides the formulas of observer and implementation
    controller, implementation
        One that has this structure.
    """

    plant: Plant
    equations: Equations
    estimated: tuple[Any, ...] | None
    of_drive: tuple[Any, ...]
    controller: Controller = field(compare=False)
    implementation: Implementation = field(compare=False)


def _structure(
    plant: Plant, controller: Controller, law: Law, implementation: Implementation
) -> _Structure:
    observer = law.observer
    estimated = (
        None if observer is None else (observer.kind, observer.rows, observer.bandwidth is None)
    )
    of_drive = tuple(
        getattr(implementation, entry.name)
        for entry in fields(implementation)
        if entry.name != "period"
    )
    equations = controller.equations
    return _Structure(plant, equations, estimated, of_drive, controller, implementation)


@remembered
def _slopes(loop: _Structure) -> _Slopes:
    """The slopes as functions, compiled once: searches and margins ask for them all the time."""
    linear = linear_controller(
        loop.plant, loop.controller, loop.implementation, loop.equations.u + ADDED
    )
    sampled = linear.controller
    slopes = linear.slopes((*sampled.measured, *linear.states, *sampled.Y, ADDED))
    known = set(sampled.parameters)
    if any(entry.free_symbols - known for row in slopes for entry in row):
        raise DesignError(
            "law.sampled_feedforward",
            "needs a loop that is linear: a robust law and a linear drift",
            remedy="Leave it out",
        )
    flat = [entry for row in slopes for entry in row]
    return _Slopes(linear, numpy_callable(sampled.parameters, flat))


def _tables(
    slopes: _Slopes, plant: Plant, law: Law, implementation: Implementation
) -> tuple[np.ndarray, ...]:
    """Slopes of the command and of the memories, those by what is added of the memories only."""
    linear = slopes.linear
    controller, rows = linear.controller, len(linear.formulas)
    flat = slopes.values(*plain_values(controller, plant, law, implementation))
    table = np.array([np.asarray(v, float) for v in flat]).reshape(rows, -1)
    n, m = len(controller.measured), len(linear.states)
    of_u, of_s = table[:1], table[1:]
    parts = [part for of in (of_u, of_s) for part in np.split(of[:, :-1], [n, n + m], axis=1)]
    return (*parts, of_s[:, -1])
