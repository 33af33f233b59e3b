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
    prefix: str = "kept_shared",
) -> tuple[list[sympy.Expr], Hoisted]:
    """Replace every largest subexpression of common symbols alone by one symbol.

    Parameters
    ----------
    formulas : sequence of sympy.Expr
    common : symbols
    known : symbols
        May be part of these subexpressions, too, but stay where they stand without a common one.
    prefix : str
        Of the names of the symbols, which must not be those in the formulas.
    """
    symbols: Hoisted = {}

    def name(expr: sympy.Expr) -> sympy.Expr:
        if expr.free_symbols.isdisjoint(common):
            return expr
        number, factor = expr.as_coeff_Mul()
        if factor not in symbols:
            symbols[factor] = sympy.Symbol(f"{prefix}_{len(symbols)}", real=True)
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
    free_of: dict[sympy.Basic, Set[sympy.Basic]] = {}

    def free_symbols(expr: sympy.Basic) -> Set[sympy.Basic]:
        """As SymPy has them, which collects them anew at every level of a formula."""
        if expr not in free_of:
            parts = map(free_symbols, expr.args)
            free_of[expr] = frozenset({expr} if expr.is_Symbol else ()).union(*parts)
        return free_of[expr]

    def walk(expr: sympy.Expr) -> sympy.Expr:
        free = free_symbols(expr)
        if free.isdisjoint(inside):
            return expr
        if free <= inside:
            return name(expr)
        if expr.is_Add or expr.is_Mul:
            shared = [arg for arg in expr.args if free_symbols(arg) and free_symbols(arg) <= inside]
            if shared and with_coefficients:
                shared += [arg for arg in expr.args if not free_symbols(arg)]
            others = [walk(arg) for arg in expr.args if arg not in shared]
            return expr.func(*others, *([name(expr.func(*shared))] if shared else []))
        return expr.func(*map(walk, expr.args))

    return list(map(walk, formulas))
