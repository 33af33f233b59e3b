"""h + phi^T theta of a plant as slopes and a constant, where it is linear in the states."""

from __future__ import annotations

from collections.abc import Sequence

import sympy

from certrack.core.expressions import Expression
from certrack.core.powers import put_in
from certrack.model.plant import Plant


def total_drift(plant: Plant, theta: Sequence[Expression]) -> sympy.Expr:
    """h + phi^T theta with the numbers of the constants."""
    total = plant.drift.expr
    for phi, value in zip(plant.regressor, theta, strict=True):
        total += phi.expr * value.expr
    constants = plant.constant_values
    named = {s: constants[s.name] for s in total.free_symbols if s.name in constants}
    return sympy.expand(put_in(total, named))


def linear_parts(plant: Plant, total: sympy.Expr) -> tuple[list[sympy.Expr], sympy.Expr] | None:
    """Slopes and constant of :func:`total_drift`; None where it is not linear."""
    if not total.is_polynomial(*plant.symbols):
        return None  # atan(tan(x)) has the slope 1 wherever it has one, and is not linear
    slopes = [_simple(sympy.diff(total, x)) for x in plant.symbols]
    if any(slope.free_symbols for slope in slopes):
        return None
    constant = total.xreplace(dict.fromkeys(plant.symbols, sympy.S.Zero))
    return slopes, _simple(constant)


def _simple(formula: sympy.Expr) -> sympy.Expr:
    """As `sympy.simplify` has it; a number as it stands needs not load what that looks for."""
    return formula if formula.is_Number else sympy.simplify(formula)
