"""The sampled controller as a program that reads like the law: named formulas, in order.

:mod:`certrack.loops.controller` says what is computed; here its formulas get the names of the
field (e_n, nu, ubar, the rates of the estimates) and its numbers. The languages differ in how they
print a program only. Putting the names back gives the same formulas: this is checked, and where a
law uses its signals in another way, the formulas stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise

import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, symbol
from certrack.core.kinks import fold_minmax
from certrack.core.printing import MAX_FACTORS
from certrack.core.select import larger, magnitude, smaller
from certrack.export.step_notes import note_before_the_law
from certrack.laws.baselines.mpc import require_formula
from certrack.laws.equations import Equations
from certrack.laws.observer import DOB
from certrack.laws.signals import Signals
from certrack.loops.controller import (
    COMMAND,
    LAW_INPUT,
    PERIOD,
    SAMPLE_TIME,
    SampledController,
    forgetting_rates,
    next_estimates,
    sampled_controller,
    starting_state,
)
from certrack.loops.controller_values import controller_values
from certrack.model.implementation import Implementation
from certrack.systems.system import System, require_system

E_N, NU, UBAR, DRIFT, CUT = (symbol(f"ctl_{name}") for name in ("e_n", "nu", "ubar", "h", "cut"))

#: Gains that are printed as numbers in the linear forms e_n and nu; all others are named.
LINEAR_FORM_GAINS = ("A_n", "B_n", "A_n0", "nu_x", "nu_Y", "nu_0", "sign_g")

#: Those of them that are no parameters at run time either.
FIXED_GAINS = ("sign_g",)

#: What whoever tunes by hand must know of these forms.
DERIVED_NUMBERS = (
    "numbers made from the gains, chain and linear: change the system file and export again"
)

NOTES = {
    E_N: f"last error coordinate: e_n = A_n x - B_n (y_d, y_d', ...)\n{DERIVED_NUMBERS}",
    NU: f"what all laws share: nu = nu_x x + nu_Y (y_d, y_d', ...) - h(x)\n{DERIVED_NUMBERS}",
    UBAR: "ubar = nu - phi(x)^T theta_hat",
    DRIFT: "drift h(x)",
    LAW_INPUT: "the input that the law asks for",
    COMMAND: "the input within its limits",
}

#: What the estimates do while the input is limited, by the kind of anti-windup.
CUT_NOTES = {
    "leak": "what the limits cut off; meanwhile the estimates only leak towards the priors",
    "hold": "what the limits cut off; meanwhile the estimates stand still",
}


@dataclass(frozen=True)
class Step:
    """One formula and what it means, in one line or more."""

    name: sympy.Symbol
    formula: sympy.Expr
    note: str = ""


@dataclass(frozen=True)
class ControllerProgram:
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
    parameters : symbols
        Those of the constants that may change at run time; usually none.
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
    parameters: tuple[sympy.Symbol, ...] = ()


def sampled_system(system: System, period: float | None = None) -> System:
    """The system with an implementation: its own, or one of the period alone.

    Parameters
    ----------
    system : System
    period : float > 0, s, optional
        Instead of that of the implementation.

    Raises
    ------
    InputError
        If there is no period.
    """
    require_system(system)
    implementation = system.implementation
    if implementation is None and period is None:
        raise InputError(
            "implementation", "is missing", remedy="Add a table [implementation] or give --period"
        )
    if period is None:
        return system
    if implementation is None:
        return system.replace(implementation=Implementation(period=period))
    return system.replace(implementation=replace(implementation, period=period))


def unread_states(system: System) -> dict[str, str]:
    """States whose measurement the controller does not read, and what to say of each."""
    implementation, states = system.implementation, system.plant.states
    velocity = () if implementation is None else implementation.velocity
    observer = system.law.observer
    if observer is not None and observer.kind != DOB:
        return {name: "not read; estimated" for name in states if name in velocity}
    return {
        name: f"not read; computed from {before}"
        for before, name in pairwise(states)
        if name in velocity
    }


def read_symbols(program: ControllerProgram) -> set[sympy.Symbol]:
    """All symbols that a sample depends on."""
    formulas = [step.formula for step in (*program.steps, *program.rates)]
    return set().union(*(formula.free_symbols for formula in (*formulas, *program.update)))


def controller_program(system: System, *, parameters: bool = False) -> ControllerProgram:
    """The controller of a system that has an implementation.

    With `parameters`, what the design made (gains, the coefficients of e_n and nu, weights of
    rates) are named constants that may change at run time, unless they are zero.

    Raises
    ------
    InputError
        If it has none.
    """
    implementation, plant = system.implementation, system.plant
    if implementation is None:
        raise InputError(
            "implementation", "is missing", remedy="Add a table [implementation], or give a period"
        )
    require_formula(system.law, implementation, "export")
    controller = sampled_controller(plant, system.controller, implementation)
    numbers = controller_values(controller, plant, system.law, implementation).tolist()
    values = dict(zip(controller.parameters, numbers, strict=True))
    printed = FIXED_GAINS if parameters else LINEAR_FORM_GAINS
    unnamed = _unnamed_numbers(system, controller, values, printed)
    parts, equations = _named_parts(system)
    x = dict(controller.values)
    x[TIME] = SAMPLE_TIME
    rates, update = _update(controller, implementation, equations, x)
    rates = _printable(rates, unnamed, "r")
    update = tuple(formula.xreplace(unnamed) for formula in update)
    law = Step(LAW_INPUT, equations.u + controller.compensation, NOTES[LAW_INPUT])
    steps = _steps(controller, [*parts, law], x, unnamed)
    needed = {COMMAND}.union(*(f.free_symbols for f in (*update, *(r.formula for r in rates))))
    steps = _without_unused(steps, needed)
    if parameters:
        plain = {step: step.note.partition(f"\n{DERIVED_NUMBERS}")[0] for step in steps}
        steps = [replace(step, note=note) for step, note in plain.items()]
    used = needed.union(*(step.formula.free_symbols for step in steps))
    constants = {name: value for name, value in values.items() if name in used}
    program = ControllerProgram(
        controller=controller,
        measured=controller.measured,
        Y=controller.Y,
        states=controller.states,
        steps=tuple(steps),
        rates=tuple(rates),
        update=update,
        constants=constants,
        labels={},
        start=tuple(starting_state(controller, system.estimates, implementation).tolist()),
        parameters=tuple(filter(_is_designed, constants)) if parameters else (),
    )
    return replace(program, labels=_labels(system, program))


def _is_designed(constant: sympy.Symbol) -> bool:
    """Whether a number belongs to the design, not to the plant or the drive."""
    return constant.name.startswith(("law_", "ctl_hold_"))


#: Formulas that are written in place of symbols: numbers, or values of states not measured.
Replacements = dict[sympy.Symbol, sympy.Expr]


def _steps(
    controller: SampledController, law: Sequence[Step], x: Replacements, unnamed: Replacements
) -> list[Step]:
    """From the inputs to the command, by the law's own steps."""
    before = [Step(*step, note_before_the_law(step[0])) for step in controller.steps[:-2]]
    within = [replace(step, formula=step.formula.xreplace(x)) for step in law]
    command = controller.steps[-1][1]
    if command == LAW_INPUT:  # without limits
        within[-1] = replace(within[-1], name=COMMAND)
        return _printable([*before, *within], unnamed, "t")
    limited = Step(COMMAND, command, NOTES[COMMAND])
    return [*_printable([*before, *within], unnamed, "t"), limited]


