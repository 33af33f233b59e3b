"""Selections: what abs, min, max and the extremes of a cubic become in compiled maps.

A map that is evaluated many times over vectors of members must not branch. Everything here is
therefore written by one operation, :class:`Select`, for which every target has one instruction:
``numpy.where``, ``heyoka.select``, a blend of vector registers in C.

Between the ends of an integration step a signal is followed by the cubic with the signal's values
and slopes at both ends (Hermite). :class:`Extremum` and :class:`Entry` are what is asked of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy

#: Begin and length of an integration step, or of a part of it, in formulas evaluated at its end.
STEP_BEGIN, STEP_LENGTH = sympy.symbols("kept_begin kept_step", real=True)


class Select(sympy.Function):
    """select(a, b, yes, no) is `yes` where a > b, else `no`.

    For compiled maps only: SymPy neither simplifies nor evaluates it, as it would a Piecewise.
    """

    nargs = 4
    is_real = True


class Extremum(sympy.Function):
    """Extremum on [0, 1] of the cubic with p = e, p' = d at both ends; p(0) if there is none.

    Extremum(e0, e1, d0, d1) looks between slopes of different signs: at the zero of the straight
    line through p'(0) and p'(1), after one Newton step that takes that line's slope for p''. Near
    an extremum the value hardly depends on the place.
    """

    nargs = 4
    is_real = True

    def selections(self) -> sympy.Expr:
        """By :class:`Select` alone."""
        e0, e1, d0, d1 = self.args
        b, a = _cubic(e0, e1, d0, d1)
        per_change = 1 / _nonzero(d0 - d1)
        even = d0 * per_change
        s = _clipped(even + (d0 + even * (2 * b + 3 * even * a)) * per_change)
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
        s = _clipped((level - e0) * per_rise)
        better = _clipped(s - (e0 + s * (d0 + s * (b + s * a)) - level) * per_rise)
        return Select(larger(magnitude(e0), magnitude(e1)), band, better, 1)


def _cubic(
    e0: sympy.Expr, e1: sympy.Expr, d0: sympy.Expr, d1: sympy.Expr
) -> tuple[sympy.Expr, sympy.Expr]:
    """Coefficients of s^2 and s^3."""
    rise = e1 - e0
    return 3 * rise - 2 * d0 - d1, d0 + d1 - 2 * rise


def _clipped(s: sympy.Expr) -> sympy.Expr:
    return Select(s, 0, Select(1, s, s, 1), 0)


def _nonzero(value: sympy.Expr) -> sympy.Expr:
    """The value, or 1 where it is zero: the quotient by it is not used there."""
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


def clamp(value: sympy.Expr, low: sympy.Expr, high: sympy.Expr) -> sympy.Expr:
    """The value within [low, high] for compiled maps; NaN stays NaN."""
    return Select(low, value, low, Select(value, high, high, value))


def by_selections(formula: sympy.Expr) -> sympy.Expr:
    """The formula with every :class:`Extremum` and :class:`Entry` written by :class:`Select`."""
    return formula.replace(_of_cubic, lambda function: function.selections())


def _of_cubic(expr: sympy.Basic) -> bool:
    return isinstance(expr, (Extremum, Entry))


def numpy_select(a: Any, b: Any, yes: Any, no: Any) -> Any:
    """:class:`Select` of NumPy arrays, which are broadcast together."""
    return np.where(np.greater(a, b), yes, no)
