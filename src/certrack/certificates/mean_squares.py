"""How large the reference is in the mean, over a run, from above."""

from __future__ import annotations

from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.balls import ball_of, enclosing_ball, upper_rational
from certrack.core.expressions import TIME
from certrack.references.base import bound_of
from certrack.systems.system import System

#: Parts of the run in each of which the largest square counts.
RUN_PARTS = 400

#: Bits of the balls: they are as wide as a part of the run.
PART_BITS = 64


def mean_squares(system: System, order: int, duration: float) -> np.ndarray:
    """Rationals not below the mean of (y_d^(i)/Y_i)^2 over a run, i = 0 ... order.

    Where the reference has no formula for all times, 1: |y_d^(i)| <= Y_i.
    """
    reference = system.reference
    one = rational(1)
    plain = not reference.piece_symbols
    before, flint.ctx.prec = flint.ctx.prec, PART_BITS
    try:
        values: dict[Any, Any] = {
            name: ball_of(v)
            for name, v in zip(reference.parameter_symbols, reference.parameter_values, strict=True)
        }
        shares = []
        for i, formula in enumerate(reference.formulas(order) if plain else ()):
            bound = exact_float(bound_of(reference, i)[0], rational)
            shares.append(min(one, _mean(formula, values, duration) / bound**2) if bound else one)
        return np.array(shares or [one] * (order + 1), dtype=object)
    except ValueError:
        return np.array([one] * (order + 1), dtype=object)
    finally:
        flint.ctx.prec = before


def _mean(formula: Any, values: dict[Any, Any], duration: float) -> Any:
    """Of the squares, from above."""
    half = flint.arb(rational(duration)) / (2 * RUN_PARTS)
    total = rational(0)
    for part in range(RUN_PARTS):
        middle = half * (2 * part + 1)
        square = enclosing_ball(formula, values | {TIME: flint.arb(middle, half)}) ** 2
        total += upper_rational(square)
    return total / RUN_PARTS
