"""The sampled controller as a program that reads like the law: named formulas, in order.

:mod:`certrack.loops.controller` says what is computed; here its formulas get the names of the
field (e_n, nu, ubar, the rates of the estimates) and its numbers. The languages differ in how they
print a program only. Putting the names back gives the same formulas: this is checked, and where a
law uses its signals in another way, the formulas stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.lowering import Select, larger, magnitude
from certrack.laws.base import Equations, Signals
from certrack.loops.controller import (
    COMMAND,
    LAW_INPUT,
    PERIOD,
    SampledController,
    controller_values,
    differenced,
    forgetting_rates,
    next_estimates,
    sampled_controller,
    starting_state,
)
from certrack.model.implementation import Implementation
from certrack.systems.system import System

E_N, NU, UBAR, DRIFT, CUT = (symbol(f"ctl_{name}") for name in ("e_n", "nu", "ubar", "h", "cut"))

#: Gains that are printed as numbers in the linear forms e_n and nu; all others are named.
LINEAR = ("A_n", "B_n", "nu_x", "nu_Y", "sign_g")

#: Powers up to this one are products.
MOST_FACTORS = 8

NOTES = {
    E_N: "last error coordinate: e_n = A_n x - B_n (y_d, y_d', ...)",
    NU: "what all laws share: nu = nu_x x + nu_Y (y_d, y_d', ...) - h(x)",
    UBAR: "ubar = nu - phi(x)^T theta_hat",
    DRIFT: "drift h(x)",
    LAW_INPUT: "the input that the law asks for",
    COMMAND: "the input within its limits",
    CUT: "what the limits cut off; the estimates stand still meanwhile",
}


@dataclass(frozen=True)
class Step:
    """One formula and what it means."""

    name: sympy.Symbol
    formula: sympy.Expr
    note: str = ""


@dataclass(frozen=True)
class Program:
    """What is computed at a sample.

    Attributes
    ----------
    controller : SampledController
        What the program computes.
    measured, Y, states : symbols
        Inputs: measured plant states, y_d ... y_d^(q+1), the controller's own states.
    steps : Steps
        From the inputs to :data:`~certrack.loops.controller.COMMAND`.
    rates : Steps
        Of the estimates; of everything above.
    update : formulas
        Next value of each state; contains none of the other states.
    constants : mapping
        Numbers of the named constants that occur.
    labels : mapping
        Natural name of every symbol but the period and Y.
    start : numbers
        The states before the first sample.
    """

    controller: SampledController
    measured: tuple[sympy.Symbol, ...]
    Y: tuple[sympy.Symbol, ...]
    states: tuple[sympy.Symbol, ...]
    steps: tuple[Step, ...]
    rates: tuple[Step, ...]
    update: tuple[sympy.Expr, ...]
    constants: dict[sympy.Symbol, float]
    labels: dict[sympy.Symbol, str]
    start: tuple[float, ...]

    @property
    def formulas(self) -> Iterator[sympy.Expr]:
        """All of them."""
        yield from (step.formula for step in (*self.steps, *self.rates))
        yield from self.update


def unread(system: System) -> dict[str, str]:
    """States whose measurement the controller does not read, and what to say of each."""
    implementation, states = system.implementation, system.plant.states
    velocity = () if implementation is None else implementation.velocity
    return {
        name: f"not read; computed from {before}"
        for before, name in pairwise(states)
        if name in velocity
    }


def program(system: System) -> Program:
    """The controller of a system that has an implementation."""
    implementation, plant = system.implementation, system.plant
    if implementation is None:
        raise InputError(
            "implementation", "is missing", remedy="Add a table [implementation], or give a period"
        )
    full = sampled_controller(plant, system.controller, implementation)
    numbers = controller_values(full, plant, system.law, implementation).tolist()
    values = dict(zip(full.parameters, numbers, strict=True))
    known = _numbers(system, full, values)
    parts, equations = _named(system)
    x = {
        name: differenced(name.name)
        for name in plant.symbols
        if name.name in implementation.velocity
    }
    rates, update = _update(full, implementation, equations, x)
    rates = _printable(rates, known, "r")
    update = tuple(formula.xreplace(known) for formula in update)
    steps = _steps(full, [*parts, Step(LAW_INPUT, equations.u, NOTES[LAW_INPUT])], x, known)
    needed = {COMMAND}.union(*(f.free_symbols for f in (*update, *(r.formula for r in rates))))
    steps = _without_idle(steps, needed)
    used = needed.union(*(step.formula.free_symbols for step in steps))
    made = Program(
        controller=full,
        measured=full.measured,
        Y=full.Y,
        states=full.states,
        steps=tuple(steps),
        rates=tuple(rates),
        update=update,
        constants={name: value for name, value in values.items() if name in used},
        labels={},
        start=tuple(starting_state(full, system.estimates, implementation).tolist()),
    )
    return replace(made, labels=_labels(system, made))


#: What stands for the states that are not measured, and for numbers.
Known = Mapping[sympy.Symbol, sympy.Expr]


def _steps(full: SampledController, law: Sequence[Step], x: Known, known: Known) -> list[Step]:
    """From the inputs to the command, by the law's own steps."""
    before = [Step(*step, _velocity_note(step[0])) for step in full.steps[:-2]]
    within = [replace(step, formula=step.formula.xreplace(x)) for step in law]
    command = full.steps[-1][1]
    if command == LAW_INPUT:  # without limits
        within[-1] = replace(within[-1], name=COMMAND)
        return _printable([*before, *within], known, "t")
    limited = Step(COMMAND, command, NOTES[COMMAND])
    return [*_printable([*before, *within], known, "t"), limited]


