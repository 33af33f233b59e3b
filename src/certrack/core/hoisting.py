"""Take out of formulas what depends on some symbols alone, to compute it once for many uses."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set

import sympy

#: Symbol of each subexpression that was taken out, in the order of their numbers.
Hoisted = dict[sympy.Expr, sympy.Symbol]


def hoisted(
    formulas: Sequence[sympy.Expr],
    common: Set[sympy.Symbol],
    known: Set[sympy.Symbol] = frozenset(),
) -> tuple[list[sympy.Expr], Hoisted]:
    """Replace every largest subexpression of common symbols alone by one symbol.

    Parameters
    ----------
    formulas : sequence of sympy.Expr
    common : symbols
    known : symbols
        May be part of these subexpressions, too, but stay where they stand without a common one.
    """
    symbols: Hoisted = {}

    def name(expr: sympy.Expr) -> sympy.Expr:
        if not expr.free_symbols & common:
            return expr
        number, factor = expr.as_coeff_Mul()
        if factor not in symbols:
            symbols[factor] = sympy.Symbol(f"kept_shared_{len(symbols)}", real=True)
        return number * symbols[factor]

    return _replaced(formulas, common | known, name), symbols


def hoisted_numbers(
    formulas: Sequence[sympy.Expr], numbers: Set[sympy.Symbol]
) -> tuple[list[sympy.Expr], Hoisted]:
    """Replace every largest subexpression of symbols that stand for numbers by one symbol.

    Coefficients go into it, too; only a sign stays outside.
    """
    symbols: Hoisted = {}

    def name(expr: sympy.Expr) -> sympy.Expr:
        sign = -1 if expr.as_coeff_Mul()[0] < 0 else 1
        if sign * expr not in symbols:
            symbols[sign * expr] = sympy.Symbol(f"kept_number_{len(symbols)}", real=True)
        return sign * symbols[sign * expr]

    return _replaced(formulas, numbers, name, with_coefficients=True), symbols


def _replaced(
    formulas: Sequence[sympy.Expr],
    inside: Set[sympy.Symbol],
    name: Callable[[sympy.Expr], sympy.Expr],
    *,
    with_coefficients: bool = False,
) -> list[sympy.Expr]:
    """The formulas with names for the largest subexpressions of the symbols inside."""

    def walk(expr: sympy.Expr) -> sympy.Expr:
        free = expr.free_symbols
        if not free & inside:
            return expr
        if free <= inside:
            return name(expr)
        if expr.is_Add or expr.is_Mul:
            shared = [arg for arg in expr.args if arg.free_symbols and arg.free_symbols <= inside]
            if shared and with_coefficients:
                shared += [arg for arg in expr.args if not arg.free_symbols]
            others = [walk(arg) for arg in expr.args if arg not in shared]
            return expr.func(*others, *([name(expr.func(*shared))] if shared else []))
        return expr.func(*map(walk, expr.args))

    return list(map(walk, formulas))
