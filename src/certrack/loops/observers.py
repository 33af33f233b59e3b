"""An observer in discrete time: the steps of a sample, and what is remembered until the next one.

Of the states that it predicts (all, or the rows on which it estimates what acts), with the numbers
of :mod:`certrack.laws.observer_model`:

    miss_j = x_j - expected_j                           of what is measured, or differenced
    x^_i   = expected_i + sum_j L_ij miss_j             ``kalman`` and ``eso``
    d^_k   = d_k + sum_j L_kj miss_j                    ``eso`` and ``dob``
    u_law  = law(x^ - P d^) + U d^
    expected_i at the next sample = F x^ + G d^ + B_new u + B_old u + G_n remainder(x^)

with the commands within their limits, as they act over the period. At the first sample nothing is
missed: what is not measured begins at rest, as a difference does, and d at zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.core.select import Select
from certrack.laws.base import Law
from certrack.laws.observer import DOB
from certrack.laws.observer_model import (
    known_plant,
    linear_part,
    observer_model,
)
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant


@dataclass(frozen=True)
class Estimation:
    """What an observer adds to a sampled controller.

    Attributes
    ----------
    steps : pairs (symbol, formula)
    memories : triples (symbol, next value, value before the first sample)
        The last one over the measured states, such that the first sample misses nothing, or
        :data:`INPUT_BEFORE`.
    numbers : symbols
        Those of :func:`observer_values` that occur.
    values : mapping
        What the law takes for the states.
    compensation : formula
        Added to the law's input.
    """

    steps: tuple[tuple[sympy.Symbol, sympy.Expr], ...]
    memories: tuple[tuple[sympy.Symbol, sympy.Expr, sympy.Expr], ...]
    numbers: tuple[sympy.Symbol, ...]
    values: dict[sympy.Symbol, sympy.Expr]
    compensation: sympy.Expr


#: The input before the first sample, which past commands begin with.
INPUT_BEFORE = symbol("ctl_u_before")


def past_command(age: int) -> sympy.Symbol:
    """The command of so many samples ago, as it is remembered."""
    return symbol(f"ctl_past_u_{age}")


def at_rest(plant: Plant, velocity: Sequence[str]) -> dict[sympy.Symbol, sympy.Expr]:
    """What stands for the states at the first sample: those before them do not move."""
    x, values = plant.symbols, dict(zip(plant.symbols, plant.symbols, strict=True))
    for i in range(1, plant.n):
        if plant.states[i] in velocity:
            assert plant.linear is not None
            row = (b.expr * values[x[j]] for j, b in enumerate(plant.linear[i - 1]))
            values[x[i]] = -sympy.Add(*row) / plant.chain[i - 1].expr
    return values


def estimation(
    plant: Plant,
    law: Law,
    implementation: Implementation,
    differences: Mapping[sympy.Symbol, sympy.Expr],
    command: sympy.Symbol,
    first: sympy.Symbol,
) -> Estimation:
    """The observer of a law.

    Parameters
    ----------
    plant : Plant
    law : Law
        Has an observer.
    implementation : Implementation
    differences : mapping
        What stands for states that are not measured; of ``dob``.
    command : symbol
        The input that is commands out.
    first : symbol
        1 at the first sample, then 0.
    """
    assert law.observer is not None
    observer = law.observer.bound_to(plant, implementation)
    model, x = observer_model(plant, law, implementation), plant.symbols
    names = dict(zip(plant.states, x, strict=True))
    used: dict[sympy.Symbol, None] = {}
    number = _naming(used)
    dob = observer.kind == DOB
    measured = {state: differences.get(state, state) for state in x}
    still = at_rest(plant, implementation.velocity)
    predicted = [names[row] for row in observer.rows] if dob else list(x)
    seen = predicted if dob else [s for s in x if s.name not in implementation.velocity]

    steps: list[tuple[sympy.Symbol, sympy.Expr]] = []
    for state in predicted:
        begin = measured[state] if dob else still[state]
        chosen = Select(first, 0, begin, _predicted(state))
        steps.append((symbol(f"ctl_expected_{state}"), chosen))
    misses = [symbol(f"ctl_miss_{state}") for state in seen]
    for state, miss in zip(seen, misses, strict=True):
        steps.append((miss, measured[state] - symbol(f"ctl_expected_{state}")))
    x_hat = dict(measured)
    if not dob:
        x_hat = {state: symbol(f"ctl_{state}_hat") for state in x}
        for i, state in enumerate(x):
            added = _sum(
                number(model.correction[i, j], "correct", state, seen[j]) * miss
                for j, miss in enumerate(misses)
            )
            steps.append((x_hat[state], symbol(f"ctl_expected_{state}") + added))
    below = 0 if dob else plant.n
    d_hat = [symbol(f"ctl_d_{row}_hat") for row in observer.rows]
    for k, row in enumerate(observer.rows):
        added = _sum(
            number(model.correction[below + k, j], "correct", f"d_{row}", seen[j]) * miss
            for j, miss in enumerate(misses)
        )
        steps.append((d_hat[k], _disturbance(row) + added))

    values = {s: v for s, v in x_hat.items() if v != s}
    for i, state in enumerate(x):
        moved = _sum(
            number(model.P[i, k], "steady", state, f"d_{row}") * d_hat[k]
            for k, row in enumerate(observer.rows)
        )
        if moved != 0:
            values[state] = symbol(f"ctl_{state}_less")
            steps.append((values[state], x_hat[state] - moved))
    compensation = _sum(
        number(model.U[k], "counter", f"d_{row}") * d_hat[k] for k, row in enumerate(observer.rows)
    )
    late, count = _commands(implementation.design_delay)
    steps += [(symbol(f"ctl_u_{age}"), past_command(age)) for age in range(1, count + 1)]
    commands = [command, *(symbol(f"ctl_u_{age}") for age in range(1, count + 1))]

    remainder = linear_part(plant, known_plant(plant, law)[1])[1].xreplace(x_hat)
    if remainder != 0:
        steps.append((symbol("ctl_remainder"), remainder))
        remainder = symbol("ctl_remainder")
    memories: list[tuple[sympy.Symbol, sympy.Expr, sympy.Expr]] = []
    for state in predicted:
        i = x.index(state)
        after = _sum(
            number(model.F[i, j], "over", state, x[j]) * x_hat[x[j]] for j in range(plant.n)
        )
        after += _sum(
            number(model.G[i, k], "push", state, f"d_{row}") * d_hat[k]
            for k, row in enumerate(observer.rows)
        )
        after += number(model.new[i], "new", state) * commands[late]
        if count > late:
            after += number(model.old[i], "old", state) * commands[late + 1]
        if remainder != 0:
            after += number(model.remainder[i], "remainder", state) * remainder
        memories.append((_predicted(state), after, still[state]))
    memories += [(_disturbance(row), d_hat[k], sympy.S.Zero) for k, row in enumerate(observer.rows)]
    memories += [
        (past_command(age), commands[age - 1], INPUT_BEFORE) for age in range(1, count + 1)
    ]
    return Estimation(tuple(steps), tuple(memories), tuple(used), values, compensation)


def _predicted(state: sympy.Symbol) -> sympy.Symbol:
    return symbol(f"ctl_predicted_{state}")


def _disturbance(row: str) -> sympy.Symbol:
    return symbol(f"ctl_d_{row}")


def _commands(delay: float) -> tuple[int, int]:
    """Whole periods of the delay, and how many past commands are remembered for it."""
    late = math.floor(delay)
    return late, late + (delay > late)


def _sum(terms: Iterable[sympy.Expr]) -> sympy.Expr:
    return sympy.Add(*terms)


#: Gives the symbol of a number by the words of its name, or zero for a number that is.
Naming = Callable[..., sympy.Expr]


def _naming(used: dict[sympy.Symbol, None]) -> Naming:
    def number(value: float, *words: object) -> sympy.Expr:
        if value == 0:
            return sympy.S.Zero
        name = symbol("_".join(("ctl", *map(str, words))))
        used[name] = None
        return name

    return number


def observer_values(
    plant: Plant, law: Law, implementation: Implementation
) -> dict[sympy.Symbol, float]:
    """Numbers of a law's observer by their symbols; empty if it has none."""
    if law.observer is None:
        return {}
    observer = law.observer.bound_to(plant, implementation)
    model, states = observer_model(plant, law, implementation), plant.states
    d = [f"d_{row}" for row in observer.rows]
    dob = observer.kind == DOB
    seen = observer.rows if dob else [s for s in states if s not in implementation.velocity]
    corrected = d if dob else [*states, *d]
    tables = {
        "over": (model.F, states, states),
        "push": (model.G, states, d),
        "correct": (model.correction, corrected, seen),
        "steady": (model.P, states, d),
    }
    rows = {
        "new": (model.new, states),
        "old": (model.old, states),
        "remainder": (model.remainder, states),
        "counter": (model.U, d),
    }
    values = {
        symbol(f"ctl_{word}_{a}_{b}"): float(table[i, j])
        for word, (table, left, right) in tables.items()
        for i, a in enumerate(left)
        for j, b in enumerate(right)
    }
    return values | {
        symbol(f"ctl_{word}_{a}"): float(value)
        for word, (numbers, names) in rows.items()
        for value, a in zip(np.atleast_1d(numbers), names, strict=True)
    }
