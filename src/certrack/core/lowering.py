"""SymPy to machine: NumPy callables and heyoka expressions.

heyoka's Taylor method needs smooth right-hand sides. Every abs, sign, min and max is therefore
written by a *switch* s = sign(f), a runtime parameter held constant while f keeps its sign:
|f| = s f, max(a, b) = (a + b + s (a - b))/2. The integrator locates f = 0 as an event, flips s and
goes on, so no step ever crosses a kink.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import TIME, derivative, without_minmax

#: Begin of a step or of a part of it, and its length: in formulas of what is kept of a run.
BEGIN, STEP = sympy.symbols("kept_begin kept_step", real=True)


class Select(sympy.Function):
    """select(a, b, yes, no) is `yes` where a > b, else `no`.

    For compiled maps only: SymPy neither simplifies nor evaluates it, as it would a Piecewise.
    """

    nargs = 4
    is_real = True


class Extremum(sympy.Function):
    """Extremum on [0, 1] of the cubic with p = e, p' = d at both ends; p(0) if there is none.

    Extremum(e0, e1, d0, d1) looks between slopes of different signs: where p' would vanish if it
    changed evenly, then one correction with that even change as the slope of p'. Near an extremum
    the value hardly depends on the place.
    """

    nargs = 4
    is_real = True

    def selections(self) -> sympy.Expr:
        """By :class:`Select` alone."""
        e0, e1, d0, d1 = self.args
        b, a = _cubic(e0, e1, d0, d1)
        per_change = 1 / _nonzero(d0 - d1)
        even = d0 * per_change
        s = _within(even + (d0 + even * (2 * b + 3 * even * a)) * per_change)
        return Select(0, d0 * d1, e0 + s * (d0 + s * (b + s * a)), e0)


class Entry(sympy.Function):
    """Where |p| enters a band for good on [0, 1]: by the chord, with one correction along it.

    Entry(e0, e1, d0, d1, band) of the same cubic; 1 if neither end is outside.
    """

    nargs = 5
    is_real = True

    def selections(self) -> sympy.Expr:
        """By :class:`Select` alone."""
        e0, e1, d0, d1, band = self.args
        b, a = _cubic(e0, e1, d0, d1)
        level, per_rise = Select(e0, 0, band, -band), 1 / _nonzero(e1 - e0)
        s = _within((level - e0) * per_rise)
        better = _within(s - (e0 + s * (d0 + s * (b + s * a)) - level) * per_rise)
        return Select(larger(magnitude(e0), magnitude(e1)), band, better, 1)


def _cubic(
    e0: sympy.Expr, e1: sympy.Expr, d0: sympy.Expr, d1: sympy.Expr
) -> tuple[sympy.Expr, sympy.Expr]:
    """Coefficients of s^2 and s^3."""
    rise = e1 - e0
    return 3 * rise - 2 * d0 - d1, d0 + d1 - 2 * rise


def _within(s: sympy.Expr) -> sympy.Expr:
    return Select(s, 0, Select(1, s, s, 1), 0)


def _nonzero(value: sympy.Expr) -> sympy.Expr:
    """The value as a denominator whose quotient is not used where it vanishes."""
    return Select(magnitude(value), 0, value, 1)


def magnitude(value: sympy.Expr) -> sympy.Expr:
    """|value| for compiled maps."""
    return Select(value, 0, value, -value)


def larger(a: sympy.Expr, b: sympy.Expr) -> sympy.Expr:
    """max(a, b) for compiled maps."""
    return Select(a, b, a, b)


def smaller(a: sympy.Expr, b: sympy.Expr) -> sympy.Expr:
    """min(a, b) for compiled maps."""
    return Select(b, a, a, b)


def numpy_callable(
    arguments: Sequence[Any], formulas: Sequence[sympy.Expr]
) -> Callable[..., list[Any]]:
    """Vectorised NumPy function of the given (nested) arguments that returns all formulas."""
    plain = [formula.replace(_is_cubic, lambda f: f.selections()) for formula in formulas]
    modules = [{"Select": _select}, "numpy"]
    found: Callable[..., list[Any]] = sympy.lambdify(arguments, plain, modules, cse=True)
    return found


def _is_cubic(expr: sympy.Basic) -> bool:
    return isinstance(expr, (Extremum, Entry))


def _select(a: Any, b: Any, yes: Any, no: Any) -> Any:
    return np.where(np.greater(a, b), yes, no)


def jacobian(formulas: Sequence[sympy.Expr], by: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Partial derivatives, row-major; kinks give one-sided slopes."""
    return [derivative(formula, symbol) for formula in formulas for symbol in by]


def extract_switches(
    formulas: Sequence[sympy.Expr],
) -> tuple[list[sympy.Expr], list[tuple[sympy.Symbol, sympy.Expr]]]:
    """Replace abs and sign (and so min and max) by switches.

    Returns
    -------
    formulas : list
        The formulas with |f| = s f and sign(f) = s; smooth while every s is constant.
    switches : list of (s, f)
        Switch symbols and what they are the sign of; later f may contain earlier s.
    """
    switches: dict[sympy.Expr, sympy.Symbol] = {}

    def switch(inside: sympy.Expr) -> sympy.Symbol:
        if inside not in switches:
            switches[inside] = sympy.Symbol(f"switch_{len(switches)}", real=True)
        return switches[inside]

    def smooth(expr: sympy.Expr) -> sympy.Expr:
        if not expr.has(sympy.Abs, sympy.sign):
            return expr
        args = [smooth(arg) for arg in expr.args]
        if isinstance(expr, sympy.Abs):
            return switch(args[0]) * args[0]
        if isinstance(expr, sympy.sign):
            return switch(args[0])
        return expr.func(*args)

    found = [smooth(without_minmax(formula)) for formula in formulas]
    return found, [(symbol, inside) for inside, symbol in switches.items()]


