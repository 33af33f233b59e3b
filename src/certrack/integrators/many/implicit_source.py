"""The generated part of ``native.c`` for linearly implicit steps: derivatives, and their matrix.

The matrix 1/gamma - h J of a system has its zeros where the Jacobian J has them, for all members
and at all times. So its triangular factors are written out entry by entry, without loops and
without what is zero: for a chain of integrators under a feedback of all states that is a number of
products that grows with n, where a full matrix takes n^3.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from itertools import islice

import numpy as np

from certrack.core.hoisting import Hoisted, hoisted
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.many.native_source import FunctionWriter, StepSource, c_enum, c_table
from certrack.integrators.rosenbrock import RODAS5P

#: A pivot is at least this part of what it is as the step vanishes, 1/gamma: factors then lose no
#: more than four digits to it, which is less than what the Jacobian of a moving system loses within
#: a step. For a chain of integrators all pivots but the last are 1/gamma, and the last one is the
#: characteristic polynomial of the rest at 1/(gamma h), so larger where the loop is stable.
LEAST_PIVOT = 1e-4

Place = tuple[int, int]


def implicit_steps() -> StepSource:
    """What the implicit steps of native.c want of ``system.h``."""
    method = RODAS5P
    powers = np.arange(1.0, len(method.dense) + 1)
    tables = (
        "#define IMPLICIT",
        f"static const double GAMMA = {method.gamma!r};",
        c_table("A", method.A),
        c_table("B", method.B),
        c_table("C", np.append(method.C, 1.0)),
        c_table("E", method.errors),
        c_table("COUPLING", method.coupling),
        c_table("SLOPE", method.slope),
        c_table("END_SLOPE", powers @ method.dense),
        c_table("SAME_TIME", np.array([list(method.C).index(c) for c in method.C])).replace(
            "double", "int"
        ),
    )
    dense = np.pad(method.dense, ((0, 0), (0, 1)))  # the slope at the end has no weight
    return StepSource(method.stages, tables, dense, _linear_functions)


def _linear_functions(flow: AugmentedFlow, function: FunctionWriter) -> list[str]:
    """``forces``, ``forced_rates``, ``linearise``, ``factorise``, ``solve`` of implicit_step.h."""
    size = len(flow.states)
    flow, forces = _with_forces(flow)
    places = [divmod(i, size) for i, formula in enumerate(flow.partials) if formula != 0]
    timed = [row for row, formula in enumerate(flow.by_time) if formula != 0]
    factors, *solver = elimination(size, places, timed)
    sizes = {
        "NONZEROS": len(places),
        "TIMED": len(timed),
        "FACTORS": factors,
        "FORCES": len(forces),
        "ROWS": len(flow.by_time),
    }
    known = "const double *s, const double *c"
    names = {symbol: f"w[{i}]" for i, symbol in enumerate(forces.values())}
    rates = [("k", flow.rates), ("q", flow.integrands)]
    return [
        c_enum(sizes),
        function("forces", f"{known}, const V *p, V *w", ("w", list(forces))),
        function(
            "forced_rates", f"{known}, const V *w, const V *x, const V *p, V *k, V *q", *rates,
            more=names,
        ),
        function(
            "linearise",
            f"{known}, const V *w, const V *x, const V *p, V *k, V *q, V *j, V *d",
            *rates,
            ("j", [flow.partials[row * size + column] for row, column in places]),
            ("d", [flow.by_time[row] for row in timed]),
            more=names,
        ),
        *solver,
    ]


def _with_forces(flow: AugmentedFlow) -> tuple[AugmentedFlow, Hoisted]:
    """The flow with one symbol for every term of rates and integrands in time and a member alone.

    Such terms, random disturbances above all, are computed once for the stages of a step that are
    at the same time. Modes are no part of them: they change without the time.
    """
    times = set().union(*(f.free_symbols for f in (*flow.rates, *flow.integrands)))
    times -= {*flow.states, *flow.parameters, *flow.shared, *flow.numbers}
    members = set(flow.parameters[: len(flow.parameters) - 2 * len(flow.held)])
    formulas = [*flow.rates, *flow.integrands, *flow.partials, *flow.by_time]
    changed, symbols = hoisted(formulas, times, members | set(flow.numbers), "kept_force")
    count = len(flow.rates) + len(flow.integrands)
    used = set().union(*(formula.free_symbols for formula in changed[:count]))
    forces = {
        term: name for term, name in symbols.items() if name in used and term.free_symbols & members
    }
    back = {name: term for term, name in symbols.items() if term not in forces}
    terms = iter([formula.xreplace(back) for formula in changed])
    kinds = ("rates", "integrands", "partials", "by_time")
    parts = {kind: tuple(islice(terms, len(getattr(flow, kind)))) for kind in kinds}
    return replace(flow, **parts), forces


def elimination(
    size: int, places: list[Place], timed: list[int]
) -> tuple[int, str, str]:
    """Triangular factors of 1/GAMMA - h J and the solution with them, as C of vectors.

    Rows from `size` on are quantities on which nothing depends, such as integrals: they follow from
    the solution of the others.

    Parameters
    ----------
    size : int
        Of the square matrix.
    places : list of (row, column)
        Of the entries of J that are not zero, in the order in which they are stored.
    timed : list of int
        Rows with a derivative by time, in the order in which these are stored.

    Returns
    -------
    factors : int
        How many numbers the factors are.
    factorise, solve : str
        C functions.
    """
    filled = {(row, column) for row, column in places if row < size} | {(i, i) for i in range(size)}
    order, below, beside = [], {}, {}
    left = list(range(size))
    update = []
    while left:
        pivot = min(left, key=lambda i: (_fill(filled, left, i), i))
        left.remove(pivot)
        order.append(pivot)
        below[pivot] = [row for row in left if (row, pivot) in filled]
        beside[pivot] = [column for column in left if (pivot, column) in filled]
        update += [
            f"  V inverse_{pivot} = 1.0 / {_entry(pivot, pivot)};",
            f"  holds &= v_abs({_entry(pivot, pivot)}) >= SPLAT({LEAST_PIVOT!r} / GAMMA);",
        ]
        for row in below[pivot]:
            update.append(f"  {_entry(row, pivot)} *= inverse_{pivot};")
            for column in beside[pivot]:
                product = f"{_entry(row, pivot)} * {_entry(pivot, column)}"
                if (row, column) in filled:
                    update.append(f"  {_entry(row, column)} -= {product};")
                else:
                    filled.add((row, column))
                    update.append(f"  V {_entry(row, column)} = -({product});")
    start = []
    for i in range(size):
        start.append(f"  V {_entry(i, i)} = SPLAT(1.0 / GAMMA);")
    stored: dict[str, int] = {}

    def kept(name: str) -> str:
        return f"m[{stored.setdefault(name, len(stored))}]"

    for k, (row, column) in enumerate(places):
        if row == column:
            start.append(f"  {_entry(row, row)} -= h * j[{k}];")
        elif row < size:
            start.append(f"  V {_entry(row, column)} = -h * j[{k}];")
    forward, backward, integrals = [], [], []
    for pivot in order:
        for row in below[pivot]:
            forward.append(f"  f[{row}] -= {kept(_entry(row, pivot))} * f[{pivot}];")
    for pivot in reversed(order):
        for column in beside[pivot]:
            backward.append(f"  f[{pivot}] -= {kept(_entry(pivot, column))} * f[{column}];")
        backward.append(f"  f[{pivot}] *= {kept(f'inverse_{pivot}')};")
    outer = sorted({row for row, _ in places if row >= size} | {r for r in timed if r >= size})
    for k, (row, column) in enumerate(places):
        if row >= size:
            name = _entry(row, column)
            start.append(f"  V {name} = h * j[{k}];")
            integrals.append(f"  f[{row}] += {kept(name)} * f[{column}];")
    store = [f"  m[{place}] = {name};" for name, place in stored.items()]
    add = [f"  f[{row}] += weight * d[{k}];" for k, row in enumerate(timed)]
    scaled = ["  for (int i = STATES; i < ROWS; i++) f[i] *= GAMMA;"]
    factorise = [
        "INLINE I factorise(double h, const V *j, V *m) {",
        "  I holds = ~(I){0};",
        *start,
        *update,
        *store,
        "  return holds;",
        "}",
    ]
    solve = [
        "INLINE void solve(const V *m, const V *d, double weight, V *f) {",
        "  (void)d, (void)weight;",
        *add,
        *forward,
        *backward,
        *integrals,
        *scaled,
        "}",
    ]
    del outer
    return len(stored), "\n".join(factorise) + "\n", "\n".join(solve) + "\n"


def _fill(filled: Set[Place], left: list[int], pivot: int) -> int:
    """The most entries that become nonzero if a pivot is taken next (Markowitz)."""
    rows = sum((row, pivot) in filled for row in left)
    columns = sum((pivot, column) in filled for column in left)
    return (rows - 1) * (columns - 1)


def _entry(row: int, column: int) -> str:
    return f"a_{row}_{column}"
