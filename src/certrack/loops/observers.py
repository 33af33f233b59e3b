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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.core.select import Select
from certrack.laws.base import Law
from certrack.laws.observer import DOB
from certrack.laws.observer_model import (
    ObserverModel,
    known_plant,
    linear_part,
    observer_model,
)
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant

#: A symbol, and the formula that it stands for.
NamedFormula = tuple[sympy.Symbol, sympy.Expr]


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
    o = _Observed.of(plant, law, implementation)
    still = at_rest(plant, implementation.velocity)
    measured = {state: differences.get(state, state) for state in plant.symbols}
    x_hat, steps = o.corrected_states(measured, measured if o.is_dob else still, first)
    d_hat = [symbol(f"ctl_{name}_hat") for name in o.d]
    for k, name in enumerate(o.d):
        steps.append((d_hat[k], symbol(f"ctl_{name}") + o.correction(len(o.corrected) + k, name)))
    values = {s: v for s, v in x_hat.items() if v != s}
    for i, state in enumerate(plant.symbols):
        moved = o.combined(o.model.P[i], o.d, d_hat, "steady", state)
        if moved != 0:
            values[state] = symbol(f"ctl_{state}_less")
            steps.append((values[state], x_hat[state] - moved))
    compensation = o.combined(o.model.U, o.d, d_hat, "counter")

    late, count = _commands(implementation.design_delay)
    steps += [(symbol(f"ctl_u_{age}"), past_command(age)) for age in range(1, count + 1)]
    commands = [command, *(symbol(f"ctl_u_{age}") for age in range(1, count + 1))]
    remainder = linear_part(plant, known_plant(plant, law)[1])[1].xreplace(x_hat)
    if remainder != 0:
        steps.append((symbol("ctl_remainder"), remainder))
        remainder = symbol("ctl_remainder")
    old = commands[late + 1] if count > late else sympy.S.Zero
    memories: list[tuple[sympy.Symbol, sympy.Expr, sympy.Expr]] = []
    for state in o.predicted:
        after = o.prediction(state, x_hat, d_hat, commands[late], old, remainder)
        memories.append((_predicted(state), after, still[state]))
    memories += [(symbol(f"ctl_{d}"), v, sympy.S.Zero) for d, v in zip(o.d, d_hat, strict=True)]
    memories += [
        (past_command(age), commands[age - 1], INPUT_BEFORE) for age in range(1, count + 1)
    ]
    return Estimation(tuple(steps), tuple(memories), tuple(o.used), values, compensation)


