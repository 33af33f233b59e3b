"""The controller as C99: header and source.

Nothing global, no dynamic memory; ``float`` code contains no ``double``. The state is a structure
of real numbers in the order of :attr:`certrack.loops.controller.SampledController.states`, so
it may be read as an array of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.version import version
from certrack.export.c.printer import REALS, CPrinter, c_literal, comment, helper, wrapped
from certrack.export.names import free_name, stem
from certrack.export.program import Program, Step, program, unread
from certrack.loops.controller import COMMAND, PERIOD
from certrack.model.implementation import Implementation
from certrack.systems.system import System
from certrack.systems.writer import to_text

#: A longer text of the system is not repeated in the header.
MOST_TEXT = 20_000

#: Names that the functions use themselves.
OWN = ("s", "x", "y_d", "v", "clamp", "larger", "smaller", "sign", "evaluate", "advance")


@dataclass(frozen=True)
class CCode:
    """A controller in C.

    Attributes
    ----------
    name : str
        Of the files and functions.
    real : {"double", "float"}
    system : System
        With the implementation that is exported.
    program : Program
        What the code computes; ``program.start`` are the numbers that NAME_init sets.
    """

    name: str
    real: str
    system: System
    program: Program

    @cached_property
    def members(self) -> tuple[str, ...]:
        """Of the structure NAME_state, all real numbers; C wants one at least."""
        names = tuple(free_name(self.program.labels[s], ()) for s in self.program.states)
        return names or ("unused",)

    @cached_property
    def header(self) -> str:
        """Contents of NAME.h."""
        return _header(self)

    @cached_property
    def source(self) -> str:
        """Contents of NAME.c."""
        return _source(self)

    @property
    def type(self) -> str:
        """Name of the type of real numbers."""
        return f"{self.name}_real"

    @cached_property
    def names(self) -> dict[sympy.Symbol, str]:
        """Of everything that is a variable within a function."""
        made, found = self.program, dict[sympy.Symbol, str]()
        taken = {*OWN, *(f"{self.name}_{end}" for end in ("real", "state", "signals"))}
        steps = [step.name for step in (*made.steps, *made.rates)]
        for symbol in (*steps, *made.constants, *made.measured):
            found[symbol] = free_name(made.labels[symbol], taken)
            taken.add(found[symbol])
        return found


def sampled_system(system: System, period: float | None = None) -> System:
    """The system with an implementation: its own, or one made of the period alone."""
    implementation = system.implementation
    if implementation is None and period is None:
        raise InputError(
            "implementation", "is missing", remedy="Add a table [implementation] or give --period"
        )
    if period is None:
        return system
    made = (
        Implementation(period=period)
        if implementation is None
        else replace(implementation, period=period)
    )
    return system.replace(implementation=made)


def c_code(
    system: System, name: str = "controller", *, real: str = "double", period: float | None = None
) -> CCode:
    """The controller of a system in C.

    Parameters
    ----------
    system : System
    name : str
        Of the system or its file; the prefix of files and functions is derived from it.
    real : {"double", "float"}
    period : float > 0, s, optional
        Instead of that of the implementation.
    """
    checks.choice("real", real, REALS)
    system = sampled_system(system, period)
    return CCode(stem(name), real, system, program(system))


def _header(code: CCode) -> str:
    made, name, real = code.program, code.name, code.type
    implementation = code.system.implementation
    assert implementation is not None
    given = f"const {real} x[{name}_STATES], const {real} y_d[{name}_REFERENCES]"
    members = [
        f"    {real} {member};{_about(made, symbol)}"
        for symbol, member in zip(made.states, code.members, strict=False)
    ] or [f"    {real} unused; /* this controller keeps nothing */"]
    state = f"{name}_state *s"
    declared = {
        "Sets the state before the first sample.": f"void {name}_init({state})",
        "The input u; changes nothing.": f"{real} {name}_output(const {state}, {given})",
        "From this sample to the next one.": f"void {name}_update({state}, {given})",
        "Both: the input u, then on to the next sample.": f"{real} {name}_step({state}, {given})",
    }
    functions = "\n\n".join(
        f"/* {note} */\n{wrapped(f'{text};', '')}" for note, text in declared.items()
    )
    guard = f"{name.upper()}_H"
    return f"""{comment(_about_system(code))}
#ifndef {guard}
#define {guard}

typedef {code.real} {real};

