"""The controller as an IEC 61131-3 function block in Structured Text.

Only what every controller understands: IF, arithmetic and the standard's functions of LREAL.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import sympy

from certrack.core.files import write_text
from certrack.core.version import version
from certrack.export.identifiers import stem
from certrack.export.monitor import Monitor, monitor_program, wanted_parameters
from certrack.export.program import (
    ControllerProgram,
    controller_program,
    read_symbols,
    sampled_system,
    unread_states,
)
from certrack.export.st.guard import GUARD, guarded
from certrack.export.st.monitor import MONITOR_INPUTS, PREMISES_HOLD, BlockMonitor
from certrack.export.st.statements import (
    INDENT,
    Statements,
    Variables,
    comment_text,
    declaration,
    st_literal,
    unused_name,
)
from certrack.loops.controller import COMMAND
from certrack.systems.system import System

#: Names that a standard or a dialect reserves; capitals and small letters are the same.
ST_RESERVED = frozenset(
    """
    abs acos action add and any array asin at atan bool by byte cal case class configuration
    constant continue cos ct ctd ctu ctud d date del delete dint div do dt dword else elsif eq exit
    exp expt extends false final find for from function function_block ge gt if implements in
    initial_step ini insert int interface internal interval jmp jmpc jmpcn ld ldn le left len limit
    lint ln log lreal lt lword max method mid min mod move mul mux namespace ne non_retain not null
    of on or overlap override persistent pointer priority private program property protected public
    r r1 r_edge read_only read_write real ref ref_to repeat replace reset resource ret retain return
    right rol ror rs s s1 sel shl shr sin single sint sizeof sqrt sr st step stn string struct sub
    super t tan task then this time tod to tof ton tp transition true trunc type udint uint ulint
    union until using usint var with while word wstring xor
    """.split()
)


#: Inputs of a block without a monitor -> what they are for.
SWITCHES = {"RESET": "start again", GUARD: "hold at a sample that is not finite"}

#: What the introduction says of them, and of a monitor.
GUARDED = ("GUARD = TRUE holds u and all states at a sample that is not finite.",)
MONITORED = (
    "ENABLE = FALSE: u is its initial value, the estimates stand still, and differences and",
    "filters go on. A sample that is not finite holds u and all states.",
    "premises_hold = FALSE says that the certificate did not speak of this loop at some call",
    "since CLEAR_FLAGS; the flags say why.",
)


def structured_text(
    system: System,
    name: str = "controller",
    *,
    period: float | None = None,
    monitor: Monitor | None = None,
) -> str:
    """A function block that computes what the sampled controller computes.

    Parameters
    ----------
    system : System
    name : str
        Of the system or its file; the block's name is derived from it.
    period : float > 0, s, optional
        Instead of that of the implementation; needed if the system has none.
    monitor : Monitor, optional

    Returns
    -------
    str
        Contents of NAME.st, ASCII.

    Raises
    ------
    InputError
        If there is no period.
    """
    system = sampled_system(system, period)
    program = controller_program(system, parameters=wanted_parameters(monitor))
    used_names = {*ST_RESERVED, GUARD.lower()}
    if monitor is not None:
        used_names |= {name.lower() for name in (*MONITOR_INPUTS, PREMISES_HOLD)}
    block = unused_name(stem(name), used_names)
    names = _identifiers(program, used_names)
    watch = None
    if monitor is not None:
        watched = monitor_program(monitor, system, program)
        watch = BlockMonitor.of(program, watched, names, used_names)
    start = {
        names[state]: value for state, value in zip(program.states, program.start, strict=True)
    }
    computed = [
        names[step.name] for step in (*program.steps, *program.rates) if step.name != COMMAND
    ]
    variables = Variables(names if watch is None else watch.law_names)
    law = _statements(program, variables).lines
    results = [names[COMMAND], *(names[state] for state in program.states)]
    saved = {name: unused_name(f"saved_{name}", used_names) for name in results}
    read = read_symbols(program)
    inputs = [names[s] for s in (*program.measured, *program.Y) if s in read]
    temporary = (*computed, *variables.temporary, *saved.values())
    if watch is None:
        switches = [declaration(name, note=text, kind="BOOL") for name, text in SWITCHES.items()]
        flags, off = [], None
        begun, body = start, guarded(inputs, saved, law)
    else:
        switches, flags, off = watch.inputs(), watch.outputs(), watch.monitor.off
        begun, body = start | {names[COMMAND]: off}, watch.statements(inputs, saved, law)
        temporary = (*watch.limited, *temporary)
    command = declaration(names[COMMAND], off, _with_unit("input", system, -1))
    fixed = {s: v for s, v in program.constants.items() if s not in program.parameters}
    lines = [
        *_introduction(system, start, watch is not None),
        f"FUNCTION_BLOCK {block}",
        *_variable_section("VAR_INPUT", [*_input_declarations(system, program, names), *switches]),
        *_variable_section("VAR_OUTPUT", [command, *flags]),
        *_variable_section("VAR", _state_declarations(program, names)),
        *_variable_section("VAR CONSTANT", (declaration(names[s], v) for s, v in fixed.items())),
        *_variable_section("VAR_TEMP", map(declaration, temporary)),
        *_reset_statements(begun),
        *body,
        "END_FUNCTION_BLOCK",
    ]
    return "\n".join(lines) + "\n"


def export_st(
    system: System,
    path: str | os.PathLike[str],
    *,
    period: float | None = None,
    monitor: Monitor | None = None,
) -> Path:
    """Write the controller as a function block in Structured Text, whole or not at all.

    Parameters
    ----------
    system : System
    path : path
        NAME.st; NAME names the block.
    period : float > 0, s, optional
        Instead of that of the implementation; needed if the system has none.
    monitor : Monitor, optional
        Adds inputs to enable and reset the block, outputs that say which premise of the certificate
        does not hold, and what the monitor asks for besides; it replaces the input GUARD.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If there is no period, or the file cannot be written.

    Examples
    --------
    >>> import certrack
    >>> certrack.export_st(certrack.load("example1"), "drive.st", period=0.001).name
    'drive.st'
    """
    file = Path(path)
    write_text(file, structured_text(system, file.name, period=period, monitor=monitor))
    return file


def _identifiers(program: ControllerProgram, used_names: set[str]) -> dict[sympy.Symbol, str]:
    """Identifiers of all symbols: natural where they may be, and all different."""
    Y = {name: f"y_d_{i}" if i else "y_d" for i, name in enumerate(program.Y)}
    steps = (step.name for step in (*program.steps, *program.rates))
    ordered = dict.fromkeys(
        [*program.measured, *Y, COMMAND, *program.states, *steps, *program.constants]
    )
    return {name: unused_name(Y.get(name) or program.labels[name], used_names) for name in ordered}


def _statements(program: ControllerProgram, variables: Variables) -> Statements:
    """All that a call computes."""
    names, statements = variables.names, Statements(variables)
    for step in program.steps:
        statements.step(step)
    rate_names = {names[step.name] for step in program.rates} & {
        f"{names[z]}_rate" for z in program.states
    }
    for step in program.rates:
        note = "rate of an estimate" if names[step.name] in rate_names else step.note
        statements.step(replace(step, note=note))
    if program.states:
        statements.note("what the next call needs")
    for state, formula in zip(program.states, program.update, strict=True):
        statements.assign(names[state], formula)
    return statements


def _introduction(system: System, states: Mapping[str, float], monitored: bool) -> list[str]:
    """The first comment."""
    assert system.implementation is not None
    lines = [
        system.title or "A tracking controller",
        "",
        f"The {system.law.kind} law in discrete time, written by certrack {version()}.",
        f"Call the block once every {system.implementation.period!r} s with the states measured at",
        "this moment and the reference y_d and its derivatives; u acts until the next call.",
        "RESET = TRUE starts again." if states else "It keeps nothing: RESET has no effect.",
        *(MONITORED if monitored else GUARDED),
    ]
    return ["(*", *((INDENT + comment_text(line)).rstrip() for line in lines), "*)"]


def _variable_section(title: str, declarations: Iterable[str]) -> list[str]:
    """A block of variables, if there are any."""
    lines = [INDENT + line for line in declarations]
    return [title, *lines, "END_VAR"] if lines else []


def _input_declarations(
    system: System, program: ControllerProgram, names: Mapping[sympy.Symbol, str]
) -> list[str]:
    unread = unread_states(system)
    notes = [
        unread.get(state, _with_unit("measured", system, i))
        for i, state in enumerate(system.plant.states)
    ]
    notes += ["reference", *(f"its derivative no. {i}" for i in range(1, len(program.Y)))]
    inputs = zip((*program.measured, *program.Y), notes, strict=True)
    return [declaration(names[name], note=note) for name, note in inputs]


def _with_unit(what: str, system: System, index: int) -> str:
    units = system.plant.units
    return f"{what}, {units[index]}" if units else what


def _state_declarations(program: ControllerProgram, names: Mapping[sympy.Symbol, str]) -> list[str]:
    estimates = set(program.controller.estimates)
    return [
        declaration(names[state], start, "estimate" if state in estimates else "of the last call")
        for state, start in zip(program.states, program.start, strict=True)
    ]


def _reset_statements(start: Mapping[str, float]) -> list[str]:
    """Initial values, on demand."""
    again = (f"{INDENT}{name} := {st_literal(value)};" for name, value in start.items())
    return ["", "IF RESET THEN", *again, "END_IF;"] if start else []
