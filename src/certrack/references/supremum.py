"""Proven bounds on |f(t)|, t >= 0, of sums of sinusoids: exact where there is one frequency."""

from __future__ import annotations

import math
from collections import defaultdict

import sympy
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
    if not is_sum_of_sinusoids(expr):
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


def is_sum_of_sinusoids(expr: sympy.Expr) -> bool:
    """Whether it is made of sines of something linear in t, and expanding it is quick."""
    return 0 < _terms(expr) <= MAX_SINUSOIDS


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
