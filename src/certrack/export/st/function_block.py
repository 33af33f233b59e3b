"""The controller as an IEC 61131-3 function block in Structured Text.

Only what every controller understands: IF, arithmetic and the standard's functions of LREAL.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import sympy

from certrack.core.version import version
from certrack.export.c.source import sampled_system
from certrack.export.names import stem
from certrack.export.program import Program, program, unread
from certrack.export.st.statements import (
    INDENT,
    Statements,
    Variables,
    comment_text,
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


def structured_text(
    system: System, name: str = "controller", *, period: float | None = None
) -> str:
    """A function block that computes what the sampled controller computes.

    Parameters
    ----------
    system : System
    name : str
        Of the system or its file; the block's name is derived from it.
    period : float > 0, s, optional
        Instead of that of the implementation; needed if the system has none.

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
    made, taken = program(system), set(ST_RESERVED)
    block = unused_name(stem(name), taken)
    names = _names(made, taken)
    start = {names[state]: value for state, value in zip(made.states, made.start, strict=True)}
    computed = [names[step.name] for step in (*made.steps, *made.rates) if step.name != COMMAND]
    variables = Variables(names)
    statements = _statements(made, variables)
    lines = [
        *_introduction(system, start),
        f"FUNCTION_BLOCK {block}",
        *_section("VAR_INPUT", _inputs(system, made, names)),
        *_section("VAR_OUTPUT", [_declared(names[COMMAND], note=_with_unit("input", system, -1))]),
        *_section("VAR", _kept(made, names)),
        *_section("VAR CONSTANT", (_declared(names[s], v) for s, v in made.constants.items())),
        *_section("VAR_TEMP", map(_declared, (*computed, *variables.temporary))),
        *_restart(start),
        *statements.lines,
        "END_FUNCTION_BLOCK",
    ]
    return "\n".join(lines) + "\n"


def _names(made: Program, taken: set[str]) -> dict[sympy.Symbol, str]:
    """Identifiers of all symbols: natural where they may be, and all different."""
    Y = {name: f"y_d_{i}" if i else "y_d" for i, name in enumerate(made.Y)}
    steps = (step.name for step in (*made.steps, *made.rates))
    ordered = dict.fromkeys([*made.measured, *Y, COMMAND, *made.states, *steps, *made.constants])
    return {name: unused_name(Y.get(name) or made.labels[name], taken) for name in ordered}


def _statements(made: Program, variables: Variables) -> Statements:
    """All that a call computes."""
    names, statements = variables.names, Statements(variables)
    for step in made.steps:
        statements.step(step)
    rated = {names[step.name] for step in made.rates} & {f"{names[z]}_rate" for z in made.states}
    for step in made.rates:
        note = "rate of an estimate" if names[step.name] in rated else step.note
        statements.step(replace(step, note=note))
    if made.states:
        statements.note("what the next call needs")
    for state, formula in zip(made.states, made.update, strict=True):
        statements.assign(names[state], formula)
    return statements


def _introduction(system: System, states: Mapping[str, float]) -> list[str]:
    """The first comment."""
    assert system.implementation is not None
    lines = [
        system.title or "A tracking controller",
        "",
        f"The {system.law.kind} law in discrete time, written by certrack {version()}.",
        f"Call the block once every {system.implementation.period!r} s with the states measured at",
        "this moment and the reference y_d and its derivatives; u acts until the next call.",
        "RESET = TRUE starts again." if states else "It keeps nothing: RESET has no effect.",
    ]
    return ["(*", *((INDENT + comment_text(line)).rstrip() for line in lines), "*)"]


def _section(title: str, declarations: Iterable[str]) -> list[str]:
    """A block of variables, if there are any."""
    found = [INDENT + line for line in declarations]
    return [title, *found, "END_VAR"] if found else []


def _declared(name: str, value: float | None = None, note: str = "", kind: str = "LREAL") -> str:
    start = "" if value is None else f" := {st_literal(value)}"
    return f"{name} : {kind}{start};" + (f" (* {comment_text(note)} *)" if note else "")


def _inputs(system: System, made: Program, names: Mapping[sympy.Symbol, str]) -> list[str]:
    idle = unread(system)
    notes = [
        idle.get(state, _with_unit("measured", system, i))
        for i, state in enumerate(system.plant.states)
    ]
    notes += ["reference", *(f"its derivative no. {i}" for i in range(1, len(made.Y)))]
    given = zip((*made.measured, *made.Y), notes, strict=True)
    declared = [_declared(names[name], note=note) for name, note in given]
    return [*declared, _declared("RESET", note="start again", kind="BOOL")]


def _with_unit(what: str, system: System, index: int) -> str:
    units = system.plant.units
    return f"{what}, {units[index]}" if units else what


def _kept(made: Program, names: Mapping[sympy.Symbol, str]) -> list[str]:
    estimates = set(made.controller.estimates)
    return [
        _declared(names[state], start, "estimate" if state in estimates else "of the last call")
        for state, start in zip(made.states, made.start, strict=True)
    ]


def _restart(start: Mapping[str, float]) -> list[str]:
    """Initial values, on demand."""
    again = (f"{INDENT}{name} := {st_literal(value)};" for name, value in start.items())
    return ["", "IF RESET THEN", *again, "END_IF;"] if start else []
