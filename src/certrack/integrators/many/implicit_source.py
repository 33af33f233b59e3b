"""The generated part of ``native.c`` for linearly implicit steps: derivatives, and their matrix.

The matrix 1/gamma - h J of a system has its zeros where the Jacobian J has them, for all members
and at all times. So its triangular factors are written out entry by entry, without loops and
without what is zero: for a chain of integrators under a feedback of all states that is a number of
products that grows with n, where a full matrix takes n^3.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from certrack.core.hoisting import Hoisted, hoisted
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.many.native_source import (
    FunctionWriter,
    StepSource,
    braces,
    c_enum,
    c_table,
)
from certrack.integrators.rosenbrock import RODAS5P

#: A pivot is at least this part of what it is as the step vanishes, 1/gamma: factors then lose no
#: more than four digits to it, which is less than what the Jacobian of a moving system loses within
#: a step. For a chain of integrators all pivots but the last are 1/gamma, and the last one is the
#: characteristic polynomial of the rest at 1/(gamma h), so larger where the loop is stable.
LEAST_PIVOT = 1e-4

#: Points of Gauss's quadrature of a step's integrals, exact for the squares of cubics.
GAUSS_POINTS = 4

Place = tuple[int, int]


def implicit_steps() -> StepSource:
    """What the implicit steps of native.c want of ``system.h``."""
    method = RODAS5P
    powers = np.arange(1.0, len(method.dense) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    nodes, times = (1.0 + nodes) / 2.0, method.C.tolist()
    tables = (
        "#define IMPLICIT",
        c_enum({"POINTS": GAUSS_POINTS}),
        f"static const double GAMMA = {method.gamma!r};",
        c_table("A", method.A),
        c_table("B", method.B),
        c_table("C", np.concatenate([method.C, [1.0], nodes])),
        f"static const int SAME_TIME[] = {braces([times.index(c) for c in times])};",
        c_table("E", method.errors),
        c_table("COUPLING", method.coupling),
        c_table("SLOPE", method.slope),
        c_table("END_SLOPE", powers @ method.dense),
        c_table("INSIDE", nodes[:, None] ** powers @ method.dense),
        c_table("PARTS", weights / 2.0),
    )
    dense = np.pad(method.dense, ((0, 0), (0, 1)))  # the slope at the end has no weight
    return StepSource(method.stages, tables, dense, _linear_functions)


def _linear_functions(flow: AugmentedFlow, function: FunctionWriter) -> list[str]:
    """The functions of implicit_step.h."""
    size = len(flow.states)
    flow, forces = _with_forces(flow)
    places = [divmod(i, size) for i, formula in enumerate(flow.partials) if formula != 0]
    timed = [row for row, formula in enumerate(flow.by_time) if formula != 0]
    factors, factorise = triangular_factors(size, places)
    sizes = {
        "NONZEROS": len(places),
        "TIMED": len(timed),
        "FACTORS": factors.count,
        "FORCES": len(forces),
    }
    known = "const double *s, const double *c"
    names = {symbol: f"w[{i}]" for i, symbol in enumerate(forces.values())}
    partials = [flow.partials[row * size + column] for row, column in places]
    by_time = [flow.by_time[row] for row in timed]
    return [
        c_enum(sizes),
        function("integrands", f"{known}, const V *x, const V *p, V *q", ("q", flow.integrands)),
        function("forces", f"{known}, const V *p, V *w", ("w", list(forces))),
        function(
            "forced_rates",
            f"{known}, const V *w, const V *x, const V *p, V *k",
            ("k", flow.rates),
            more=names,
        ),
        function(
            "linearise",
            f"{known}, const V *w, const V *x, const V *p, V *k, V *j, V *d",
            ("k", flow.rates),
            ("j", partials),
            ("d", by_time),
            more=names,
        ),
        factorise,
        solve_function(factors, timed),
    ]


def _with_forces(flow: AugmentedFlow) -> tuple[AugmentedFlow, Hoisted]:
    """The flow with one symbol for every term of its rates in time and a member alone.

    Such terms, random disturbances above all, are computed once for the stages of a step that are
    at the same time. Modes are no part of them: they change without the time.
    """
    times = set().union(*(rate.free_symbols for rate in flow.rates))
    times -= {*flow.states, *flow.parameters, *flow.shared, *flow.numbers}
    members = set(flow.parameters[: len(flow.parameters) - 2 * len(flow.held)])
    formulas = [*flow.rates, *flow.partials, *flow.by_time]
    changed, symbols = hoisted(formulas, times, members | set(flow.numbers), "kept_force")
    used = set().union(*(formula.free_symbols for formula in changed[: len(flow.rates)]))
    forces = {
        term: name for term, name in symbols.items() if name in used and term.free_symbols & members
    }
    back = {name: term for term, name in symbols.items() if term not in forces}
    terms = iter([formula.xreplace(back) for formula in changed])
    rates, partials, by_time = (
        tuple(islice(terms, len(kind))) for kind in (flow.rates, flow.partials, flow.by_time)
    )
    return replace(flow, rates=rates, partials=partials, by_time=by_time), forces


@dataclass(frozen=True)
class TriangularFactors:
    """Where the factors of a matrix have their entries, pivot by pivot.

    Attributes
    ----------
    order : tuple of int
        The pivots' rows.
    below, beside : tuples of tuples of int, per row
        Rows below and columns beside its pivot with an entry in the factors.
    stored : dict
        Names of the entries and of the inverse pivots, and where these are kept.
    """

    order: tuple[int, ...]
    below: dict[int, tuple[int, ...]]
    beside: dict[int, tuple[int, ...]]
    stored: dict[str, str]

    @property
    def count(self) -> int:
        return len(self.stored)


def triangular_factors(size: int, places: Sequence[Place]) -> tuple[TriangularFactors, str]:
    """Factors of 1/GAMMA - h J, and the C function ``factorise``.

    Parameters
    ----------
    size : int
        Of the matrix.
    places : sequence of (row, column)
        Of the entries of J that are not zero, in the order in which they are stored.
    """
    lines = [f"  V {_entry(i, i)} = SPLAT(1.0 / GAMMA);" for i in range(size)]
    for k, (row, column) in enumerate(places):
        target = _entry(row, column)
        lines.append(
            f"  {target} -= h * j[{k}];" if row == column else f"  V {target} = -h * j[{k}];"
        )
    filled = {*places, *((i, i) for i in range(size))}
    left, order, below, beside = list(range(size)), [], {}, {}
    while left:
        pivot = min(left, key=lambda i: (_fill(filled, left, i), i))
        left.remove(pivot)
        order.append(pivot)
        below[pivot] = tuple(row for row in left if (row, pivot) in filled)
        beside[pivot] = tuple(column for column in left if (pivot, column) in filled)
        value = _entry(pivot, pivot)
        lines += [
            f"  holds &= {value} >= SPLAT({LEAST_PIVOT!r} / GAMMA);",
            f"  V {_inverse(pivot)} = 1.0 / {value};",
        ]
        for row in below[pivot]:
            lines.append(f"  {_entry(row, pivot)} *= {_inverse(pivot)};")
            for column in beside[pivot]:
                known = (row, column) in filled
                filled.add((row, column))
                product = f"{_entry(row, pivot)} * {_entry(pivot, column)}"
                target = _entry(row, column)
                lines.append(
                    f"  {target} -= {product};" if known else f"  V {target} = -({product});"
                )
    names = [_inverse(i) for i in order]
    names += [_entry(row, i) for i in order for row in below[i]]
    names += [_entry(i, column) for i in order for column in beside[i]]
    stored = {name: f"m[{k}]" for k, name in enumerate(names)}
    lines += [f"  {place} = {name};" for name, place in stored.items()]
    head = "INLINE I factorise(double h, const V *j, V *m) {\n  I holds = ~(I){0};\n"
    text = head + "\n".join(lines) + "\n  return holds;\n}\n"
    return TriangularFactors(tuple(order), below, beside, stored), text


def solve_function(factors: TriangularFactors, timed: Sequence[int]) -> str:
    """The C function ``solve``.

    Parameters
    ----------
    factors : TriangularFactors
    timed : sequence of int
        Rows whose rate has a derivative by time, in the order in which these are stored.
    """
    name_of = factors.stored
    lines = [f"  f[{row}] += weight * d[{k}];" for k, row in enumerate(timed)]
    for i in factors.order:
        lines += [f"  f[{row}] -= {name_of[_entry(row, i)]} * f[{i}];" for row in factors.below[i]]
    for i in reversed(factors.order):
        lines += [f"  f[{i}] -= {name_of[_entry(i, j)]} * f[{j}];" for j in factors.beside[i]]
        lines.append(f"  f[{i}] *= {name_of[_inverse(i)]};")
    head = "INLINE void solve(const V *m, const V *d, double weight, V *f) {\n"
    return head + "  (void)d, (void)weight;\n" + "\n".join(lines) + "\n}\n"


def _fill(filled: Set[Place], left: Sequence[int], pivot: int) -> int:
    """The most entries that become nonzero if a pivot is taken next (Markowitz)."""
    rows = sum((row, pivot) in filled for row in left)
    columns = sum((pivot, column) in filled for column in left)
    return (rows - 1) * (columns - 1)


def _entry(row: int, column: int) -> str:
    return f"a_{row}_{column}"


def _inverse(row: int) -> str:
    return f"inverse_{row}"
