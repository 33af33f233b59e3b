"""The controller as C99: header and source.

Nothing global, no dynamic memory; ``float`` code contains no ``double``. The state is a structure
of real numbers in the order of :attr:`certrack.loops.controller.SampledController.states`, so
it may be read as an array of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy

from certrack.core import checks
from certrack.export.c.comments import inputs_comment, introduction, member_note
from certrack.export.c.notes import notes_for
from certrack.export.c.printer import (
    NUMBER_TYPES,
    CPrinter,
    c_literal,
    helper_definition,
    wrapped,
)
from certrack.export.identifiers import free_name, stem
from certrack.export.monitor import Monitor, MonitorProgram, monitor_program, wanted_parameters
from certrack.export.program import (
    ControllerProgram,
    Step,
    controller_program,
    sampled_system,
)
from certrack.export.templates import fill_template
from certrack.loops.controller import COMMAND, PERIOD
from certrack.systems.system import System

#: Names that the functions use themselves.
LOCAL_NAMES = ("s", "x", "y_d", "v", "clamp", "larger", "smaller", "sign", "evaluate", "advance")


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
    program : ControllerProgram
        What the code computes; ``program.start`` are the numbers that NAME_init sets.
    monitor : MonitorProgram, optional
        Of the optional header NAME_monitor.h.
    """

    name: str
    real: str
    system: System
    program: ControllerProgram
    monitor: MonitorProgram | None = None

    @cached_property
    def members(self) -> tuple[str, ...]:
        """Of the structure NAME_state, all real numbers; C wants one at least."""
        names: list[str] = []
        for state in self.program.states:
            names.append(free_name(self.program.labels[state], names))
        return tuple(names) or ("unused",)

    @cached_property
    def header(self) -> str:
        """Contents of NAME.h."""
        return _header_text(self)

    @cached_property
    def source(self) -> str:
        """Contents of NAME.c."""
        return _source_text(self)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What the user should know."""
        return notes_for(self.system, self.real)

    @property
    def type(self) -> str:
        """Name of the type of real numbers."""
        return f"{self.name}_real"

    @property
    def parameter_argument(self) -> str:
        """Argument of the functions, for the parameters at run time if there are any."""
        return f"const {self.name}_parameters *p, " if self.program.parameters else ""

    @cached_property
    def names(self) -> dict[sympy.Symbol, str]:
        """Of everything that is a variable within a function."""
        program, names = self.program, dict[sympy.Symbol, str]()
        used_names = {*LOCAL_NAMES, *(f"{self.name}_{end}" for end in ("real", "state", "signals"))}
        used_names |= {"p"} if program.parameters else set()
        steps = [step.name for step in (*program.steps, *program.rates)]
        for symbol in (*steps, *program.constants, *program.measured):
            names[symbol] = free_name(program.labels[symbol], used_names)
            used_names.add(names[symbol])
        return names


def c_code(
    system: System,
    name: str = "controller",
    *,
    real: str = "double",
    period: float | None = None,
    monitor: Monitor | None = None,
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
    monitor : Monitor, optional
    """
    checks.choice("real", real, NUMBER_TYPES)
    system = sampled_system(system, period)
    program = controller_program(system, parameters=wanted_parameters(monitor))
    watched = monitor_program(monitor, system, program, real) if monitor else None
    return CCode(stem(name), real, system, program, watched)


def _header_text(code: CCode) -> str:
    program, name, real = code.program, code.name, code.type
    implementation = code.system.implementation
    assert implementation is not None
    inputs = _inputs(code)
    members = [
        f"    {real} {member};{member_note(program, symbol)}"
        for symbol, member in zip(program.states, code.members, strict=False)
    ] or [f"    {real} unused; /* this controller keeps nothing */"]
    state = f"{name}_state *s"
    declared = {
        "Sets the state before the first sample.": f"void {name}_init({state})",
        "The input u; changes nothing.": f"{real} {name}_output(const {state}, {inputs})",
        "From this sample to the next one.": f"void {name}_update({state}, {inputs})",
        "Both: the input u, then on to the next sample.": f"{real} {name}_step({state}, {inputs})",
    }
    if program.parameters:
        declared["Sets the parameters of the design."] = _preset_signature(code)
    functions = [
        f"/* {note} */\n{wrapped(f'{signature};', '')}" for note, signature in declared.items()
    ]
    return fill_template(
        "c/templates/controller.h",
        name=name,
        guard=f"{name.upper()}_H",
        introduction=introduction(name, code.system),
        number=code.real,
        period=c_literal(implementation.period, code.real),
        inputs=inputs_comment(code.system),
        states=len(program.measured),
        order=len(program.Y) - 1,
        references=len(program.Y),
        members="\n".join(members),
        parameters=_parameters_text(code),
        functions="\n\n".join(functions),
    )


