"""Formulas in ball arithmetic (Arb): a number, and how far the true one may be from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction
from functools import reduce
from typing import Any

import flint
import sympy

from certrack.certificates.arithmetic import rational
from certrack.core.powers import ConstantPower
from certrack.core.rationals import exact_rational

#: Bits that balls are computed with: entries of A reach 1e150, and e = A x - B Y is their small
#: difference.
BALL_BITS = 1200

#: Radius of a ball around a float, in units of the last place: it holds the number that the float
#: is nearest to, and the float.
FLOAT_UNITS = 1

_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    sympy.Add: lambda *parts: reduce(lambda a, b: a + b, parts),
    sympy.Mul: lambda *parts: reduce(lambda a, b: a * b, parts),
    sympy.Abs: abs,
    sympy.sign: lambda x: x.sgn(),
    sympy.Min: lambda *parts: reduce(lambda a, b: a.min(b), parts),
    sympy.Max: lambda *parts: reduce(lambda a, b: a.max(b), parts),
    sympy.atan2: lambda y, x: flint.arb.atan2(y, x),
    **{
        getattr(sympy, name): lambda x, name=name: getattr(x, name)()
        for name in (
            *("sin", "cos", "tan", "asin", "acos", "atan"),
            *("sinh", "cosh", "tanh", "exp", "log"),
        )
    },
}


@contextmanager
def ball_precision() -> Iterator[None]:
    """Compute with :data:`BALL_BITS`."""
    before = flint.ctx.prec
    flint.ctx.prec = BALL_BITS
    try:
        yield
    finally:
        flint.ctx.prec = before


def ball_of(value: float, units: int = FLOAT_UNITS) -> Any:
    """A ball around what a float stands for that holds the float, too."""
    exact = exact_rational(value)
    middle = flint.arb(flint.fmpq(exact.numerator, exact.denominator))
    return flint.arb(middle, flint.arb(units * math.ulp(float(value))) if value else 0)


def ball_matrix(rows: Iterable[Iterable[Any]]) -> flint.arb_mat:
    """Balls of the precision at hand around a matrix of rationals or balls."""
    return flint.arb_mat([[flint.arb(v) for v in row] for row in rows])


def enclosing_ball(expr: sympy.Expr, values: Mapping[sympy.Symbol, Any]) -> Any:
    """Ball around a formula at the balls of its symbols.

    Raises
    ------
    ValueError
        Where it has no finite value there, or a part has no rule.
    """
    result = _ball(expr, values)
    if not result.is_finite():
        raise ValueError(f"no finite value of {expr}")
    return result


def _ball(expr: sympy.Expr, values: Mapping[sympy.Symbol, Any]) -> Any:
    if expr in values:
        return values[expr]
    operation, parts = ball_rule(expr)
    return operation(*(_ball(part, values) for part in parts))


def ball_rule(expr: sympy.Expr) -> tuple[Callable[..., Any], tuple[sympy.Expr, ...]]:
    """What makes the ball of a formula of the balls of its parts, and these parts.

    Raises
    ------
    ValueError
        Where there is no rule.
    """
    if expr.is_Rational:
        return (lambda: flint.arb(rational(expr))), ()
    if expr == sympy.pi:
        return flint.arb.pi, ()
    if expr == sympy.E:
        return (lambda: flint.arb(1).exp()), ()
    if isinstance(expr, ConstantPower):
        return _power_rule(expr.base, expr.exponent)
    if isinstance(expr, sympy.Pow):
        return _power_rule(expr.base, expr.exp)
    if type(expr) in _FUNCTIONS:
        return _FUNCTIONS[type(expr)], expr.args
    raise ValueError(f"no rule for {type(expr).__name__}")


def _power_rule(
    base: sympy.Expr, exponent: sympy.Expr
) -> tuple[Callable[..., Any], tuple[sympy.Expr, ...]]:
    if exponent.is_Integer:
        return (lambda inside: _integer_power(inside, int(exponent))), (base,)
    if exponent.is_Rational and exponent.q == 2:
        return (lambda inside: inside.sqrt() ** int(exponent.p)), (base,)
    return (lambda inside, power: inside**power), (base, exponent)


def _integer_power(inside: Any, exponent: int) -> Any:
    """A power of a ball, which may hold zero if the exponent is positive."""
    if exponent < 0 or not inside.contains(0):
        return inside**exponent
    size = inside.abs_upper() ** exponent
    return flint.arb(0).union(size if exponent % 2 == 0 else -size).union(size)


def upper_rational(ball: Any) -> Any:
    """Rational that no number of the ball is above."""
    mantissa, exponent = ball.upper().man_exp()
    exact = Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return rational(exact)
