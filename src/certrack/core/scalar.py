"""Formulas as Python functions of single numbers: for one member, ten times as fast as NumPy.

They give what the NumPy functions of :mod:`certrack.core.lowering` give, to rounding, or nothing:
where a value is not finite, a function leaves its domain or a root would be complex, they raise
:class:`NotOrdinary`, and the caller asks NumPy, which knows inf and NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import sympy

from certrack.core.errors import CertrackError
from certrack.core.select import by_selections

#: What Python's arithmetic raises where NumPy gives inf or NaN; NameError: a function of NumPy's.
ARITHMETIC_ERRORS = (ArithmeticError, ValueError, TypeError, NameError)


class NotOrdinary(CertrackError):
    """A value is not an ordinary finite number."""


class ScalarFunction:
    """Formulas as one function of numbers, which returns the list of their values.

    Parameters
    ----------
    arguments : sequence
        Symbols, or nested sequences of them.
    formulas : sequence of sympy.Expr
    """

    def __init__(self, arguments: Sequence[Any], formulas: Sequence[sympy.Expr]) -> None:
        modules = [{"Select": _select, "real_power": math.pow}, "math"]
        real = [_with_real_powers(by_selections(formula)) for formula in formulas]
        self._function: Callable[..., list[float]] = sympy.lambdify(
            list(arguments), real, modules, cse=True, dummify=True
        )

    def __call__(self, *values: Any) -> list[float]:
        """The values of all formulas.

        Raises
        ------
        NotOrdinary
            If one of them is not a finite number.
        """
        try:
            results = list(map(float, self._function(*values)))
        except ARITHMETIC_ERRORS:
            raise NotOrdinary("not a finite number") from None
        if not math.isfinite(sum(results)):
            raise NotOrdinary("not a finite number")
        return results


def _select(a: float, b: float, yes: float, no: float) -> float:
    return yes if a > b else no


#: A power that refuses a negative base, where Python's operator would give a complex number.
_REAL_POWER = sympy.Function("real_power")


def _with_real_powers(formula: sympy.Expr) -> sympy.Expr:
    return formula.replace(_has_fractional_exponent, lambda power: _REAL_POWER(*power.args))


def _has_fractional_exponent(expr: sympy.Basic) -> bool:
    return isinstance(expr, sympy.Pow) and not expr.exp.is_Integer