def _update(
    controller: SampledController,
    implementation: Implementation,
    equations: Equations,
    x: Replacements,
) -> tuple[list[Step], tuple[sympy.Expr, ...]]:
    """The rates of the estimates, and the next states by them."""
    with_input = x | {Signals.applied: COMMAND}
    rates = [
        Step(
            symbol(f"ctl_rate_{z.name}"),
            rate.xreplace(with_input),
            "" if i else "rates of the estimates",
        )
        for i, (z, rate) in enumerate(equations.update)
    ]
    gains_and_estimates = {*controller.parameters, *controller.estimates}
    names = [step.name for step in rates]
    slow = forgetting_rates([rate for _, rate in equations.update], gains_and_estimates)
    forgetting = [formula.xreplace(x) for formula in slow]
    now, filters = (
        [x.get(z, z) for z in group] for group in (controller.estimates, equations.filters)
    )
    after = next_estimates(now, names, forgetting, controller.hold, implementation, filters)
    size = magnitude(LAW_INPUT - COMMAND)
    if any(formula.has(size) for formula in after):
        after = [formula.xreplace({size: CUT}) for formula in after]
        rates.append(Step(CUT, size, CUT_NOTES[implementation.anti_windup]))
    return rates, (*after, *controller.update[len(after) :])