def _update(
    full: SampledController, implementation: Implementation, equations: Equations, x: Known
) -> tuple[list[Step], tuple[sympy.Expr, ...]]:
    """The rates of the estimates, and the next states by them."""
    rates = [
        Step(symbol(f"ctl_rate_{z.name}"), rate.xreplace(x), "" if i else "rates of the estimates")
        for i, (z, rate) in enumerate(equations.update)
    ]
    known = {*full.parameters, *full.estimates}
    forgetting = forgetting_rates([rate for _, rate in equations.update], known)
    names = [step.name for step in rates]
    after = next_estimates(full.estimates, names, forgetting, full.hold, implementation)
    size = magnitude(LAW_INPUT - COMMAND)
    if any(formula.has(size) for formula in after):
        after = [formula.xreplace({size: CUT}) for formula in after]
        rates.append(Step(CUT, size, NOTES[CUT]))
    return rates, (*after, *full.update[len(after) :])


def _named(system: System) -> tuple[list[Step], Equations]:
    """Parts of the law by their names, and the law in these names."""
    plant, controller = system.plant, system.controller
    exact = controller.signals
    short = Signals(plant, exact.q)
    short.e_n, short.nu = E_N, NU
    short.phi = tuple(symbol(f"ctl_phi_{i + 1}") for i in range(plant.r))
    equations = system.law.equations(short)
    phi = dict(zip(short.phi, exact.phi, strict=True))
    back = phi | {E_N: exact.e_n, NU: exact.nu}
    same = [
        left.xreplace(back) == right
        for left, right in zip(_all(equations), _all(controller.equations), strict=True)
    ]
    if not all(same):
        return [], controller.equations
    drift = plant.drift.expr
    parts = [Step(DRIFT, drift, NOTES[DRIFT])] if drift != 0 else []
    parts += [Step(s, formula, "regressor phi(x)") for s, formula in phi.items()]
    nu = exact.nu + drift - (DRIFT if drift != 0 else 0)
    parts += [Step(E_N, exact.e_n, NOTES[E_N]), Step(NU, nu, NOTES[NU])]
    rates = [rate for _, rate in equations.update]
    for factor in sympy.Mul.make_args(equations.u):
        if isinstance(factor, sympy.Add) and any(rate.has(factor) for rate in rates):
            parts.append(Step(UBAR, factor, NOTES[UBAR]))
            put = {factor: UBAR}
            update = tuple((z, rate.xreplace(put)) for z, rate in equations.update)
            equations = Equations(equations.u.xreplace(put), update)
            break
    return parts, equations


def _without_idle(steps: Sequence[Step], needed: set[sympy.Symbol]) -> list[Step]:
    """Without the steps that nothing depends on: a gain may be zero."""
    for step in reversed(steps):
        needed = needed | step.formula.free_symbols if step.name in needed else needed
    return [step for step in steps if step.name in needed]


def _all(equations: Equations) -> list[sympy.Expr]:
    return [equations.u, *(part for pair in equations.update for part in pair)]


def _velocity_note(name: sympy.Symbol) -> str:
    if name.name.startswith("ctl_filtered_"):
        return "filtered difference of the state before it"
    return "not measured: (difference - sum_j b_ij x_j)/g_i"


