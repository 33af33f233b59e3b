"""The optional monitor of exported C: enable, reset, and flags for the premises."""

from __future__ import annotations

from collections.abc import Iterable

import sympy

from certrack.export.c.printer import CPrinter, c_literal, wrapped
from certrack.export.c.source import CCode
from certrack.export.identifiers import free_name
from certrack.export.monitor import COMMAND_BEFORE, HELD, Flag, MonitorProgram, Within
from certrack.export.templates import fill_template
from certrack.loops.controller import COMMAND

_LIMITER = """/* The value, or the bound that it is beyond. */
static inline {name}_real {name}_limited({name}_real value, {name}_real bound)
{{
    return (value > bound) ? bound : ((value < -bound) ? -bound : value);
}}

"""


def monitored(code: CCode) -> MonitorProgram:
    """The monitor of a code that has one."""
    assert code.monitor is not None
    return code.monitor


def flag_names(code: CCode) -> dict[str, Flag]:
    """Member of the structure NAME_flags -> flag."""
    names: dict[str, Flag] = {}
    for flag in monitored(code).flags:
        names[free_name(flag.name, names)] = flag
    return names


def monitor_header(code: CCode) -> str:
    """Contents of NAME_monitor.h."""
    monitor, name = monitored(code), code.name
    flags = flag_names(code)
    member = dict(zip(code.program.states, code.members, strict=False))
    off = c_literal(monitor.off, code.real)
    reset = [
        f"    m->state.{member[z]} = {c_literal(value, code.real)};"
        for z, value in monitor.restarted.items()
    ]
    disabled = [
        f"        next.{member[z]} = "
        + (f"m->state.{member[z]};" if value is None else f"{c_literal(value, code.real)};")
        for z, value in monitor.disabled.items()
    ]
    with_parameters = bool(code.program.parameters)
    return fill_template(
        "c/templates/controller_monitor.h",
        name=name,
        guard=f"{name.upper()}_MONITOR_H",
        flags="\n".join(f"    bool {f}; /* {flag.meaning} */" for f, flag in flags.items()),
        parameters=f"    {name}_parameters parameters; /* may be changed */\n" * with_parameters,
        preset=f"    {name}_preset(&m->parameters);\n" * with_parameters,
        p="&m->parameters, " * with_parameters,
        lowered="\n".join(f"    f->{f} = false;" for f in flags),
        latched="\n        || ".join(f"m->latched.{f}" for f in flags),
        off=off,
        reset="\n".join(reset or ["    (void)m;"]),
        limiter=_LIMITER.format(name=name) if monitor.limit_reference else "",
        limits=_limits(code),
        y_d="limited" if monitor.limit_reference else "y_d",
        disabled="\n".join([*disabled, "        u = off;"]),
        judged="\n".join(_judgements(code, always=False)),
        always="".join(f"{line}\n" for line in _judgements(code, always=True)),
        latching="\n".join(
            f"        m->latched.{f} = m->latched.{f} || m->now.{f};" for f in flags
        ),
        held=HELD,
    )


def _limits(code: CCode) -> str:
    """The limited reference, if it is."""
    monitor, name = monitored(code), code.name
    if not monitor.limit_reference:
        return ""
    numbers = [c_literal(bound, code.real) for bound in monitor.reference_bounds]
    entries = [f"{name}_limited(y_d[{i}], {number})" for i, number in enumerate(numbers)]
    lines = ",\n".join(f"        {entry}" for entry in entries)
    return f"    const {code.type} limited[{name}_REFERENCES] = {{\n{lines}\n    }};\n"


def _judgements(code: CCode, *, always: bool) -> Iterable[str]:
    """One statement per flag."""
    for member, flag in flag_names(code).items():
        if flag.premises and flag.always == always:
            conditions = [_premise_call(code, premise) for premise in flag.premises]
            all_hold = "\n        && ".join(conditions)
            broken = f"!({all_hold})" if len(conditions) > 1 else f"!{all_hold}"
            broken = f"enable && {broken}" if flag.of_command else broken
            statement = f"m->now.{member} = {broken};"
            yield f"    {statement}" if always else wrapped(statement, "        ")


def _premise_call(code: CCode, premise: Within) -> str:
    """The call that is true while a premise holds."""
    program = code.program
    texts: dict[sympy.Symbol, str] = {
        **{x: f"x[{i}]" for i, x in enumerate(program.measured)},
        **{y: f"y_d[{i}]" for i, y in enumerate(program.Y)},
        **{s: f"next.{m}" for s, m in zip(program.states, code.members, strict=False)},
        **{c: f"m->parameters.{code.names[c]}" for c in program.parameters},
        COMMAND: "u",
        COMMAND_BEFORE: "m->u",
    }
    printer = CPrinter(texts, code.real, ())
    value, low, high = map(printer.text, (premise.value, premise.low, premise.high))
    return f"{code.name}_{'inside' if premise.strict else 'within'}({value}, {low}, {high})"
