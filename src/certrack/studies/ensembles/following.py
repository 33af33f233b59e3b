"""Parameters of the true plant that follow from constants, where these vary between members."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import sympy

from certrack.core.expressions import parse, symbol
from certrack.core.lowering import numpy_callable
from certrack.core.powers import put_in
from certrack.loops.continuous import ClosedLoop
from certrack.loops.plant import true_constants
from certrack.systems.system import System


def following_parameters(
    system: System, loop: ClosedLoop, varying: Collection[str]
) -> tuple[list[str], Callable[..., list[Any]], dict[str, float]]:
    """Parameters that follow from varying constants, their formulas, and all constants.

    Parameters
    ----------
    system : System
    loop : ClosedLoop
        Its closed loop, whose parameters they are.
    varying : names of constants
    """
    plant, truth, values = system.plant, system.truth, true_constants(system)
    texts: dict[str, str] = {}
    if truth.input_gain is not None:
        texts |= {f"true_g_{i}": entry.text for i, entry in enumerate(plant.chain)}
        for k, (i, j) in enumerate(loop.plant.couplings):
            assert plant.linear is not None
            texts[f"true_b_{k}"] = plant.linear[i][j].text
        texts[f"true_g_{plant.n - 1}"] = truth.input_gain.text
        texts |= {f"true_theta_{i}": entry.text for i, entry in enumerate(truth.theta)}
    derived: dict[sympy.Symbol, sympy.Expr] = {}  # constants that are formulas of others
    for i, (name, entry) in enumerate(plant.constants):
        if name not in {*varying, *dict(truth.constants)}:
            derived[symbol(name)] = put_in(parse(name, entry.text, list(values)).expr, derived)
            texts[f"true_constants_{i}"] = name
    formulas = {
        name: put_in(parse(name, text, list(values)).expr, derived) for name, text in texts.items()
    }
    free = {symbol(name) for name in varying}
    moving = {name: f for name, f in formulas.items() if f.free_symbols & free}
    evaluate = numpy_callable([symbol(name) for name in values], list(moving.values()))
    return list(moving), evaluate, values