def _numbers(
    system: System, full: SampledController, values: dict[sympy.Symbol, float]
) -> dict[sympy.Symbol, sympy.Expr]:
    """Parameters that do not get a name: of linear forms, and gains that are zero."""
    groups = system.controller.signals.all_parameters
    linear = {name for group in LINEAR for name in groups.get(group, ())}
    gains = full.parameters[: len(system.controller.symbols)]
    return {name: _number(values[name]) for name in gains if name in linear or values[name] == 0}


def _number(value: float) -> sympy.Expr:
    return sympy.Integer(int(value)) if value in (-1, 0, 1) else sympy.Float(value)


def _printable(steps: Iterable[Step], known: Known, letter: str) -> list[Step]:
    """Steps with numbers; what is costly and occurs twice is computed once."""
    steps = [replace(s, formula=_selections(s.formula.xreplace(known))) for s in steps]
    names = (symbol(f"ctl_{letter}_{i}") for i in range(1, 1_000_000))
    found: list[Step] = []
    common, reduced = sympy.cse([step.formula for step in steps], names)
    inline: dict[sympy.Symbol, sympy.Expr] = {}
    costly: dict[sympy.Symbol, sympy.Expr] = {}
    for name, formula in common:
        plain = formula.xreplace(inline)
        if _is_costly(plain):
            costly[name] = plain
        else:
            inline[name] = plain
    for step, formula in zip(steps, reduced, strict=True):
        formula = formula.xreplace(inline)
        found += _needed(formula, costly)
        bases = {base: next(names) for base in _bases(formula)}
        found += [Step(name, base) for base, name in bases.items()]
        found.append(replace(step, formula=formula.xreplace(bases)))
    return found


def _needed(formula: sympy.Expr, costly: dict[sympy.Symbol, sympy.Expr]) -> list[Step]:
    """Shared parts that `formula` needs and nobody needed before, in order."""
    found: list[Step] = []
    for name in sorted(formula.free_symbols & costly.keys(), key=list(costly).index):
        if name in costly:
            part = costly.pop(name)
            found += [*_needed(part, costly), Step(name, part)]
    return found


def _is_costly(formula: sympy.Expr) -> bool:
    return formula.has(sympy.Function) or any(
        not power.exp.is_Integer or (power.exp < 0 and not power.base.is_Symbol)
        for power in formula.atoms(sympy.Pow)
    )


def _bases(formula: sympy.Expr) -> Sequence[sympy.Expr]:
    """Bases of printed products that are no plain names."""
    powers = sorted(formula.atoms(sympy.Pow), key=sympy.default_sort_key)
    return list(
        dict.fromkeys(
            power.base
            for power in powers
            if power.exp.is_Integer
            and 2 <= abs(power.exp) <= MOST_FACTORS
            and power.base.free_symbols
            and not power.base.is_Symbol
        )
    )


def _selections(formula: sympy.Expr) -> sympy.Expr:
    """Without min and max."""

    def fold(*args: sympy.Expr, sense: int) -> sympy.Expr:
        result = args[0]
        for other in args[1:]:
            result = larger(result, other) if sense > 0 else Select(other, result, result, other)
        return result

    return formula.replace(sympy.Max, lambda *args: fold(*args, sense=1)).replace(
        sympy.Min, lambda *args: fold(*args, sense=-1)
    )


def _labels(system: System, made: Program) -> dict[sympy.Symbol, str]:
    """Natural names."""
    found = dict(zip(made.measured, system.plant.states, strict=True))
    r = system.plant.r
    for group, names in system.controller.signals.all_parameters.items():
        square = len(names) == r * r and r > 1
        for i, name in enumerate(names):
            index = f"_{i // r + 1}_{i % r + 1}" if square else f"_{i + 1}"
            found[name] = group + (index if len(names) > 1 else "")
    found |= {symbol(name): name for name in system.plant.constant_values}
    estimates = [z.name for z in made.controller.estimates]
    for i, z in enumerate(estimates):
        found[symbol(f"ctl_box_{2 * i}")] = f"{z}_low"
        found[symbol(f"ctl_box_{2 * i + 1}")] = f"{z}_high"
        found[symbol(f"ctl_rate_{z}")] = f"{z}_rate"
    found |= {symbol(f"ctl_hold_{i}_{j}"): f"hold_{i + 1}_{j + 1}" for i, j in made.controller.hold}
    own = {step.name for step in (*made.steps, *made.rates)} | set(made.states)
    for name in own | set(made.controller.parameters):
        found.setdefault(name, name.name.removeprefix("ctl_").removeprefix("value_"))
    found[PERIOD] = "period"
    return found
