"""Nonlinear terms within a sector: m(x) = s x_j, where s stays in an interval along every motion.

s is no constant: it is m(x(t))/x_j(t), and so varies in time even where the constants stand still.
It joins the box of the constants as a number that no cell may cut: a loop that is stable for every
constant s may be unstable for one that varies.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import sympy
from mpmath import iv, mp

from certrack.certificates.arithmetic import rational
from certrack.certificates.intervals import enclosure

#: sin(z)/z is nowhere below this: its least value is -0.21723362821...
LEAST_SINC = Fraction(-2173, 10000)

#: f(z)/z of functions with f(0) = 0.
SECTORS = {
    sympy.sin: (LEAST_SINC, Fraction(1)),
    sympy.tanh: (Fraction(0), Fraction(1)),
    sympy.atan: (Fraction(0), Fraction(1)),
}


def sector_of(function: sympy.Expr, states: Sequence[sympy.Symbol]) -> tuple[int, Any, Any] | None:
    """The state j and the interval of m(x)/x_j over all x, in rationals; None if none is known.

    m is x_j, |x_j| or f(a x_j) times something bounded; the first such state counts.
    """
    for j, state in enumerate(states):
        ratios = []
        for factor in sympy.Mul.make_args(function):
            slope = _slope_along(factor, state)
            other = None if slope is None else _ends(function / factor, states)
            if slope is not None and other is not None:
                products = [u * v for u in slope for v in other]
                ratios.append((min(products), max(products)))
        if ratios:  # each of them contains the ratio
            return j, max(low for low, _ in ratios), min(high for _, high in ratios)
    return None


def _slope_along(factor: sympy.Expr, state: sympy.Symbol) -> tuple[Any, Any] | None:
    """The interval of factor/state over all values of the state; None if none is known."""
    if factor == state:
        return rational(1), rational(1)
    if factor == sympy.Abs(state):
        return rational(-1), rational(1)
    if type(factor) not in SECTORS:
        return None
    scale = factor.args[0] / state
    if not scale.is_Rational:
        return None
    low, high = (rational(end) * rational(scale) for end in SECTORS[type(factor)])
    return min(low, high), max(low, high)


def _ends(remaining: sympy.Expr, states: Sequence[sympy.Symbol]) -> tuple[Any, Any] | None:
    """Rational bounds of a function over all x; None if it may be unbounded."""
    everywhere = {state: iv.mpf(["-inf", "inf"]) for state in states}
    try:
        interval = enclosure(remaining, everywhere)
        ends = mp.mpf(interval.a), mp.mpf(interval.b)
    except (ArithmeticError, ValueError, TypeError):
        return None
    if not all(map(mp.isfinite, ends)):
        return None
    return tuple(rational(Fraction(*float(end).as_integer_ratio())) for end in ends)  # type: ignore[return-value]
