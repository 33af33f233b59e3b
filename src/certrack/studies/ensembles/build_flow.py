"""Build the flow of a closed loop: rates, metrics and signals, for the integrators of many members.

Numbers that all members share are put into the formulas, so that the compiled step computes with
them and not about them; or those that make no difference to its structure stay symbols, so that one
that was compiled serves all their values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import sympy

from certrack.core.expressions import symbol
from certrack.core.kinks import along
from certrack.core.memo import remembered
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.loops.continuous import INTEGRALS, ClosedLoop
from certrack.loops.switching import switching
from certrack.loops.time_switches import TimeSwitches, take_switches
from certrack.studies.ensembles.members import Members
from certrack.studies.ensembles.metric_formulas import (
    IN_TAIL,
    METRIC_SIGNALS,
    SETTLING_BAND,
    memory_updates,
)

#: Values that are worth to be known when code is written: whole terms or factors fall out.
STRUCTURAL = (0.0, 1.0, -1.0)


def build_flow(
    members: Members, varying: Iterable[sympy.Symbol], *, any_numbers: bool = False
) -> tuple[AugmentedFlow, TimeSwitches]:
    """Rates, metrics and signals of a system's closed loop, and its switches of time.

    Parameters
    ----------
    members : Members
    varying : symbols
        Parameters that differ between members; the others get their values.
    any_numbers : bool
        Whether the flow keeps symbols, its ``numbers``, for those that :func:`open_numbers` says.
    """
    loop, free = members.loop, frozenset(varying)
    base = dict(zip(loop.parameters, members.base.tolist(), strict=False))
    formulas = (*loop.rates, loop.e_1, loop.u, *loop.plant.outputs)
    numbers = open_numbers(base, free, formulas) if any_numbers else ()
    fixed = tuple((s, v) for s, v in base.items() if s not in free and s not in numbers)
    return _flow_with(loop, free, fixed, numbers)


def open_numbers(
    values: Mapping[sympy.Symbol, float],
    varying: Iterable[sympy.Symbol],
    formulas: Iterable[sympy.Expr],
) -> tuple[sympy.Symbol, ...]:
    """The parameters that may stay symbols, though all members share their values.

    Others change the structure of the formulas: :data:`STRUCTURAL` values, and exponents, which are
    written as products where they are whole numbers.
    """
    powers = set().union(*(formula.atoms(sympy.Pow) for formula in formulas))
    left_out = set(varying).union(*(power.exp.free_symbols for power in powers))
    return tuple(s for s, v in values.items() if s not in left_out and v not in STRUCTURAL)


@remembered
def _flow_with(
    loop: ClosedLoop,
    free: frozenset[sympy.Symbol],
    values: tuple[tuple[sympy.Symbol, float], ...],
    numbers: tuple[sympy.Symbol, ...],
) -> tuple[AugmentedFlow, TimeSwitches]:
    """The flow with values put in; loops that are equal have one."""
    fixed = {name: sympy.Float(value) for name, value in values}
    states = loop.states[: -len(INTEGRALS)]
    outputs = _computed_outputs(loop)
    formulas = [f.xreplace(fixed) for f in (*loop.rates, loop.e_1, loop.u, *outputs)]
    formulas, switches = take_switches(formulas, numbers, free)
    rates, others = formulas[: len(loop.states)], formulas[len(loop.states) :]
    e, u, *outputs = others
    switched = switching(rates, loop.states, smooth_rates=len(INTEGRALS))
    if switched is not None:
        rates, (u,) = list(switched.rates), switched.resolved([u])
    rates = rates[: len(states)]
    slopes = tuple(symbol(f"kept_rate_of_{state.name}") for state in states)
    rate_of = dict(zip(states, slopes, strict=True))
    signals = tuple(
        f
        for formula in (e, u)
        for f in (formula, along(formula, rate_of))  # and its rate
    )
    names = (*METRIC_SIGNALS, *(f"x{i}" for i in range(len(outputs))))
    sides = tuple((symbol(f"kept_{name}_begin"), symbol(f"kept_{name}_end")) for name in names)
    used = set().union(*(f.free_symbols for f in (*rates, e, u, *outputs)))
    pieces = tuple(loop.parameters[len(loop.parameters) - loop.pieces :])
    flow = AugmentedFlow(
        states=states,
        rates=tuple(rates),
        parameters=(
            *(name for name in loop.parameters if name in used & free),
            SETTLING_BAND,
            *(() if switched is None else switched.modes),
        ),
        integrands=(e**2, u**2),
        signals=(*signals, *outputs),
        slopes=slopes,
        memories=memory_updates(sides[: len(METRIC_SIGNALS)]),
        sides=sides,
        watched=loop.n,
        shared=(IN_TAIL, *pieces, *switches.symbols),
        numbers=numbers,
        held=() if switched is None else tuple(map(states.index, switched.surfaces)),
        surfaces=()
        if switched is None
        else (*switched.values, *switched.drifts, *switched.effects),
    )
    return flow, switches


def shown_signals(flow: AugmentedFlow, loop: ClosedLoop) -> tuple[sympy.Symbol, ...]:
    """What the bands show of a loop's flow: e_1, the states of the design, u."""
    ends = [end for _, end in flow.sides]
    computed = dict(zip(_computed_outputs(loop), ends[len(METRIC_SIGNALS) :], strict=True))
    states = (computed.get(output, output) for output in loop.plant.outputs)
    return (ends[METRIC_SIGNALS.index("e")], *states, ends[METRIC_SIGNALS.index("u")])


def _computed_outputs(loop: ClosedLoop) -> list[sympy.Expr]:
    """Outputs of the simulated plant that are not states of it: signals of their own."""
    outputs = dict.fromkeys(loop.plant.outputs)
    return [output for output in outputs if output not in loop.plant.states]