def to_heyoka(
    formulas: Sequence[sympy.Expr], known: Mapping[sympy.Symbol, Any], *, kinks: bool = False
) -> list[Any]:
    """heyoka expressions of formulas.

    Parameters
    ----------
    formulas : sequence of sympy.Expr
        Without abs, sign, min and max (see :func:`extract_switches`) unless `kinks`.
    known : mapping
        heyoka expression of every symbol except time.
    kinks : bool
        Lower kinks to selections: for maps that are evaluated, not for Taylor series.
    """
    import heyoka as hy

    functions = {
        getattr(sympy, name): getattr(hy, name)
        for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp")
    } | {sympy.log: hy.log, sympy.atan2: hy.atan2}
    done: dict[sympy.Basic, Any] = {TIME: hy.time, **known}

    def build(expr: sympy.Basic) -> Any:
        if expr not in done:
            done[expr] = lower(expr)
        return done[expr]

    def lower(expr: sympy.Basic) -> Any:
        if expr.is_number and not expr.free_symbols:
            return hy.expression(float(expr))
        if isinstance(expr, sympy.Add):
            return hy.sum([build(arg) for arg in expr.args])
        if isinstance(expr, sympy.Mul):
            return hy.prod([build(arg) for arg in expr.args])
        if isinstance(expr, sympy.Pow):
            base, exponent = expr.args
            if exponent.is_Integer:  # heyoka's general power has no Taylor series at zero
                power = _integer_power(hy, build(base), abs(int(exponent)))
                return power if exponent > 0 else 1.0 / power
            if exponent.is_Rational and exponent.q == 2:
                root = _integer_power(hy, hy.sqrt(build(base)), abs(int(exponent.p)))
                return root if exponent > 0 else 1.0 / root
            return build(base) ** float(exponent)
        if kinks and isinstance(expr, (Extremum, Entry)):
            return build(expr.selections())
        if kinks and type(expr) in SELECTIONS:
            return SELECTIONS[type(expr)](hy, *(build(arg) for arg in expr.args))
        if type(expr) in functions:
            return functions[type(expr)](*(build(arg) for arg in expr.args))
        raise TypeError(f"no heyoka form of {type(expr).__name__}")

    return [build(formula) for formula in formulas]


def _extreme(hy: Any, first: Any, *rest: Any, largest: bool) -> Any:
    for other in rest:
        above = hy.gt(first, other)
        first = hy.select(above, first, other) if largest else hy.select(above, other, first)
    return first


#: Kinked functions by selection.
SELECTIONS: dict[Any, Callable[..., Any]] = {
    sympy.Abs: lambda hy, a: hy.select(hy.gte(a, 0.0), a, -a),
    sympy.sign: lambda hy, a: hy.select(hy.gt(a, 0.0), 1.0, hy.select(hy.lt(a, 0.0), -1.0, 0.0)),
    sympy.Max: lambda hy, *args: _extreme(hy, *args, largest=True),
    sympy.Min: lambda hy, *args: _extreme(hy, *args, largest=False),
    Select: lambda hy, a, b, yes, no: hy.select(hy.gt(a, b), yes, no),
}


def _integer_power(hy: Any, base: Any, exponent: int) -> Any:
    """Product of `exponent` equal factors by repeated squaring."""
    if exponent == 1:
        return base
    half = _integer_power(hy, base, exponent // 2)
    square = half**2.0  # a special case that heyoka does well
    return square * base if exponent % 2 else square


def hoisted(
    formulas: Sequence[sympy.Expr], common: Set[sympy.Symbol]
) -> tuple[list[sympy.Expr], dict[sympy.Expr, sympy.Symbol]]:
    """Replace every largest subexpression of common symbols alone by one symbol.

    Returns
    -------
    formulas : list
    found : dict
        Symbol of each subexpression, in the order of their numbers.
    """
    found: dict[sympy.Expr, sympy.Symbol] = {}

    def name(expr: sympy.Expr) -> sympy.Expr:
        number, rest = expr.as_coeff_Mul()
        if rest not in found:
            found[rest] = sympy.Symbol(f"kept_shared_{len(found)}", real=True)
        return number * found[rest]

    def walk(expr: sympy.Expr) -> sympy.Expr:
        free = expr.free_symbols
        if not free & common:
            return expr
        if free <= common:
            return name(expr)
        if expr.is_Add or expr.is_Mul:
            own = [arg for arg in expr.args if arg.free_symbols and arg.free_symbols <= common]
            rest = [walk(arg) for arg in expr.args if arg not in own]
            return expr.func(*rest, *([name(expr.func(*own))] if own else []))
        return expr.func(*map(walk, expr.args))

    return list(map(walk, formulas)), found


def rows(values: Sequence[Any], count: int) -> np.ndarray:
    """Results of a NumPy callable as an array (len(values), count); constants are spread out."""
    found = np.empty((len(values), count))
    for row, value in zip(found, values, strict=True):
        row[...] = value
    return found
