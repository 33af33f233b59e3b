"""The monitor of a controller as variables of an FMU: switches are 1 or 0.

What the monitor keeps stands in real numbers behind the controller's state, so that the wrappers of
both versions read and write it as they do the state.
"""

from __future__ import annotations

from certrack.export.c.monitor import flag_names
from certrack.export.c.source import CCode
from certrack.export.fmu.variables import Variable
from certrack.export.templates import fill_template

#: Inputs, each after ``monitor.`` -> what they are at the start, and what for.
MONITOR_SWITCHES = {
    "enable": (1.0, "1: the loop is closed, 0: u is its initial value"),
    "reset_estimates": (0.0, "1: the estimates start again"),
    "clear_flags": (0.0, "1: the latched flags are forgotten"),
}


def monitored_variables(code: CCode) -> list[Variable]:
    """In the order of the structure ``monitored_state``, after the state; none without a monitor.

    Flags are named by their description, parameters as in C.
    """
    if code.monitor is None:
        return []
    program, flags = code.program, code.monitor.flags
    declared = [
        Variable(
            f"parameters.{code.names[c]}",
            "parameter",
            program.constants[c],
            "parameter of the law: another value voids the certificate",
        )
        for c in program.parameters
    ]
    declared += [
        Variable(f"monitor.{name}", "input", *start) for name, start in MONITOR_SWITCHES.items()
    ]
    declared.append(Variable("monitor.premises_hold", "output", 1.0, "1: no flag is latched"))
    for group, text in (("now", "at the last sample"), ("latched", "since clear_flags, enabled")):
        declared += [
            Variable(f"{group}.{flag.name}", "output", 0.0, f"{flag.meaning}; {text}")
            for flag in flags
        ]
    return declared


def monitored_header(code: CCode) -> str:
    """Contents of monitored.h."""
    name, flags = code.name, list(flag_names(code))
    with_parameters = bool(code.program.parameters)
    groups = [(group, i, flag) for group in ("now", "latched") for i, flag in enumerate(flags)]
    return fill_template(
        "fmu/templates/monitored.h",
        name=name,
        flags=len(flags),
        parameters=f"    {name}_parameters parameters;\n" * with_parameters,
        preset=f"    {name}_preset(&s->parameters);\n" * with_parameters,
        load_parameters="    m.parameters = s->parameters;\n" * with_parameters,
        load="\n".join(
            f"    m.latched.{flag} = is_on(s->latched[{i}]);" for i, flag in enumerate(flags)
        ),
        store="\n".join(
            f"    s->{group}[{i}] = as_switch(m.{group}.{flag});" for group, i, flag in groups
        ),
    )
