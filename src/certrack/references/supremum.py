"""Proven bounds on |f(t)|, t >= 0: exact for sums of sinusoids, by intervals otherwise."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import sympy
from mpmath import iv, mp
from sympy.simplify.fu import TR8

from certrack.core.expressions import TIME
from certrack.core.rationals import float_above


def sinusoid_supremum(expr: sympy.Expr) -> tuple[float, bool] | None:
    """Bound of a constant plus a sum of sinusoids, or None if `expr` is not one.

    Sinusoids of one frequency add to one amplitude, so a constant and a single frequency give the
    exact supremum. Different frequencies give the sum of amplitudes, an upper bound (attained in
    the limit if the frequencies are incommensurate).

    Returns
    -------
    bound, exact : float, bool
    """
    if not 0 < _terms(expr) <= MAX_SINUSOIDS:
        return None
    offset = sympy.S.Zero
    amplitude: dict[sympy.Expr, list[sympy.Expr]] = defaultdict(lambda: [sympy.S.Zero] * 2)
    products = sympy.expand(TR8(sympy.expand(expr)))  # products of sinusoids become sums
    for term in sympy.Add.make_args(products):
        factor, wave = term.as_independent(TIME)
        if wave == 1:
            offset += factor
            continue
        if not isinstance(wave, (sympy.sin, sympy.cos)):
            return None
        phase = sympy.Poly(wave.args[0], TIME) if wave.args[0].is_polynomial(TIME) else None
        if phase is None or phase.degree() != 1:
            return None
        w, shift = phase.all_coeffs()
        if w.is_negative:  # sin(-a) = -sin a, cos(-a) = cos a
            w, shift = -w, -shift
            factor = -factor if isinstance(wave, sympy.sin) else factor
        sine, cosine = amplitude[w]
        if isinstance(wave, sympy.sin):  # a sin(wt + s) = a cos s sin wt + a sin s cos wt
            pair = [sine + factor * sympy.cos(shift), cosine + factor * sympy.sin(shift)]
        else:
            pair = [sine - factor * sympy.sin(shift), cosine + factor * sympy.cos(shift)]
        amplitude[w] = pair
    total = sympy.Abs(offset) + sum(sympy.sqrt(a**2 + b**2) for a, b in amplitude.values())
    return float_above(total), len(amplitude) <= 1


#: Expanding sums of sinusoids beyond this power or number of terms takes too long.
MAX_SINUSOID_POWER, MAX_SINUSOIDS = 16, 200

#: mpmath has no outward rounding for atan, tanh and irrational constants. All are below 4, so 53
#: bits are wrong by less than 2^-51; they are widened by this.
INTERVAL_SLACK = mp.mpf(2) ** -45


def _terms(expr: sympy.Expr) -> int:
    """Number of sinusoids that expanding gives; 0 if `expr` is not made of them."""
    if not expr.has(TIME):
        return 1
    if isinstance(expr, (sympy.sin, sympy.cos)):
        return 1 if expr.args[0].is_polynomial(TIME) else 0
    if isinstance(expr, sympy.Add):
        parts = [_terms(arg) for arg in expr.args]
        return sum(parts) if all(parts) else 0
    if isinstance(expr, sympy.Mul):
        return math.prod(_terms(arg) for arg in expr.args)
    if isinstance(expr, sympy.Pow) and expr.exp.is_Integer and 0 < expr.exp <= MAX_SINUSOID_POWER:
        inside = _terms(expr.base)
        return min(10**6, max(inside, 2) ** int(expr.exp)) if inside else 0
    return 0


def interval_supremum(expr: sympy.Expr) -> float | None:
    """Upper bound of |expr| over t in [0, inf) by interval arithmetic, or None."""
    try:
        bound = mp.mpf(abs(enclosure(expr, {TIME: iv.mpf([0, "inf"])})).b)
    except (ArithmeticError, ValueError, TypeError, NotImplementedError):
        return None
    return None if not mp.isfinite(bound) else float_above(sympy.Float(bound, 30))


#: Increasing functions: the ends of their values are the values at the ends.
_MONOTONE = {
    sympy.exp: iv.exp,
    sympy.atan: lambda x: iv.mpf([_atan(x.a).a, _atan(x.b).b]),
    sympy.tanh: lambda x: iv.mpf([_tanh(x.a).a, _tanh(x.b).b]),
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
        return iv.mpf([value - INTERVAL_SLACK, value + INTERVAL_SLACK])
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
    if type(expr) in _MONOTONE:
        return _MONOTONE[type(expr)](parts[0])
    if isinstance(expr, sympy.Pow):
        return _enclosed_power(expr, box)
    raise ValueError(f"no interval rule for {type(expr).__name__}")


def _enclosed_power(expr: sympy.Expr, box: Mapping[sympy.Symbol, Any]) -> Any:
    """Enclosure of an integer or half-integer power."""
    base, exponent = expr.args
    inside = enclosure(base, box)
    if exponent.is_Integer and exponent > 0:
        return _determined(inside ** int(exponent))
    if exponent.is_Rational and exponent.q == 2 and inside.a >= 0:
        inside, exponent = iv.sqrt(inside), exponent * 2
        if exponent > 0:
            return _determined(inside ** int(exponent))
    if exponent.is_Integer and exponent < 0 and inside.a > 0:
        return _determined(iv.mpf(1) / inside ** int(-exponent))
    raise ValueError("no interval rule for this power")


def _determined(values: Any) -> Any:
    """The interval itself; inf - inf and 0 inf have no value and are refused."""
    if mp.isnan(mp.mpf(values.a)) or mp.isnan(mp.mpf(values.b)):
        raise ArithmeticError("undetermined interval")
    return values
