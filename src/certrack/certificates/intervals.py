"""The interval of a formula over a box of its symbols, rounded outward, by mpmath's intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import sympy
from mpmath import iv, mp

#: mpmath has no outward rounding for atan, tanh, asin and irrational constants. 53 bits are wrong
#: by less than 2^-51 of the value, or of 4 where that is larger; they are widened by this.
INTERVAL_SLACK = mp.mpf(2) ** -45


def _increasing(at: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Of an increasing function, the ends of the values are the values at the ends."""
    return lambda x: iv.mpf([at(x.a).a, at(x.b).b])


def _sinh(x: Any) -> Any:
    """Enclosure of sinh at a point, which may be infinite."""
    if mp.isinf(mp.mpf(x)):
        return iv.mpf(x)
    return (iv.exp(x) - iv.exp(-x)) / 2


def _cosh(x: Any) -> Any:
    """cosh of an interval: it grows with the magnitude."""
    size = abs(x)
    low, high = (iv.exp(end) / 2 + iv.exp(-end) / 2 for end in (size.a, size.b))
    return iv.mpf([low.a, high.b])


def _tan(x: Any) -> Any:
    """tan of an interval without a pole: the cosine has one sign there."""
    if mp.isinf(mp.mpf(x.a)) or mp.isinf(mp.mpf(x.b)):
        raise ValueError("tan has poles on this interval")
    cosine = iv.cos(x)
    if not (cosine.a > 0 or cosine.b < 0):
        raise ValueError("tan may have a pole on this interval")
    low, high = (iv.sin(end) / iv.cos(end) for end in (iv.mpf(x.a), iv.mpf(x.b)))
    return iv.mpf([low.a, high.b])


def _log(x: Any) -> Any:
    """log of an interval of positive numbers, the upper end of which may be infinite."""
    if not x.a > 0:
        raise ValueError("log has no value on this interval")
    high = iv.mpf(x.b) if mp.isinf(mp.mpf(x.b)) else iv.log(iv.mpf(x.b))
    return iv.mpf([iv.log(iv.mpf(x.a)).a, high.b])


def _asin(x: Any) -> Any:
    """asin of an interval within [-1, 1]."""
    if not (x.a >= -1 and x.b <= 1):
        raise ValueError("asin has no value on this interval")
    ends = mp.asin(mp.mpf(x.a)) - INTERVAL_SLACK, mp.asin(mp.mpf(x.b)) + INTERVAL_SLACK
    return iv.mpf(ends)


#: Functions of one argument.
_RULES: dict[Any, Callable[[Any], Any]] = {
    sympy.exp: iv.exp,
    sympy.log: _log,
    sympy.atan: _increasing(lambda x: _atan(x)),
    sympy.tanh: _increasing(lambda x: _tanh(x)),
    sympy.sinh: _increasing(_sinh),
    sympy.cosh: _cosh,
    sympy.tan: _tan,
    sympy.asin: _asin,
    sympy.acos: lambda x: iv.pi / 2 - _asin(x),
}


def _atan(x: Any) -> Any:
    """Enclosure of atan at a point, which may be infinite."""
    half_pi = iv.pi / 2
    if mp.isinf(mp.mpf(x)):
        return half_pi if mp.mpf(x) > 0 else -half_pi
    value = mp.atan(mp.mpf(x))
    return iv.mpf([value - INTERVAL_SLACK, value + INTERVAL_SLACK])


def _tanh(x: Any) -> Any:
    """Enclosure of tanh at a point, which may be infinite."""
    value = mp.tanh(mp.mpf(x)) if mp.isfinite(mp.mpf(x)) else mp.sign(mp.mpf(x))
    return iv.mpf([max(value - INTERVAL_SLACK, -1), min(value + INTERVAL_SLACK, 1)])


def enclosure(expr: sympy.Expr, box: Mapping[sympy.Symbol, Any]) -> Any:
    """Interval of `expr` over a box of its symbols, rounded outward.

    Raises
    ------
    ValueError, ArithmeticError
        Where a part is unbounded, undefined, or has no rule.
    """
    if expr in box:
        return box[expr]
    if expr.is_Number:
        exact = sympy.Rational(expr)
        return iv.mpf(int(exact.p)) / iv.mpf(int(exact.q))  # division of intervals rounds outward
    if expr.is_NumberSymbol:
        value = mp.mpf(sympy.N(expr, 30))
        slack = abs(value) * INTERVAL_SLACK
        return iv.mpf([value - slack, value + slack])
    if isinstance(expr, (sympy.sin, sympy.cos)):
        inner = enclosure(expr.args[0], box)
        if mp.isinf(mp.mpf(inner.a)) or mp.isinf(mp.mpf(inner.b)):
            return iv.mpf([-1, 1])
        return (iv.sin if isinstance(expr, sympy.sin) else iv.cos)(inner)
    parts = [enclosure(arg, box) for arg in expr.args] if not isinstance(expr, sympy.Pow) else []
    if isinstance(expr, sympy.Add):
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return _determined(total)
    if isinstance(expr, sympy.Mul):
        total = parts[0]
        for part in parts[1:]:
            total = total * part
        return _determined(total)
    if isinstance(expr, sympy.Abs):
        return abs(parts[0])
    if isinstance(expr, (sympy.Min, sympy.Max)):
        pick = min if isinstance(expr, sympy.Min) else max
        return iv.mpf([pick(mp.mpf(p.a) for p in parts), pick(mp.mpf(p.b) for p in parts)])
    if isinstance(expr, sympy.sign):
        return iv.mpf([-1, 1])
    if type(expr) in _RULES:
        return _RULES[type(expr)](parts[0])
    if isinstance(expr, sympy.Pow):
        return _enclosed_power(expr, box)
    raise ValueError(f"no interval rule for {type(expr).__name__}")


def _enclosed_power(expr: sympy.Expr, box: Mapping[sympy.Symbol, Any]) -> Any:
    """Enclosure of a power whose exponent is a number."""
    base, exponent = expr.args
    inside = enclosure(base, box)
    if exponent.is_Rational and exponent.q == 2 and inside.a >= 0:
        inside, exponent = iv.sqrt(inside), exponent * 2
    if exponent.is_Integer and exponent > 0:
        return _determined(inside ** int(exponent))
    if exponent.is_Integer and (inside.a > 0 or inside.b < 0):
        return _determined(iv.mpf(1) / inside ** int(-exponent))
    if exponent.is_number and not exponent.is_Integer and inside.a > 0:
        return _determined(iv.exp(enclosure(exponent, {}) * _log(inside)))
    raise ValueError("no interval rule for this power")


def _determined(values: Any) -> Any:
    """The interval itself; inf - inf and 0 inf have no value and are refused."""
    if mp.isnan(mp.mpf(values.a)) or mp.isnan(mp.mpf(values.b)):
        raise ArithmeticError("undetermined interval")
    return values