/* Time between two samples, s. */
#define {name}_PERIOD {c_literal(implementation.period, code.real)}

{_about_inputs(code)}
#define {name}_STATES {len(made.measured)}

/* The reference y_d and its derivatives up to order {len(made.Y) - 1}, when the sample is taken. */
#define {name}_REFERENCES {len(made.Y)}

/* What is kept from sample to sample. */
typedef struct {{
{_lines(members)}
}} {name}_state;

{functions}

#endif
"""


def _about_system(code: CCode) -> list[str]:
    """What the first comment says."""
    system, implementation = code.system, code.system.implementation
    assert implementation is not None
    text = to_text(system).splitlines()
    if sum(map(len, text)) > MOST_TEXT:
        text = [f"({sum(map(len, text))} characters: too long to be repeated here)"]
    c = ", ".join(f"{value:g}" for value in system.law.c)
    order = system.controller.coordinates.q
    return [
        f"{code.name}: tracking controller, sampled every {implementation.period!r} s.",
        "",
        f"Written by certrack {version()}. Design: {system.law.kind} law, c = ({c}) 1/s,",
        f"feed-forward order {order}. This is no certificate: guarantees are proven in continuous",
        "time; simulate the sampled loop before you rely on them.",
        "",
        "The system it was made for:",
        "",
        *(f"  {line}" for line in text),
    ]


def _about_inputs(code: CCode) -> str:
    """The comment on the entries of x."""
    states, idle = ", ".join(code.system.plant.states), unread(code.system)
    if not idle:
        return f"/* Measured plant states x: {states}. */"
    notes = (f" * {name}: {note}." for name, note in idle.items())
    return _lines([f"/* Plant states x, measured: {states};", *notes, " */"])


def _about(made: Program, symbol: sympy.Symbol) -> str:
    """A comment on a member of the state."""
    kind, _, which = made.labels[symbol].partition("_")
    if symbol in made.controller.estimates:
        notes = {"delta": "estimate of 1/g_n", "theta": "estimate of an unknown parameter"}
        return f" /* {notes[kind]} */" if kind in notes and which.startswith("hat") else ""
    notes = {
        "before": "the state before it, one sample ago",
        "speed": "its filtered difference",
        "first": "1 before the first sample, then 0",
        "u": "the last input",
    }
    return (
        f" /* {which}: {notes[kind]} */" if kind in ("before", "speed") else f" /* {notes[kind]} */"
    )


def _source(code: CCode) -> str:
    made, name, real = code.program, code.name, code.type
    early = set().union(*(step.formula.free_symbols for step in made.steps))
    late = set().union(*(s.formula.free_symbols for s in made.rates), *_free(made.update))
    kept = [s.name for s in made.steps if s.name in late | {COMMAND}]
    both = [c for c in made.constants if c in early & late and c is not PERIOD]
    here = CPrinter(_texts(code, {}), code.real, made.constants)
    there = CPrinter(
        _texts(code, {s: f"v->{code.names[s]}" for s in kept}), code.real, made.constants
    )
    evaluate = [
        *_locals(code, early.difference(both)),
        *_formulas(code, here, made.steps),
        "",
        *(f"    v->{code.names[s]} = {code.names[s]};" for s in kept),
        *(f"    (void){argument};" for argument in _unused(made, early)),
    ]
    changes = [
        wrapped(f"s->{member} = {there.text(formula)};")
        for member, formula in zip(code.members, made.update, strict=False)
    ]
    advance = [
        *_locals(code, late.difference(both)),
        *_formulas(code, there, made.rates),
        "",
        *changes,
        *([] if late.intersection(kept) else ["    (void)v;"]),
    ]
    needed = [argument for argument in ("x", "y_d") if argument not in _unused(made, late)]
    inputs = "".join(f"const {real} {argument}[], " for argument in needed)
    given = f"const {name}_state *s, const {real} x[], const {real} y_d[], {name}_signals *v"
    parts = [
        f'#include "{name}.h"\n',
        "#include <math.h>\n" if here.calls or there.calls else "",
        _lines([*(f"static const {real} {_constant(code, c)}" for c in both), ""]) if both else "",
        *(helper(used, real, code.real) for used in sorted(here.helpers | there.helpers)),
        "/* What is known of a sample once it is evaluated. */\ntypedef struct {\n"
        + "".join(f"    {real} {code.names[symbol]};\n" for symbol in kept)
        + f"}} {name}_signals;\n",
        _function(
            "From the measurements to the input.", f"static void evaluate({given})", evaluate
        ),
        _function(
            "From this sample to the next one.",
            f"static void advance({name}_state *s, {inputs}const {name}_signals *v)",
            advance,
        )
        if changes
        else "",
        _interface(code, f"advance({', '.join(['s', *needed, '&v'])});" if changes else ""),
    ]
    return _lines(part for part in parts if part)


def _interface(code: CCode, advance: str) -> str:
    """The functions of the header; `advance` is the call for the next state, if there is one."""
    made, name, real = code.program, code.name, code.type
    given = f"const {real} x[{name}_STATES], const {real} y_d[{name}_REFERENCES]"
    start = [
        f"    s->{member} = {c_literal(value, code.real)};"
        for member, value in zip(code.members, made.start or (0.0,), strict=True)
    ]
    evaluate = [f"    {name}_signals v;", "", "    evaluate(s, x, y_d, &v);"]
    forward = [f"    {advance}"] if advance else []
    update = [*evaluate, *forward] if advance else [f"    (void){a};" for a in ("s", "x", "y_d")]
    result, state = f"    return v.{code.names[COMMAND]};", f"{name}_state *s"
    functions = {
        f"void {name}_init({state})": start,
        f"{real} {name}_output(const {state}, {given})": [*evaluate, result],
        f"void {name}_update({state}, {given})": update,
        f"{real} {name}_step({state}, {given})": [*evaluate, *forward, result],
    }
    return _lines(_function("", signature, body) for signature, body in functions.items())


def _function(note: str, signature: str, body: Sequence[str]) -> str:
    lines = list(body)
    while lines and not lines[0].strip():
        del lines[0]
    about = f"/* {note} */\n" if note else ""
    return f"{about}{wrapped(signature, '')}\n{{\n{_lines(lines)}\n}}\n"


def _formulas(code: CCode, printer: CPrinter, steps: Iterable[Step]) -> list[str]:
    """One statement per step, its meaning above it."""
    lines: list[str] = []
    for step in steps:
        lines += ["", f"    /* {step.note} */"] if step.note else []
        text = printer.text(step.formula)
        lines.append(wrapped(f"const {code.type} {code.names[step.name]} = {text};"))
    return lines


def _locals(code: CCode, used: set[sympy.Symbol]) -> list[str]:
    """Named constants and measured states of a function."""
    made, real = code.program, code.type
    lines = [
        f"    const {real} {_constant(code, symbol)}"
        for symbol in made.constants
        if symbol in used and symbol is not PERIOD
    ]
    lines += [
        f"    const {real} {code.names[symbol]} = x[{i}];"
        for i, symbol in enumerate(made.measured)
        if symbol in used
    ]
    return lines


def _constant(code: CCode, symbol: sympy.Symbol) -> str:
    """Its definition, with a note where the number is not the user's own."""
    number = c_literal(code.program.constants[symbol], code.real)
    notes = {
        "ctl_filter": "1 - exp(-period/velocity_filter)",
        "ctl_u_step": "rate_limit * period",
        "ctl_hold": "weight of a rate: exact for the leak",
    }
    note = next((f" /* {n} */" for start, n in notes.items() if symbol.name.startswith(start)), "")
    return f"{code.names[symbol]} = {number};{note}"


def _texts(code: CCode, others: dict[sympy.Symbol, str]) -> dict[sympy.Symbol, str]:
    """Text of every symbol, in the order in which the terms of a sum are wanted."""
    made, names = code.program, code.names
    return {
        **{symbol: names[symbol] for symbol in made.measured},
        **{symbol: f"y_d[{i}]" for i, symbol in enumerate(made.Y)},
        **{s: f"s->{member}" for s, member in zip(made.states, code.members, strict=False)},
        **{step.name: names[step.name] for step in (*made.steps, *made.rates)},
        **{symbol: names[symbol] for symbol in made.constants},
        **others,
        PERIOD: f"{code.name}_PERIOD",
    }


def _unused(made: Program, used: set[sympy.Symbol]) -> list[str]:
    """Arguments of a function that it does not need."""
    arguments = {"s": made.states, "x": made.measured, "y_d": made.Y}
    return [name for name, symbols in arguments.items() if not used & set(symbols)]


def _free(formulas: Iterable[sympy.Expr]) -> list[set[sympy.Symbol]]:
    return [formula.free_symbols for formula in formulas]


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(lines)
