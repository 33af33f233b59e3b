"""The acceptance test that goes with the C code: golden vectors and a program that compares."""

from __future__ import annotations

from collections.abc import Iterable

from certrack.core.rounding import in_digits
from certrack.export.c.monitor_checks import monitor_checks
from certrack.export.c.printer import c_literal, initialiser
from certrack.export.c.source import CCode
from certrack.export.golden_vectors import GOLDEN_TOLERANCE, GoldenVectors
from certrack.export.templates import fill_template


def acceptance_test(code: CCode, vectors: GoldenVectors) -> str:
    """Contents of NAME_test.c."""
    implementation = code.system.implementation
    assert implementation is not None
    with_parameters = bool(code.program.parameters)
    started = "    compare_states(&worst, &s, &samples[0].before, &samples[0].scale);\n"
    compared = [
        f"    compare(worst, got->{member}, want->{member}, scale->{member});"
        for member in code.members
    ]
    return fill_template(
        "c/templates/controller_test.c",
        name=code.name,
        carried=vectors.carried,
        samples=vectors.x.shape[1],
        tolerance=c_literal(GOLDEN_TOLERANCE[code.real], code.real),
        table=_table(code, vectors),
        magnitude="fabsf" if code.real == "float" else "fabs",
        zero=c_literal(0, code.real),
        one=c_literal(1, code.real),
        compared="\n".join(compared),
        period=c_literal(implementation.period, code.real),
        started=started if vectors.carried else "",
        parameters=f"static {code.name}_parameters parameters;\n\n" * with_parameters,
        p="&parameters, " * with_parameters,
        preset=f"    {code.name}_preset(&parameters);\n" * with_parameters,
        monitor_include=f'#include "{code.name}_monitor.h"\n' if code.monitor else "",
        monitor_checks=monitor_checks(code, vectors) if code.monitor else "",
        monitor_call="    check_monitor(&worst);\n" if code.monitor else "",
    )


def _table(code: CCode, vectors: GoldenVectors) -> str:
    """One initialiser per sample."""

    def state(values: Iterable[float], unused: float = 0.0) -> str:
        return initialiser(values if code.program.states else [unused], code.real)

    lines = []
    for k in range(vectors.x.shape[1]):
        answers, scales = vectors.answers[:, k], vectors.scales[:, k]
        parts = [
            state(vectors.states[:, k]),
            initialiser(vectors.x[:, k], code.real),
            initialiser(vectors.Y[:, k], code.real),
            c_literal(float(answers[0]), code.real),
            state(answers[1:]),
            c_literal(in_digits(scales[0], 3), code.real),
            state((in_digits(scale, 3) for scale in scales[1:]), 1.0),
        ]
        lines.append("    {" + ",\n     ".join(parts) + "}")
    return ",\n".join(lines)
