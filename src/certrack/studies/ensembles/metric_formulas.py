"""The metrics of a member as formulas, updated step by step by the integrators of many members.

They see every step of a member: e_1 and u with their rates at both ends, which give cubics between
them. What they keep is a number for each metric.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy

from certrack.core.expressions import symbol
from certrack.core.select import STEP_BEGIN, STEP_LENGTH, Entry, Extremum, Select, larger, magnitude
from certrack.loops.plant import INPUT
from certrack.loops.sampled import SIDES, SQUARE, Totals

#: Signals that the metrics are made of; in a flow, outputs that are not states follow them.
METRIC_SIGNALS = ("e", "e_rate", "u", "u_rate")

#: Metrics, or what they are computed from, that are integrals of a formula.
INTEGRAL_METRICS = ("integral_squared_error", "input_energy")

#: Those that are updated at the end of every step from the signals at both ends.
MEMORY_METRICS = (
    "input_variation",
    "peak_input",
    "tail_error",
    "last_outside",
    "integral_abs_error",
)

#: 1 where the step lies in the tail of the run; half-width of the settling band.
IN_TAIL, SETTLING_BAND = symbol("kept_in_tail"), symbol("kept_band")


#: Keeps a quotient defined where both its parts are zero.
TINY = 1e-300


def memory_updates(
    sides: Sequence[tuple[sympy.Symbol, sympy.Symbol]],
) -> tuple[tuple[sympy.Symbol, sympy.Expr], ...]:
    """What is kept for each of :data:`MEMORY_METRICS`, and its value after a step.

    Parameters
    ----------
    sides : pairs of symbols
        Each of :data:`METRIC_SIGNALS` at begin and end of the step.
    """
    return tuple(zip(map(_memory, MEMORY_METRICS), _updates(*sides), strict=True))


def _updates(
    e: tuple[sympy.Symbol, sympy.Symbol],
    e_rate: tuple[sympy.Symbol, sympy.Symbol],
    u: tuple[sympy.Symbol, sympy.Symbol],
    u_rate: tuple[sympy.Symbol, sympy.Symbol],
) -> list[sympy.Expr]:
    """Formulas in the order of MEMORY_METRICS."""
    (u0, u1), (v0, v1) = u, u_rate
    variation, peak = map(_memory, MEMORY_METRICS[:2])
    u_peak = Extremum(u0, u1, STEP_LENGTH * v0, STEP_LENGTH * v1)
    return [
        variation + magnitude(u_peak - u0) + magnitude(u1 - u_peak),
        larger(peak, larger(magnitude(u_peak), magnitude(u1))),
        *_error_updates(*e, *e_rate),
    ]


def _error_updates(
    e0: sympy.Expr, e1: sympy.Expr, r0: sympy.Expr, r1: sympy.Expr
) -> list[sympy.Expr]:
    """Tail error, last time outside the band, integral of |e_1|; from e_1 and its rate."""
    tail, outside, total = map(_memory, MEMORY_METRICS[2:])
    peak = Extremum(e0, e1, STEP_LENGTH * r0, STEP_LENGTH * r1)
    largest = larger(larger(magnitude(e0), magnitude(e1)), magnitude(peak))
    crossing = STEP_BEGIN + STEP_LENGTH * Entry(
        e0, e1, STEP_LENGTH * r0, STEP_LENGTH * r1, SETTLING_BAND
    )
    left = Select(largest, SETTLING_BAND, crossing, outside)
    return [
        larger(tail, IN_TAIL * largest),
        Select(magnitude(e1), SETTLING_BAND, STEP_BEGIN + STEP_LENGTH, left),
        total + STEP_LENGTH * _mean_magnitude(e0, e1, STEP_LENGTH * r0, STEP_LENGTH * r1),
    ]


def sampled_totals() -> Totals:
    """What is kept of a member under a sampled controller: u is constant on every step.

    All of :data:`INTEGRAL_METRICS` and :data:`MEMORY_METRICS` but the variation of the input.
    """
    square, energy, peak = (_memory(name) for name in (*INTEGRAL_METRICS, MEMORY_METRICS[1]))
    return (
        (square, square + SQUARE),
        (energy, energy + STEP_LENGTH * INPUT**2),
        (peak, larger(peak, magnitude(INPUT))),
        *zip(map(_memory, MEMORY_METRICS[2:]), _error_updates(*SIDES), strict=True),
    )


def _mean_magnitude(e0: sympy.Expr, e1: sympy.Expr, d0: sympy.Expr, d1: sympy.Expr) -> sympy.Expr:
    """Mean of |p| on [0, 1] for the cubic; for the chord where it changes sign."""
    chord = (e0**2 + e1**2) / (2 * (magnitude(e0) + magnitude(e1)) + TINY)
    return Select(0, e0 * e1, chord, magnitude((e0 + e1) / 2 + (d0 - d1) / 12))


def _memory(name: str) -> sympy.Symbol:
    return symbol(f"kept_{name}")
