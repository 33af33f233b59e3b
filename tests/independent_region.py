"""The region of a certificate file: the part of the page "The region", in fractions.

It reads no more than the independent checker does: a reference of sines and cosines without phase.
"""

import ast
import re
from fractions import Fraction as Q

from independent_checker import (
    Problem,
    Refused,
    check_stage,
    demand,
    form,
    inverse,
    product,
    root_above,
    spectrum,
    transposed,
)

#: How the premise of a region names it.
PRINTED = re.compile(r"\|(\w+)\| <= ([-+.0-9e]+)")

SLACK = 1 + Q(1, 10**9)


def check_region(document, system, table):
    """The premises that hold in the region; its numbers are not below what they must be."""
    named = [p for p in document["premises"] if p["name"].endswith(" in the region")]
    if "region" not in document:
        demand(not named, "a premise holds in a region, and there is none")
        return
    demand(named, "no premise needs the region")
    demand("transient" not in table["reference"], "a soft start has no region")
    demand(document["region"].get("shift") == "0", "a region has no shift")
    sizes = region(document["region"], system, table)
    for premise in named:
        printed = dict(PRINTED.findall(premise["detail"].split(" while ")[1]))
        demand(set(printed) == set(table["plant"]["states"]), "the region names other states")
        for name, size in zip(table["plant"]["states"], sizes, strict=True):
            demand(Q(printed[name]) >= size, f"the region is larger than said: {name}")


def region(stage, system, table):
    """X_1 ... X_n, rounded up."""
    leakage = (lambda alpha: system.leakage(alpha, Q(0))) if system.adaptive else None
    whole = Problem(
        system.M, system.A_inverse, system.a, system.b, system.y, leakage, system.selections
    )
    try:
        bound, P = check_stage(stage, whole, 0)
    except Refused:
        bound, P = check_stage(stage, whole, system.n - 1)
    x0 = system.numbers(table["simulation"]["x0"])
    Y = reference_at_start(table["reference"], system)
    e = [
        sum((a * x for a, x in zip(row, x0, strict=True)), Q(0))
        - sum((b * y for b, y in zip(offset, Y, strict=False)), Q(0))
        for row, offset in zip(system.A, system.B, strict=True)
    ]
    start = form(e, P)
    if system.adaptive:
        start += P[-1][-1] * estimates_at_start(system, table)
    level = SLACK * max(bound**2, start)
    demand(level > 0, "a level of 0 has nothing strictly inside")
    shape = product(product(system.A_inverse, inverse(P)), transposed(system.A_inverse))
    return [
        root_above(level * shape[i][i])
        + sum((abs(v) * y for v, y in zip(system.through[i], system.Y, strict=False)), Q(0))
        for i in range(system.n)
    ]


def reference_at_start(reference, system):
    """y_d(0) ... y_d^(q)(0) of a sum of sines and cosines."""
    known = {**system.constants, **reference.get("constants", {})}
    known = {name: Q(str(value)) for name, value in known.items()}
    waves = spectrum(ast.parse(str(reference["signal"]).strip(), mode="eval").body, known)
    values = []
    for i in range(system.q + 1):
        total = Q(0)
        for (w, phase), (cosine, sine) in waves.items():
            demand(phase == 0, "a phase")
            turned = ((cosine, sine), (sine, -cosine), (-cosine, -sine), (-sine, cosine))[i % 4]
            total += turned[0] * (abs(w) ** i if w >= 0 or i % 2 == 0 else -(abs(w) ** i))
        values.append(total)
    return values


def estimates_at_start(system, table):
    """The second part of 2 V(0), for s = 1, at the worst g and theta."""
    delta, *theta = map(
        Q, map(str, table["simulation"].get("estimates", (system.delta0, *system.theta0)))
    )
    gains = max(abs(g) * (1 / g - delta) ** 2 / system.gbar for g in system.gains)
    if not system.Gamma:
        return gains
    inverted = inverse(system.Gamma)
    corners = [[]]
    for box in system.boxes:
        corners = [[*corner, end] for corner in corners for end in box]
    return gains + max(
        form([v - t for v, t in zip(corner, theta, strict=True)], inverted) for corner in corners
    )