def _named_parts(system: System) -> tuple[list[Step], Equations]:
    """Parts of the law by their names, and the law in these names."""
    plant, controller = system.plant, system.controller
    exact = controller.signals
    named = Signals(plant, exact.q, integral=system.law.integral is not None)
    named.e_n, named.nu = E_N, NU
    named.phi = tuple(symbol(f"ctl_phi_{i + 1}") for i in range(plant.r))
    equations = system.law.normal_equations(named)
    phi = dict(zip(named.phi, exact.phi, strict=True))
    meaning = phi | {E_N: exact.e_n, NU: exact.nu}
    pairs = zip(_all_parts(equations), _all_parts(controller.equations), strict=True)
    if any(part.xreplace(meaning) != original for part, original in pairs):
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
            by_name = {factor: UBAR}
            update = tuple((z, rate.xreplace(by_name)) for z, rate in equations.update)
            equations = replace(equations, u=equations.u.xreplace(by_name), update=update)
            break
    return parts, equations


def _without_unused(steps: Sequence[Step], needed: set[sympy.Symbol]) -> list[Step]:
    """Without the steps that nothing depends on: a gain may be zero."""
    for step in reversed(steps):
        needed = needed | step.formula.free_symbols if step.name in needed else needed
    return [step for step in steps if step.name in needed]


def _all_parts(equations: Equations) -> list[sympy.Expr]:
    return [equations.u, *(part for pair in equations.update for part in pair)]


def _unnamed_numbers(
    system: System,
    controller: SampledController,
    values: dict[sympy.Symbol, float],
    printed: Sequence[str],
) -> dict[sympy.Symbol, sympy.Expr]:
    """Parameters that do not get a name: of linear forms, and gains that are zero."""
    groups = system.controller.signals.all_parameters
    linear = {name for group in printed for name in groups.get(group, ())}
    gains = controller.parameters[: len(system.controller.symbols)]
    return {
        name: _exact_number(values[name]) for name in gains if name in linear or values[name] == 0
    }


def _exact_number(value: float) -> sympy.Expr:
    """The number; signs and zeros as integers, which SymPy simplifies."""
    return sympy.Integer(int(value)) if value in (-1, 0, 1) else sympy.Float(value)


def _printable(steps: Iterable[Step], unnamed: Replacements, letter: str) -> list[Step]:
    """Steps with numbers; what is costly and occurs twice is computed once."""
    steps = [
        replace(step, formula=fold_minmax(step.formula.xreplace(unnamed), larger, smaller))
        for step in steps
    ]
    names = (symbol(f"ctl_{letter}_{i}") for i in count(1))
    printable: list[Step] = []
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
        printable += _shared_steps(formula, costly)
        bases = {base: next(names) for base in _bases(formula)}
        printable += [Step(name, base) for base, name in bases.items()]
        printable.append(replace(step, formula=formula.xreplace(bases)))
    return printable


def _shared_steps(formula: sympy.Expr, costly: dict[sympy.Symbol, sympy.Expr]) -> list[Step]:
    """Steps for the shared parts that `formula` needs, in order; they leave `costly`."""
    steps: list[Step] = []
    for name in sorted(formula.free_symbols & costly.keys(), key=list(costly).index):
        if name in costly:
            part = costly.pop(name)
            steps += [*_shared_steps(part, costly), Step(name, part)]
    return steps


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
            and 2 <= abs(power.exp) <= MAX_FACTORS
            and power.base.free_symbols
            and not power.base.is_Symbol
        )
    )


def _labels(system: System, program: ControllerProgram) -> dict[sympy.Symbol, str]:
    """Natural names."""
    labels = dict(zip(program.measured, system.plant.states, strict=True))
    r = system.plant.r
    for group, names in system.controller.signals.all_parameters.items():
        square = len(names) == r * r and r > 1
        for i, name in enumerate(names):
            index = f"_{i // r + 1}_{i % r + 1}" if square else f"_{i + 1}"
            labels[name] = group + (index if len(names) > 1 else "")
    labels |= {symbol(name): name for name in system.plant.constant_values}
    controller = program.controller
    for i, z in enumerate(estimate.name for estimate in controller.estimates):
        labels[symbol(f"ctl_box_{2 * i}")] = f"{z}_low"
        labels[symbol(f"ctl_box_{2 * i + 1}")] = f"{z}_high"
        labels[symbol(f"ctl_rate_{z}")] = f"{z}_rate"
    labels |= {symbol(f"ctl_hold_{i}_{j}"): f"hold_{i + 1}_{j + 1}" for i, j in controller.hold}
    computed = {step.name for step in (*program.steps, *program.rates)} | set(program.states)
    for name in computed | set(controller.parameters):
        labels.setdefault(name, name.name.removeprefix("ctl_").removeprefix("value_"))
    labels[PERIOD] = "period"
    return labels