@dataclass(frozen=True)
class _Observed:
    """An observer's numbers, and the signals that they belong to.

    Attributes
    ----------
    x : symbols of the states
    d : names of what acts on the rows
    predicted, seen : symbols of the states that are predicted, and that are measured of them
    used : symbols of numbers, in the order in which they occur
    """

    model: ObserverModel
    is_dob: bool
    x: tuple[sympy.Symbol, ...]
    d: tuple[str, ...]
    predicted: tuple[sympy.Symbol, ...]
    seen: tuple[sympy.Symbol, ...]
    used: dict[sympy.Symbol, None]

    @classmethod
    def of(cls, plant: Plant, law: Law, implementation: Implementation) -> _Observed:
        """The observer of a law."""
        assert law.observer is not None
        observer = law.observer.bound_to(plant, implementation)
        model, x = observer_model(plant, law, implementation), plant.symbols
        is_dob, unseen = observer.kind == DOB, implementation.velocity
        predicted = tuple(s for s in x if s.name in observer.rows) if is_dob else tuple(x)
        seen = predicted if is_dob else tuple(s for s in x if s.name not in unseen)
        d = tuple(f"d_{row}" for row in observer.rows)
        return cls(model, is_dob, tuple(x), d, predicted, seen, {})

    @property
    def corrected(self) -> tuple[sympy.Symbol, ...]:
        """The states that are estimated by a correction; ``dob`` takes them as they are."""
        return () if self.is_dob else self.x

    def number(self, value: float, *words: object) -> sympy.Expr:
        """The symbol of a number by the words of its name; zero for a number that is."""
        if value == 0:
            return sympy.S.Zero
        name = symbol("_".join(("ctl", *map(str, words))))
        self.used[name] = None
        return name

    def combined(
        self,
        numbers: np.ndarray,
        names: Sequence[object],
        values: Sequence[sympy.Expr],
        *words: object,
    ) -> sympy.Expr:
        """The sum of numbers, which are called by words and names, times values."""
        entries = zip(numbers.tolist(), names, values, strict=True)
        return sympy.Add(*(self.number(v, *words, name) * value for v, name, value in entries))

    def correction(self, row: int, estimated: object) -> sympy.Expr:
        """What is added to an estimate for what was missed."""
        misses = [symbol(f"ctl_miss_{state}") for state in self.seen]
        return self.combined(self.model.correction[row], self.seen, misses, "correct", estimated)

    def corrected_states(
        self,
        measured: Mapping[sympy.Symbol, sympy.Expr],
        begin: Mapping[sympy.Symbol, sympy.Expr],
        first: sympy.Symbol,
    ) -> tuple[dict[sympy.Symbol, sympy.Expr], list[NamedFormula]]:
        """The states as they are estimated, and the steps up to there."""
        steps: list[NamedFormula] = []
        for state in self.predicted:
            expected = Select(first, 0, begin[state], _predicted(state))
            steps.append((symbol(f"ctl_expected_{state}"), expected))
        for state in self.seen:
            miss = measured[state] - symbol(f"ctl_expected_{state}")
            steps.append((symbol(f"ctl_miss_{state}"), miss))
        x_hat = dict(measured)
        for i, state in enumerate(self.corrected):
            x_hat[state] = symbol(f"ctl_{state}_hat")
            added = self.correction(i, state)
            steps.append((x_hat[state], symbol(f"ctl_expected_{state}") + added))
        return x_hat, steps

    def prediction(
        self,
        state: sympy.Symbol,
        x_hat: Mapping[sympy.Symbol, sympy.Expr],
        d_hat: Sequence[sympy.Expr],
        new: sympy.Expr,
        old: sympy.Expr,
        remainder: sympy.Expr,
    ) -> sympy.Expr:
        """A state at the next sample; commands and remainders that are zero have no number."""
        i, model = self.x.index(state), self.model
        after = self.combined(model.F[i], self.x, [x_hat[s] for s in self.x], "over", state)
        after += self.combined(model.G[i], self.d, d_hat, "push", state)
        inputs = {"new": (model.new, new), "old": (model.old, old)}
        inputs["remainder"] = model.remainder, remainder
        for word, (numbers, value) in inputs.items():
            if value != 0:
                after += self.number(numbers[i], word, state) * value
        return after


def _predicted(state: sympy.Symbol) -> sympy.Symbol:
    return symbol(f"ctl_predicted_{state}")


def _commands(delay: float) -> tuple[int, int]:
    """Whole periods of the delay, and how many past commands are remembered for it."""
    late = math.floor(delay)
    return late, late + (delay > late)


def observer_values(
    plant: Plant, law: Law, implementation: Implementation
) -> dict[sympy.Symbol, float]:
    """Numbers of a law's observer by their symbols; empty if it has none."""
    if law.observer is None:
        return {}
    o = _Observed.of(plant, law, implementation)
    model = o.model
    tables = {
        "over": (model.F, o.x, o.x),
        "push": (model.G, o.x, o.d),
        "correct": (model.correction, (*o.corrected, *o.d), o.seen),
        "steady": (model.P, o.x, o.d),
    }
    rows = {
        "new": (model.new, o.x),
        "old": (model.old, o.x),
        "remainder": (model.remainder, o.x),
        "counter": (model.U, o.d),
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
