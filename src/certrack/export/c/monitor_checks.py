"""The part of the acceptance test that is about the monitor: every flag up and down."""

from __future__ import annotations

from collections.abc import Iterator

import sympy

from certrack.export.c.monitor import flag_names, monitored
from certrack.export.c.printer import c_literal, initialiser
from certrack.export.c.source import CCode
from certrack.export.golden_vectors import MUTATION, GoldenVectors
from certrack.export.monitor import PARAMETERS_CHANGED
from certrack.export.monitor_probes import MonitorProbes, monitor_probes
from certrack.export.templates import fill_template


def monitor_checks(code: CCode, vectors: GoldenVectors) -> str:
    """Functions of NAME_test.c that check NAME_monitor.h."""
    monitor, name, real = monitored(code), code.name, code.real
    probes = monitor_probes(code.system, code.program, monitor, vectors, real)
    flags, limiting = flag_names(code), monitor.limit_reference
    zero, one, off = (c_literal(value, real) for value in (0, 1, monitor.off))
    member = dict(zip(code.program.states, code.members, strict=False))

    def compared(state: sympy.Symbol, wanted: str) -> str:
        return f"    compare(worst, m.state.{member[state]}, {wanted}, {one});\n"

    with_parameters = bool(code.program.parameters)
    return fill_template(
        "c/templates/monitor_checks.c",
        name=name,
        probes=probes.x.shape[1],
        count=len(flags),
        table=_probe_table(code, probes),
        zero=zero,
        one=one,
        off=off,
        ones=initialiser((1.0 for _ in code.members), real),
        of_command=", ".join(str(flag.of_command).lower() for flag in flags.values()),
        listed="\n".join(f"    list[{i}] = f->{flag};" for i, flag in enumerate(flags)),
        latched="\n".join(_latched_checks(name, list(flags))),
        p="&parameters, " * with_parameters,
        y_d="limited" if limiting else "q->y_d",
        clipped=CLIPPED.format(real=code.type) if limiting else "",
        limited=_limited(code) if limiting else "",
        disabled="".join(
            compared(z, f"q->before.{member[z]}" if value is None else c_literal(value, real))
            for z, value in monitor.disabled.items()
        ),
        restarted="".join(
            compared(z, c_literal(value, real)) for z, value in monitor.restarted.items()
        ),
        parameter_checks=_parameter_checks(code) if with_parameters else "",
        parameter_call="    check_parameters(worst, &probes[0]);\n" * with_parameters,
    )


def _latched_checks(name: str, flags: list[str]) -> Iterator[str]:
    """Any flag that is latched is enough, and can be cleared."""
    for flag in flags:
        yield f"    m.latched.{flag} = true;"
        yield f"    expect(worst, !{name}_premises_hold(&m));"
        yield f"    {name}_clear_flags(&m);"
        yield f"    expect(worst, {name}_premises_hold(&m));"


CLIPPED = """static {real} clipped({real} value, {real} bound)
{{
    const {real} above = (value < bound) ? value : bound;

    return (above > -bound) ? above : -bound;
}}

"""


def _limited(code: CCode) -> str:
    """The reference that a monitor with a limiter lets pass."""
    entries = ",\n".join(
        f"        clipped(q->y_d[{i}], {c_literal(bound, code.real)})"
        for i, bound in enumerate(monitored(code).reference_bounds)
    )
    return f"    const {code.type} limited[{code.name}_REFERENCES] = {{\n{entries}\n    }};\n"


def _parameter_checks(code: CCode) -> str:
    """Any parameter that is 0.3 % off raises the flag of the parameters."""
    name, checks = code.name, []
    (flag,) = (f for f, each in flag_names(code).items() if each.name == PARAMETERS_CHANGED)
    for constant in code.program.parameters:
        parameter = f"m.parameters.{code.names[constant]}"
        checks += [
            "    set_monitor(&m, q);",
            f"    {parameter} = {parameter} * {c_literal(1 + MUTATION, code.real)};",
            f"    (void){name}_monitored_step(&m, true, q->x, q->y_d);",
            f"    expect(worst, m.now.{flag} && m.latched.{flag});",
        ]
    lines = "\n".join(checks)
    start = f"static void check_parameters({code.type} *worst, const probe *q)"
    return f"{start}\n{{\n    {name}_monitor m;\n\n{lines}\n}}\n\n"


def _probe_table(code: CCode, probes: MonitorProbes) -> str:
    """One initialiser per probe."""
    lines = []
    for k in range(probes.x.shape[1]):
        states = probes.states[:, k] if code.program.states else [0.0]
        parts = [
            initialiser(states, code.real),
            c_literal(float(probes.before[k]), code.real),
            initialiser(probes.x[:, k], code.real),
            initialiser(probes.Y[:, k], code.real),
            "{" + ", ".join(map(str, probes.expected[:, k])) + "}",
        ]
        lines.append("    {" + ",\n     ".join(parts) + "}")
    return ",\n".join(lines)
