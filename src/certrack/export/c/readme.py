"""The README that goes with exported C code."""

from __future__ import annotations

import re

from certrack.export.c.monitor import flag_names, monitored
from certrack.export.c.printer import c_literal
from certrack.export.c.source import CCode
from certrack.export.program import unread_states
from certrack.export.templates import fill_template

#: What may not be changed by hand, and what may.
NUMBERS_NOTE = """\
* The numbers within `e_n` and `nu` are made from c, k, p, chain and linear. No constant of the code
  stands for one of these: change the system file and export again."""
PARAMETERS_NOTE = """\
* The parameters belong together: those of `e_n` and `nu` are made from c, k, p, chain and linear.
  `certrack.export.monitor.default_parameters` gives all of them for another design."""

#: Of code with functions of an angle.
ANGLES_NOTE = """\
* sin, cos and tan of large arguments are slow on microcontrollers (range reduction) and inaccurate
  in float: keep angles within a few turns.
"""
FUNCTION_OF_ANGLE = re.compile(r"\b(sin|cos|tan)f?\(")

#: While the controller is disabled: with estimates, and without.
DISABLED_NOTE = """\
While it is disabled the command is {off}, the estimates stand still, and differences and filters
go on; so call it every period all the same. `{name}_reset_estimates(&m)` starts the estimates
again. """
DISABLED_WITHOUT_ESTIMATES = """\
While it is disabled the command is {off}, and differences and filters go on; so call it every
period all the same. This law has no estimates: `{name}_reset_estimates(&m)` does nothing.
"""

#: What every such file says.
README_KIND = "tracking controller in C99"


def readme(code: CCode, notes: tuple[str, ...]) -> str:
    """Contents of README.md."""
    implementation, unread = code.system.implementation, unread_states(code.system)
    assert implementation is not None
    with_parameters = bool(code.program.parameters)
    states = [f"{s} ({unread[s]})" if s in unread else s for s in code.system.plant.states]
    references = ["y_d", *(f"y_d^({i})" for i in range(1, len(code.program.Y)))]
    return fill_template(
        "c/templates/README.md",
        name=code.name,
        kind=README_KIND,
        number=code.real,
        period=repr(implementation.period),
        notes="".join(f"**Note:** {note}\n\n" for note in notes),
        states=", ".join(states),
        references=", ".join(references),
        members=", ".join(code.members) if code.program.states else "nothing",
        monitor=_monitor_section(code) if code.monitor else "",
        angles=ANGLES_NOTE if FUNCTION_OF_ANGLE.search(code.source) else "",
        numbers=PARAMETERS_NOTE if with_parameters else NUMBERS_NOTE,
        p="&p, " * with_parameters,
        parameters=f"static {code.name}_parameters p;\n" * with_parameters,
        preset=f"    {code.name}_preset(&p);\n" * with_parameters,
    )


def _monitor_section(code: CCode) -> str:
    """How NAME_monitor.h is used."""
    monitor = monitored(code)
    rows = [f"| `{member}` | {flag.meaning} |" for member, flag in flag_names(code).items()]
    limited = "y_d and its derivatives are limited to their bounds.\n"
    disabled = DISABLED_NOTE if monitor.restarted else DISABLED_WITHOUT_ESTIMATES
    tuned = "`m.parameters` may be changed; other values than the\ndesign's void the certificate. "
    return fill_template(
        "c/templates/monitor.md",
        name=code.name,
        disabled=disabled.format(name=code.name, off=c_literal(monitor.off, code.real)),
        more=limited * monitor.limit_reference + tuned * bool(code.program.parameters),
        flags="\n".join(rows).replace("|y", "\\|y").replace("| is above", "\\| is above"),
    )
