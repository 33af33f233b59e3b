"""SymPy to machine: NumPy callables and heyoka expressions.

heyoka's Taylor method needs smooth right-hand sides. Every abs, sign, min and max is therefore
written by a *switch* s = sign(f), a runtime parameter held constant while f keeps its sign:
|f| = s f, max(a, b) = (a + b + s (a - b))/2. The integrator locates f = 0 as an event, flips s and
goes on, so no step ever crosses a kink.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from sympy.printing.numpy import NumPyPrinter

from certrack.core.expressions import TIME
from certrack.core.kinks import derivative, without_minmax
from certrack.core.select import Entry, Extremum, Select, by_selections, numpy_select

#: How formulas are printed as a NumPy function.
PRINTER_SETTINGS = {
    "fully_qualified_modules": False,
    "inline": True,
    "allow_unknown_functions": True,
    "user_functions": {"Select": "Select"},
}


class NumpyFunction:
    """Formulas as one vectorised NumPy function, which returns the values of all of them.

    A copy, a pickle and another process get the formulas and write the code anew when it is first
    called, since generated code cannot be pickled.

    Parameters
    ----------
    arguments : sequence
        Symbols, or nested sequences of them.
    formulas : sequence of sympy.Expr
    """

    __slots__ = ("_arguments", "_formulas", "_function")

    def __init__(self, arguments: Sequence[Any], formulas: Sequence[sympy.Expr]) -> None:
        self._arguments, self._formulas = tuple(arguments), tuple(formulas)
        self._function: Callable[..., list[Any]] | None = None

    def __call__(self, *values: Any) -> list[Any]:
        function = self._function
        if function is None:  # two threads may both write it: the same code
            names = safe_names(self._arguments)
            printer = RenamingPrinter(names)  # takes from NumPy what it prints, not all
            arguments = [in_shape(argument, names) for argument in self._arguments]
            formulas = list(map(by_selections, self._formulas))
            known = {"Select": numpy_select}
            function = sympy.lambdify(arguments, formulas, known, printer, cse=True)
            self._function = function
        return function(*values)

    def __reduce__(self) -> tuple[Any, ...]:
        return NumpyFunction, (self._arguments, self._formulas)


class RenamingPrinter(NumPyPrinter):
    """NumPy code in which symbols have other names.

    To put other symbols into the formulas instead would have SymPy compare the arguments of every
    max and min anew, which takes seconds where they are long.
    """

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__(PRINTER_SETTINGS)
        self._names = names

    def _print_Symbol(self, symbol: sympy.Symbol) -> str:
        return self._names.get(symbol) or super()._print_Symbol(symbol)


def safe_names(arguments: Sequence[Any]) -> dict[sympy.Symbol, str]:
    """Names of ours for the arguments of generated code, in the same order.

    A name of a user's may be that of a function (``arctan``) or of a common part (``x0``) there.
    """
    symbols = sorted(sympy.flatten(arguments), key=str)
    return {symbol: f"argument_{i:05}" for i, symbol in enumerate(symbols)}


def in_shape(argument: Any, names: Mapping[sympy.Symbol, Any]) -> Any:
    """What each symbol of a (nested) argument stands for, nested likewise."""
    if isinstance(argument, sympy.Symbol):
        return names[argument]
    return [in_shape(entry, names) for entry in argument]


def renamed(
    arguments: Sequence[Any], formulas: Iterable[sympy.Expr]
) -> tuple[list[Any], list[sympy.Expr]]:
    """Arguments and formulas with those names."""
    names = safe_names(arguments).items()
    ours = {symbol: sympy.Symbol(name, real=True) for symbol, name in names}
    return (
        [in_shape(argument, ours) for argument in arguments],
        [formula.xreplace(ours) for formula in formulas],
    )


def numpy_callable(arguments: Sequence[Any], formulas: Sequence[sympy.Expr]) -> NumpyFunction:
    """Vectorised NumPy function of the given (nested) arguments that returns all formulas."""
    return NumpyFunction(arguments, formulas)


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

    smoothed = [smooth(without_minmax(formula)) for formula in formulas]
    return smoothed, [(symbol, inside) for inside, symbol in switches.items()]


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
    lowered: dict[sympy.Basic, Any] = {TIME: hy.time, **known}

    def build(expr: sympy.Basic) -> Any:
        if expr not in lowered:
            lowered[expr] = lower(expr)
        return lowered[expr]

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


def _extreme(hy: Any, extreme: Any, *others: Any, largest: bool) -> Any:
    for other in others:
        above = hy.gt(extreme, other)
        extreme = hy.select(above, extreme, other) if largest else hy.select(above, other, extreme)
    return extreme


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


def rows(values: Sequence[Any], count: int) -> np.ndarray:
    """Results of a NumPy callable as an array (len(values), count); constants are spread out."""
    table = np.empty((len(values), count))
    for row, value in zip(table, values, strict=True):
        row[...] = value
    return table
