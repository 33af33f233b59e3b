"""The compiled step of the lockstep integrator: one heyoka map of all rows of a member's column."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy

from certrack.core.lowering import to_heyoka
from certrack.core.select import STEP_BEGIN, STEP_LENGTH
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.pairs import THIRD_ORDER_WEIGHT, Pair, heyoka_step, heyoka_sum
from certrack.integrators.registers import LANES

#: Rows of the runtime parameters before what depends on time alone: begin, length, tolerance.
STEP_ROWS = 3


class StepMap:
    """The step of `pair` as one compiled map of all rows; without a pair, the restart.

    Attributes
    ----------
    function : heyoka.cfunc
    nodes : (K,) array
        Where on the step the stages lie.
    used : list of (i, k)
        Which shared symbol at which node each further runtime parameter is.
    """

    def __init__(
        self,
        flow: AugmentedFlow,
        pair: Pair | None,
        nodes: np.ndarray,
        shared: Sequence[sympy.Symbol],
    ) -> None:
        import heyoka as hy

        self.nodes = nodes
        places = [(i, k) for i in range(len(shared)) for k in range(len(nodes))]
        inputs, outputs = _map_formulas(flow, pair, nodes, shared, places)
        present = {int(re.sub(r"\D", "", str(name))) for name in hy.get_params(outputs)}
        self.used = [place for i, place in enumerate(places) if STEP_ROWS + i in present]
        inputs, outputs = _map_formulas(flow, pair, nodes, shared, self.used)
        self.function = hy.cfunc(outputs, inputs, batch_size=LANES, force_avx512=True)


def _map_formulas(
    flow: AugmentedFlow,
    pair: Pair | None,
    nodes: np.ndarray,
    shared: Sequence[sympy.Symbol],
    used: Sequence[tuple[int, int]],
) -> tuple[list[Any], list[Any]]:
    """Input and output rows of a map; `used` says which runtime parameters it may refer to."""
    import heyoka as hy

    unused = hy.expression(0.0)
    position = {place: hy.par[STEP_ROWS + i] for i, place in enumerate(used)}
    names = [
        *flow.states,
        *flow.parameters,
        *(f"kept_integral_{i}" for i in range(len(flow.integrands))),
        *(f"kept_slope_{i}" for i in range(len(flow.rates))),
        *(begin for begin, _ in flow.sides),
        *(symbol for symbol, _ in flow.memories),
    ]
    inputs = [hy.expression(str(name)) for name in names]
    known: dict[sympy.Symbol, Any] = dict(zip(names, inputs, strict=True))
    x, rows = inputs[: len(flow.states)], flow.rows
    integrals, slopes = inputs[rows["integrals"]], inputs[rows["slopes"]]
    begin, h, tolerance = hy.par[0], hy.par[1], hy.par[2]
    known |= {STEP_BEGIN: begin, STEP_LENGTH: h}

    def at(node: float, states: Sequence[Any]) -> dict[sympy.Symbol, Any]:
        """What formulas refer to at a node of the step."""
        column = int(np.searchsorted(nodes, node))
        times = {s: position.get((i, column), unused) for i, s in enumerate(shared)}
        return known | dict(zip(flow.states, states, strict=True)) | times

    def rates(node: float, states: Sequence[Any]) -> list[Any]:
        return to_heyoka([*flow.rates, *flow.integrands], at(node, states), kinks=True)

    size = len(flow.rates)
    if pair is None:
        ends, error = x, hy.expression(0.0)
        totals = integrals
        last = rates(0.0, x)[:size]
    else:
        first = [*slopes, *rates(0.0, x)[size:]]  # the slopes are those at the last step's end
        stages, ends = heyoka_step(pair, h, x, first, rates)
        totals = [
            v + heyoka_sum(h, pair.B, [k[size + i] for k in stages[:-1]])
            for i, v in enumerate(integrals)
        ]
        last = list(stages[-1][:size])
        error = _estimate(hy, pair, h, x, ends, stages, tolerance)
    end_node = 0.0 if pair is None else 1.0
    place = at(end_node, ends) | dict(zip(flow.slopes, last, strict=True))
    signals = to_heyoka(flow.signals, place, kinks=True)
    place |= {end: value for (_, end), value in zip(flow.sides, signals, strict=True)}
    memories = to_heyoka([formula for _, formula in flow.memories], place, kinks=True)
    outputs = [*ends, *inputs[rows["parameters"]], *totals, *last, *signals, *memories, error]
    return inputs, outputs


def _estimate(
    hy: Any,
    pair: Pair,
    h: Any,
    x: Sequence[Any],
    ends: Sequence[Any],
    slopes: Sequence[Sequence[Any]],
    tolerance: Any,
) -> Any:
    """Root mean square of the estimated errors over tolerance (1 + |x|); a step passes at 1."""

    def magnitude(value: Any) -> Any:
        return hy.select(hy.gte(value, 0.0), value, -value)

    scales = []
    for begin, end in zip(x, ends, strict=True):
        a, b = magnitude(begin), magnitude(end)
        scales.append(1.0 / (tolerance + tolerance * hy.select(hy.gt(a, b), a, b)))

    def squares(weights: np.ndarray) -> Any:
        errors = [heyoka_sum(h, weights, [k[i] for k in slopes]) for i in range(len(x))]
        scaled = [error * scale for error, scale in zip(errors, scales, strict=True)]
        return hy.sum([value * value for value in scaled]) * (1.0 / len(scaled))

    if len(pair.errors) == 1:
        return hy.sqrt(squares(pair.errors[0]))
    fifth, third = map(squares, pair.errors)
    return fifth / hy.sqrt(fifth + THIRD_ORDER_WEIGHT * third + 1e-300)  # not 0/0