def _preset_signature(code: CCode) -> str:
    return f"void {code.name}_preset({code.name}_parameters *p)"


def _parameters_text(code: CCode) -> str:
    """The structure of the parameters at run time, if there are any."""
    program, name = code.program, code.name
    if not program.parameters:
        return ""
    members = "".join(f"    {code.type} {code.names[c]};\n" for c in program.parameters)
    note = "/* What may change at run time; other values than the design's void its certificate. */"
    return f"\n{note}\ntypedef struct {{\n{members}}} {name}_parameters;\n"


def _source_text(code: CCode) -> str:
    """One function computes a sample, another goes on to the next; the interface calls them."""
    program, name, real = code.program, code.name, code.type
    early = set().union(*(step.formula.free_symbols for step in program.steps))
    late = set().union(
        *(step.formula.free_symbols for step in program.rates),
        *(formula.free_symbols for formula in program.update),
    )
    shared = [step.name for step in program.steps if step.name in late | {COMMAND}]
    fixed = [c for c in program.constants if c is not PERIOD and c not in program.parameters]
    shared_constants = [c for c in fixed if c in early & late]
    evaluating = CPrinter(_symbol_texts(code, {}), code.real, program.constants)
    signals = {symbol: f"v->{code.names[symbol]}" for symbol in shared}
    advancing = CPrinter(_symbol_texts(code, signals), code.real, program.constants)
    evaluate = [
        *_local_definitions(code, early.difference(shared_constants)),
        *_step_statements(code, evaluating, program.steps),
        "",
        *(f"    v->{code.names[symbol]} = {code.names[symbol]};" for symbol in shared),
        *(f"    (void){argument};" for argument in _unused_arguments(program, early)),
    ]
    changes = [
        wrapped(f"s->{member} = {advancing.text(formula)};")
        for member, formula in zip(code.members, program.update, strict=False)
    ]
    advance = [
        *_local_definitions(code, late.difference(shared_constants)),
        *_step_statements(code, advancing, program.rates),
        "",
        *changes,
        *([] if late.intersection(shared) else ["    (void)v;"]),
    ]
    unused = _unused_arguments(program, late)
    needed = [argument for argument in ("x", "y_d") if argument not in unused]
    inputs = "".join(f"const {real} {argument}[], " for argument in needed)
    leading = f"const {name}_state *s, {code.parameter_argument}"
    arguments = f"{leading}const {real} x[], const {real} y_d[], {name}_signals *v"
    if late.intersection(program.parameters):
        needed, inputs = ["p", *needed], code.parameter_argument + inputs
    constants = [f"static const {real} {_constant_definition(code, c)}" for c in shared_constants]
    helpers = sorted(evaluating.helpers | advancing.helpers)
    parts = [
        f'#include "{name}.h"\n',
        "#include <math.h>\n" if evaluating.calls or advancing.calls else "",
        "\n".join([*constants, ""]) if constants else "",
        *(helper_definition(helper, real, code.real) for helper in helpers),
        "/* What is known of a sample once it is evaluated. */\ntypedef struct {\n"
        + "".join(f"    {real} {code.names[symbol]};\n" for symbol in shared)
        + f"}} {name}_signals;\n",
        _function_text(
            "From the measurements to the input.", f"static void evaluate({arguments})", evaluate
        ),
        _function_text(
            "From this sample to the next one.",
            f"static void advance({name}_state *s, {inputs}const {name}_signals *v)",
            advance,
        )
        if changes
        else "",
        _interface_text(code, f"advance({', '.join(['s', *needed, '&v'])});" if changes else ""),
    ]
    return "\n".join(part for part in parts if part)


def _inputs(code: CCode) -> str:
    """Arguments of the functions after the state."""
    name, real = code.name, code.type
    inputs = f"const {real} x[{name}_STATES], const {real} y_d[{name}_REFERENCES]"
    return code.parameter_argument + inputs


