"""The closed loop with everything a member's metrics need, for the lockstep integrator.

Numbers that all members share are put into the formulas, so that the compiled step computes with
them and not about them.
"""

from __future__ import annotations

from collections.abc import Iterable

import sympy

from certrack.core.expressions import TIME, derivative, symbol
from certrack.core.select import (
    STEP_BEGIN,
    STEP_LENGTH,
    Entry,
    Extremum,
    Select,
    larger,
    magnitude,
)
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.loops.continuous import INTEGRALS, ClosedLoop
from certrack.loops.plant import INPUT
from certrack.loops.sampled import SIDES, SQUARE, Totals
from certrack.studies.ensembles.members import Members

#: Rows of the signals; outputs that are not states follow.
SIGNALS = ("e", "e_rate", "u", "u_rate")

#: Rows of the integrals.
SUMS = ("integral_squared_error", "input_energy")

#: Rows of the memories.
MEMORIES = ("input_variation", "peak_input", "tail_error", "last_outside", "integral_abs_error")

#: 1 where the step lies in the tail of the run; half-width of the settling band.
IN_TAIL, BAND = symbol("kept_in_tail"), symbol("kept_band")


def make_flow(members: Members, varying: Iterable[sympy.Symbol]) -> AugmentedFlow:
    """Rates, metrics and signals of a system's closed loop.

    Parameters
    ----------
    members : Members
    varying : symbols
        Parameters that differ between members; the others get their values.
    """
    loop = members.loop
    free = set(varying)
    fixed = {
        name: sympy.Float(float(value))
        for name, value in zip(loop.parameters, members.base, strict=False)
        if name not in free
    }
    states = loop.states[: -len(INTEGRALS)]
    rates = [rate.xreplace(fixed) for rate in loop.rates[: len(states)]]
    e, u = loop.e_1.xreplace(fixed), loop.u.xreplace(fixed)
    slopes = tuple(symbol(f"kept_rate_of_{state.name}") for state in states)
    flow = dict(zip(states, slopes, strict=True)) | {TIME: sympy.Integer(1)}
    outputs = [formula.xreplace(fixed) for formula in _computed_outputs(loop)]
    signals = tuple(
        f
        for formula in (e, u)
        for f in (formula, _along(formula, flow))  # and its rate
    )
    names = (*SIGNALS, *(f"x{i}" for i in range(len(outputs))))
    sides = tuple((symbol(f"kept_{name}_begin"), symbol(f"kept_{name}_end")) for name in names)
    used = set().union(*(f.free_symbols for f in (*rates, e, u, *outputs)))
    pieces = tuple(loop.parameters[len(loop.parameters) - loop.pieces :])
    return AugmentedFlow(
        states=states,
        rates=tuple(rates),
        parameters=(*(name for name in loop.parameters if name in used & free), BAND),
        integrands=(e**2, u**2),
        signals=(*signals, *outputs),
        slopes=slopes,
        memories=tuple(zip(map(_memory, MEMORIES), _memories(sides[: len(SIGNALS)]), strict=True)),
        sides=sides,
        watched=loop.n,
        shared=(IN_TAIL, *pieces),
    )


def _along(formula: sympy.Expr, flow: dict[sympy.Symbol, sympy.Expr]) -> sympy.Expr:
    """Time derivative of a formula of state and time, by the chain rule."""
    present = [name for name in flow if name in formula.free_symbols]
    return sympy.Add(*(derivative(formula, name) * flow[name] for name in present))


def shown(flow: AugmentedFlow, loop: ClosedLoop) -> tuple[sympy.Symbol, ...]:
    """What the bands show of a loop's flow: e_1, the states of the design, u."""
    ends = [end for _, end in flow.sides]
    computed = dict(zip(_computed_outputs(loop), ends[len(SIGNALS) :], strict=True))
    states = (computed.get(output, output) for output in loop.plant.outputs)
    return (ends[SIGNALS.index("e")], *states, ends[SIGNALS.index("u")])


def _computed_outputs(loop: ClosedLoop) -> list[sympy.Expr]:
    """Outputs of the simulated plant that are not states of it: signals of their own."""
    outputs = dict.fromkeys(loop.plant.outputs)
    return [output for output in outputs if output not in loop.plant.states]


def _memories(sides: tuple[tuple[sympy.Symbol, sympy.Symbol], ...]) -> list[sympy.Expr]:
    """Update of every memory at the end of a step."""
    (e0, e1), (r0, r1), (u0, u1), (v0, v1) = sides
    variation, peak = map(_memory, MEMORIES[:2])
    u_peak = Extremum(u0, u1, STEP_LENGTH * v0, STEP_LENGTH * v1)
    return [
        variation + magnitude(u_peak - u0) + magnitude(u1 - u_peak),
        larger(peak, larger(magnitude(u_peak), magnitude(u1))),
        *_of_error(e0, e1, r0, r1),
    ]


def _of_error(e0: sympy.Expr, e1: sympy.Expr, r0: sympy.Expr, r1: sympy.Expr) -> list[sympy.Expr]:
    """Tail error, last time outside the band, integral of |e_1|; from e_1 and its rate."""
    tail, outside, total = map(_memory, MEMORIES[2:])
    peak = Extremum(e0, e1, STEP_LENGTH * r0, STEP_LENGTH * r1)
    largest = larger(larger(magnitude(e0), magnitude(e1)), magnitude(peak))
    crossing = STEP_BEGIN + STEP_LENGTH * Entry(e0, e1, STEP_LENGTH * r0, STEP_LENGTH * r1, BAND)
    left = Select(largest, BAND, crossing, outside)
    return [
        larger(tail, IN_TAIL * largest),
        Select(magnitude(e1), BAND, STEP_BEGIN + STEP_LENGTH, left),
        total + STEP_LENGTH * _area(e0, e1, STEP_LENGTH * r0, STEP_LENGTH * r1),
    ]


def sampled_totals() -> Totals:
    """What is kept of a member under a sampled controller: u is constant on every step.

    All of :data:`SUMS` and :data:`MEMORIES` but the variation of the input.
    """
    square, energy, peak = (_memory(name) for name in (*SUMS, MEMORIES[1]))
    return (
        (square, square + SQUARE),
        (energy, energy + STEP_LENGTH * INPUT**2),
        (peak, larger(peak, magnitude(INPUT))),
        *zip(map(_memory, MEMORIES[2:]), _of_error(*SIDES), strict=True),
    )


def _area(e0: sympy.Expr, e1: sympy.Expr, d0: sympy.Expr, d1: sympy.Expr) -> sympy.Expr:
    """Mean of |p| on [0, 1] for the cubic; for the chord where it changes sign."""
    chord = (e0**2 + e1**2) / (2 * (magnitude(e0) + magnitude(e1)) + 1e-300)
    return Select(0, e0 * e1, chord, magnitude((e0 + e1) / 2 + (d0 - d1) / 12))


def _memory(name: str) -> sympy.Symbol:
    return symbol(f"kept_{name}")
