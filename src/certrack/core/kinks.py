"""Derivatives of formulas with kinks, and kinks by each other: min and max of two, or by abs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from functools import reduce

import sympy

from certrack.core.expressions import TIME
from certrack.core.powers import without_fine_roots

_OfTwo = Callable[[sympy.Expr, sympy.Expr], sympy.Expr]

#: Functions that may jump where all their arguments are finite.
JUMPING = (sympy.sign, sympy.atan2)

#: What has a kink or a jump.
_KINKED = (sympy.Abs, sympy.sign, sympy.Max, sympy.Min)


def derivative(expr: sympy.Expr, by: sympy.Symbol) -> sympy.Expr:
    """Classical derivative where it exists; kinks (abs, min, max) give their one-sided slopes.

    Every outermost kink is a variable of its own (the chain rule), so that a polynomial of
    min(max(t, 0), 1) stays one.
    """
    kinks: dict[sympy.Expr, sympy.Symbol] = {}

    def freeze(part: sympy.Expr) -> sympy.Expr:
        if by not in part.free_symbols:
            return part
        if isinstance(part, _KINKED):
            return kinks.setdefault(part, sympy.Dummy("kink", real=True))
        return part.func(*map(freeze, part.args)) if part.args else part

    frozen = freeze(expr) if expr.has(*_KINKED) else expr
    slope = sympy.diff(frozen, by)
    for kink, name in kinks.items():
        slope += sympy.diff(frozen, name) * _slope_of_kink(kink, by)
    return without_fine_roots(slope.xreplace({name: kink for kink, name in kinks.items()}))


def along(formula: sympy.Expr, rates: Mapping[sympy.Symbol, sympy.Expr]) -> sympy.Expr:
    """Time derivative of a formula of states and time, by the chain rule.

    Parameters
    ----------
    formula : formula
    rates : mapping
        Rate of each state.
    """
    rate_of = {**rates, TIME: sympy.S.One}
    present = [name for name in rate_of if name in formula.free_symbols]
    return sympy.Add(*(derivative(formula, name) * rate_of[name] for name in present))


def _slope_of_kink(kink: sympy.Expr, by: sympy.Symbol) -> sympy.Expr:
    if isinstance(kink, sympy.sign):
        return sympy.S.Zero
    if isinstance(kink, sympy.Abs):  # SymPy's own rule needs its argument to be provably real
        return sympy.sign(kink.args[0]) * derivative(kink.args[0], by)
    upper = 1 if isinstance(kink, sympy.Max) else -1
    first, *others = kink.args
    value, slope = first, derivative(first, by)
    for other in others:
        of_other, side = derivative(other, by), sympy.sign(value - other)
        # two products: a difference would lose the smaller slope beside one that is 1e16 of it
        slope = (1 + upper * side) / 2 * slope + (1 - upper * side) / 2 * of_other
        value = kink.func(value, other, evaluate=False)
    return slope


def fold_minmax(expr: sympy.Expr, larger: _OfTwo, smaller: _OfTwo) -> sympy.Expr:
    """Write max and min of any number of arguments by functions of two, from left to right."""

    def fold(of_two: _OfTwo) -> Callable[..., sympy.Expr]:
        return lambda *args: reduce(of_two, args)

    return expr.replace(sympy.Max, fold(larger)).replace(sympy.Min, fold(smaller))


def without_minmax(expr: sympy.Expr) -> sympy.Expr:
    """Write min and max by abs: max(a, b) = (a + b + |a - b|)/2."""
    return fold_minmax(
        expr,
        lambda a, b: (a + b + sympy.Abs(a - b)) / 2,
        lambda a, b: (a + b - sympy.Abs(a - b)) / 2,
    )


def kink_arguments(
    formulas: Iterable[sympy.Expr], names: Collection[sympy.Symbol]
) -> list[sympy.Expr]:
    """What abs and sign are taken of, where it contains one of the names.

    Parameters
    ----------
    formulas : iterable of formulas
        Their min and max count as what :func:`without_minmax` writes.
    names : collection of symbols
    """
    kinks = set().union(*(without_minmax(f).atoms(sympy.Abs, sympy.sign) for f in formulas))
    arguments = {kink.args[0] for kink in kinks if kink.free_symbols.intersection(names)}
    return sorted(arguments, key=sympy.default_sort_key)


def smoothed(
    formula: sympy.Expr,
    widths: Mapping[sympy.Expr, float],
    kinds: tuple[type[sympy.Function], ...] = (sympy.Abs, sympy.sign),
) -> sympy.Expr:
    """The formula with sqrt(a^2 + eps^2) for \\|a\\|, and a/sqrt(a^2 + eps^2) for sign(a).

    Parameters
    ----------
    formula : formula
        Its min and max are written by abs.
    widths : mapping
        eps of each argument a; kinks of other arguments stay.
    kinds : tuple
        Which kinks count.
    """

    def smooth(part: sympy.Expr) -> sympy.Expr:
        if not part.args:
            return part
        args = [smooth(arg) for arg in part.args]
        if not isinstance(part, kinds) or part.args[0] not in widths:
            return part.func(*args)
        root = sympy.sqrt(args[0] ** 2 + sympy.Float(widths[part.args[0]]) ** 2)
        return root if isinstance(part, sympy.Abs) else args[0] / root

    return smooth(without_minmax(formula))