def _interface_text(code: CCode, advance: str) -> str:
    """The functions of the header; `advance` is the call for the next state, if there is one."""
    program, name, real = code.program, code.name, code.type
    inputs, p = _inputs(code), "p, " if code.program.parameters else ""
    start = [
        f"    s->{member} = {c_literal(value, code.real)};"
        for member, value in zip(code.members, program.start or (0.0,), strict=True)
    ]
    evaluate = [f"    {name}_signals v;", "", f"    evaluate(s, {p}x, y_d, &v);"]
    unneeded = ("s", *(["p"] if p else []), "x", "y_d")
    forward = [f"    {advance}"] if advance else []
    update = [*evaluate, *forward] if advance else [f"    (void){a};" for a in unneeded]
    result, state = f"    return v.{code.names[COMMAND]};", f"{name}_state *s"
    functions = {
        f"void {name}_init({state})": start,
        f"{real} {name}_output(const {state}, {inputs})": [*evaluate, result],
        f"void {name}_update({state}, {inputs})": update,
        f"{real} {name}_step({state}, {inputs})": [*evaluate, *forward, result],
    }
    if program.parameters:
        functions[_preset_signature(code)] = [
            f"    p->{code.names[c]} = {c_literal(program.constants[c], code.real)};"
            for c in program.parameters
        ]
    return "\n".join(_function_text("", signature, body) for signature, body in functions.items())


def _function_text(note: str, signature: str, body: Sequence[str]) -> str:
    lines = list(body)
    while lines and not lines[0].strip():
        del lines[0]
    above = f"/* {note} */\n" if note else ""
    return "\n".join([f"{above}{wrapped(signature, '')}", "{", *lines, "}\n"])


def _step_statements(code: CCode, printer: CPrinter, steps: Iterable[Step]) -> list[str]:
    """One statement per step, its meaning above it."""
    lines: list[str] = []
    for step in steps:
        lines += (
            ["", *(f"    /* {line} */" for line in step.note.splitlines())] if step.note else []
        )
        text = printer.text(step.formula)
        lines.append(wrapped(f"const {code.type} {code.names[step.name]} = {text};"))
    return lines


def _local_definitions(code: CCode, used: set[sympy.Symbol]) -> list[str]:
    """Named constants and measured states of a function."""
    program, real = code.program, code.type
    lines = [
        f"    const {real} {_constant_definition(code, symbol)}"
        for symbol in program.constants
        if symbol in used and symbol is not PERIOD and symbol not in program.parameters
    ]
    lines += [
        f"    const {real} {code.names[symbol]} = x[{i}];"
        for i, symbol in enumerate(program.measured)
        if symbol in used
    ]
    return lines


def _constant_definition(code: CCode, symbol: sympy.Symbol) -> str:
    """Its name and number, with a note where the number is not the user's own."""
    number = c_literal(code.program.constants[symbol], code.real)
    notes = {
        "ctl_filter": "1 - exp(-period/velocity_filter)",
        "ctl_u_step": "rate_limit * period",
        "ctl_hold": "weight of a rate: exact for the leak",
        "ctl_over": "the plant over one period",
        "ctl_push": "what a constant disturbance does in one period",
        "ctl_new": "what the newer input of a period does",
        "ctl_old": "what the older input of a period does",
        "ctl_correct": "gain of the observer",
        "ctl_counter": "input that a disturbance is met with",
        "ctl_steady": "state that a disturbance is met with",
    }
    note = next((f" /* {n} */" for start, n in notes.items() if symbol.name.startswith(start)), "")
    return f"{code.names[symbol]} = {number};{note}"


def _symbol_texts(code: CCode, signals: dict[sympy.Symbol, str]) -> dict[sympy.Symbol, str]:
    """Text of every symbol, in the order in which the terms of a sum are wanted.

    `signals` are the texts of those that are handed from one function to the other.
    """
    program, names = code.program, code.names
    return {
        **{symbol: names[symbol] for symbol in program.measured},
        **{symbol: f"y_d[{i}]" for i, symbol in enumerate(program.Y)},
        **{s: f"s->{member}" for s, member in zip(program.states, code.members, strict=False)},
        **{step.name: names[step.name] for step in (*program.steps, *program.rates)},
        **{symbol: names[symbol] for symbol in program.constants},
        **{symbol: f"p->{names[symbol]}" for symbol in program.parameters},
        **signals,
        PERIOD: f"{code.name}_PERIOD",
    }


def _unused_arguments(program: ControllerProgram, used: set[sympy.Symbol]) -> list[str]:
    """Arguments of a function that it does not need."""
    arguments = {"s": program.states, "x": program.measured, "y_d": program.Y}
    arguments |= {"p": program.parameters} if program.parameters else {}
    return [name for name, symbols in arguments.items() if not used & set(symbols)]
