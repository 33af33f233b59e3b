"""The acceptance test that goes with the C code: golden vectors and a program that compares."""

from __future__ import annotations

from collections.abc import Iterable

from certrack.export.c.golden import TOLERANCE, Golden
from certrack.export.c.printer import c_literal
from certrack.export.c.source import CCode


def test_source(code: CCode, vectors: Golden) -> str:
    """Contents of NAME_test.c."""
    name, real = code.name, code.type
    zero = c_literal(0, code.real)
    implementation = code.system.implementation
    assert implementation is not None
    period = c_literal(implementation.period, code.real)
    started = "    compare_states(&worst, &s, &samples[0].before, &samples[0].scale);\n"
    started = started if vectors.carried else ""
    magnitude = "fabsf" if code.real == "float" else "fabs"
    compared = "\n".join(
        f"    compare(worst, got->{member}, want->{member}, scale->{member});"
        for member in code.members
    )
    return f"""/*
 * Acceptance test of {name}.c: prints the worst deviation and returns 0 if all is well.
 *
 *     gcc {name}.c {name}_test.c -lm && ./a.out
 *
 * The answers were computed in double precision from the controller that certrack simulates.
 * The first {vectors.carried} samples follow each other in a closed loop and carry the state
 * along; at the others every number in {name}.c shows. A deviation is relative to the
 * sum of the magnitudes that an answer is made of.
 */

#include "{name}.h"

#include <math.h>
#include <stdio.h>

#define CARRIED {vectors.carried}
#define SAMPLES {vectors.x.shape[1]}
#define TOLERANCE {c_literal(TOLERANCE[code.real], code.real)}

typedef struct {{
    {name}_state before;
    {real} x[{name}_STATES];
    {real} y_d[{name}_REFERENCES];
    {real} u;
    {name}_state after;
    {real} u_scale;
    {name}_state scale;
}} sample;

static const sample samples[SAMPLES] = {{
{_table(code, vectors)}
}};

static void compare({real} *worst, {real} got, {real} want, {real} scale)
{{
    const {real} deviation = {magnitude}(got - want) / scale;

    if (!(deviation <= *worst)) {{ /* also where it is not a number */
        *worst = (deviation >= {zero}) ? deviation : {c_literal(1, code.real)};
    }}
}}

static void compare_states({real} *worst, const {name}_state *got, const {name}_state *want,
    const {name}_state *scale)
{{
{compared}
}}

int main(void)
{{
    {name}_state s;
    {real} worst = {zero};
    int i;

    compare(&worst, {name}_PERIOD, {period}, {period});
    {name}_init(&s);
{started}    for (i = 0; i < SAMPLES; i++) {{
        const sample *p = &samples[i];
        {name}_state updated;
        {real} u;

        if (i >= CARRIED) {{
            s = p->before;
        }}
        updated = s;
        u = {name}_output(&s, p->x, p->y_d);
        compare(&worst, u, p->u, p->u_scale);
        {name}_update(&updated, p->x, p->y_d);
        compare_states(&worst, &updated, &p->after, &p->scale);
        u = {name}_step(&s, p->x, p->y_d);
        compare(&worst, u, p->u, p->u_scale);
        compare_states(&worst, &s, &p->after, &p->scale);
    }}
    (void)printf("{name}: %d samples, worst deviation %.3g of %.3g allowed: %s\\n", SAMPLES,
        (double)worst, (double)TOLERANCE, (worst <= TOLERANCE) ? "passed" : "FAILED");
    return (worst <= TOLERANCE) ? 0 : 1;
}}
"""


def _table(code: CCode, vectors: Golden) -> str:
    """One initialiser per sample."""

    def numbers(values: Iterable[float]) -> str:
        return "{" + ", ".join(c_literal(float(value), code.real) for value in values) + "}"

    def state(values: Iterable[float], unused: float = 0.0) -> str:
        return numbers(values if code.program.states else [unused])

    lines = []
    for k in range(vectors.x.shape[1]):
        answers, scales = vectors.answers[:, k], vectors.scales[:, k]
        parts = [
            state(vectors.states[:, k]),
            numbers(vectors.x[:, k]),
            numbers(vectors.Y[:, k]),
            c_literal(float(answers[0]), code.real),
            state(answers[1:]),
            c_literal(float(f"{scales[0]:.3g}"), code.real),
            state((float(f"{scale:.3g}") for scale in scales[1:]), 1.0),
        ]
        lines.append("    {" + ",\n     ".join(parts) + "}")
    return ",\n".join(lines)
