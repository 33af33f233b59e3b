"""Formulas that grow with every size: proven by rules, not by samples.

The symbols of the formula stand for sizes, any numbers >= 0. Of every part it is known whether it
never falls, never rises, or both (a number), and between which ends it lies:

    sums and products of parts >= 0 that move one way; powers of parts >= 0; 1/part of a part > 0;
    functions that rise (exp, log, sqrt, tanh, atan, sinh, cosh, abs, min, max) of such parts.

All of these are continuous where their rules hold, so a formula that is proven is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any

import sympy

from certrack.core.errors import CertrackError

#: Digits of a number that is not rational, and by which part its ends are moved outwards.
NUMBER_DIGITS, END_WIDENING = 40, sympy.Rational(1, 10**30)

#: Numbers beyond this, or below it, are only told to be.
ALMOST_ZERO = sympy.Rational(1, 10**300)

#: Functions that rise wherever they are defined, and what their argument must be above.
RISING: dict[Any, sympy.Expr] = {
    sympy.exp: -sympy.oo,
    sympy.sinh: -sympy.oo,
    sympy.tanh: -sympy.oo,
    sympy.atan: -sympy.oo,
    sympy.log: sympy.S.Zero,
    sympy.cosh: sympy.S.Zero,
    sympy.Abs: sympy.S.Zero,
}

#: Those of them that are defined at their end, too.
CLOSED = (sympy.cosh, sympy.Abs)

#: Functions with f(c y) <= c f(y) for y >= 0 and c >= 1; log(1 + y) is another.
CONCAVE = (sympy.tanh, sympy.atan)

#: Growth that no power describes.
UNLIMITED = Fraction(10**9)


class NotMonotone(CertrackError):
    """No rule shows that a part only grows; its text says which."""


@dataclass(frozen=True)
class Trend:
    """How a part of a formula moves with the sizes.

    Attributes
    ----------
    rises, falls : bool
        Whether it never falls, never rises.
    low, high : sympy numbers, or infinite
        It lies between.
    """

    rises: bool
    falls: bool
    low: Any
    high: Any

    @property
    def turned(self) -> Trend:
        """Of the negative."""
        return Trend(self.falls, self.rises, -self.high, -self.low)


def trend(formula: sympy.Expr, sizes: Iterable[sympy.Symbol]) -> Trend:
    """How a formula moves where its symbols are any numbers >= 0.

    Parameters
    ----------
    formula : sympy.Expr
        Without other symbols.
    sizes : symbols

    Raises
    ------
    NotMonotone
        If no rule tells.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> trend(1 - 1 / (1 + x**2), [x]).rises
    True
    """
    return _trend(formula, frozenset(sizes))


def check_growth(formula: sympy.Expr, sizes: Iterable[sympy.Symbol]) -> None:
    """Refuse a formula that is not proven to be >= 0 and never to fall.

    Raises
    ------
    NotMonotone
        With what is not proven, to be read after "must ...".
    """
    result = trend(formula, sizes)
    if not result.rises:
        raise NotMonotone(f"never fall where a size grows, but {formula} falls")
    if not _is_above(result.low, sympy.S.Zero, closed=True):
        raise NotMonotone(f"not be negative, but {formula} may be {float(result.low):.6g}")


def growth_power(formula: sympy.Expr) -> Fraction:
    """The p with f(c x) <= c^p f(x) for all sizes x and c >= 1; :data:`UNLIMITED` if none is known.

    Parameters
    ----------
    formula : sympy.Expr
        One that :func:`check_growth` accepts.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> growth_power(x * sympy.sqrt(x) + 2), growth_power(sympy.tanh(x))
    (Fraction(3, 2), Fraction(1, 1))
    """
    if not formula.free_symbols:
        return Fraction(0) if _is_above(_ends(formula)[0], sympy.S.Zero, closed=True) else UNLIMITED
    if formula.is_Symbol:
        return Fraction(1)
    parts = [growth_power(part) for part in formula.args]
    if isinstance(formula, (sympy.Add, sympy.Max, sympy.Min)):
        return max(parts)
    if isinstance(formula, sympy.Mul):
        return min(UNLIMITED, sum(parts, Fraction(0)))
    if isinstance(formula, sympy.Pow) and formula.exp.is_Rational and formula.exp > 0:
        return min(UNLIMITED, parts[0] * Fraction(int(formula.exp.p), int(formula.exp.q)))
    if isinstance(formula, sympy.Abs):
        return parts[0]
    if isinstance(formula, CONCAVE):
        return parts[0]
    if isinstance(formula, sympy.log):  # log(a + v) = log(a) + log(1 + v/a)
        numbers, others = formula.args[0].as_independent(*formula.free_symbols, as_Add=True)
        least = _ends(numbers)[0]
        return growth_power(others) if _is_above(least, sympy.S.One, closed=True) else UNLIMITED
    return UNLIMITED


def _trend(f: sympy.Expr, sizes: frozenset[sympy.Symbol]) -> Trend:
    if not f.free_symbols & sizes:
        return Trend(True, True, *_ends(f))
    if f in sizes:
        return Trend(True, False, sympy.S.Zero, sympy.oo)
    if isinstance(f, sympy.Add):
        parts = [_trend(part, sizes) for part in f.args]
        return _together(f, parts, sum(p.low for p in parts), sum(p.high for p in parts))
    if isinstance(f, sympy.Mul):
        return _trend_of_product(f, sizes)
    if isinstance(f, sympy.Pow):
        return _trend_of_power(f, sizes)
    if isinstance(f, (sympy.Max, sympy.Min)):
        parts = [_trend(part, sizes) for part in f.args]
        choose = sympy.Max if isinstance(f, sympy.Max) else sympy.Min
        return _together(
            f, parts, choose(*(p.low for p in parts)), choose(*(p.high for p in parts))
        )
    if f.func in RISING:
        inside = _trend(f.args[0], sizes)
        if not _is_above(inside.low, RISING[f.func], closed=f.func in CLOSED):
            raise NotMonotone(
                f"be proven never to fall where a size grows, and no rule says so of {f}"
            )
        low, high = _through(f.func, inside.low)[0], _through(f.func, inside.high)[1]
        return Trend(inside.rises, inside.falls, low, high)
    raise NotMonotone(f"be proven never to fall where a size grows, and no rule says so of {f}")


def _together(f: sympy.Expr, parts: list[Trend], low: Any, high: Any) -> Trend:
    """A part of which all moves as its own parts do."""
    rises, falls = all(p.rises for p in parts), all(p.falls for p in parts)
    if not (rises or falls):
        raise NotMonotone(
            f"be proven never to fall where a size grows, and parts of {f} rise and fall"
        )
    return Trend(rises, falls, low, high)


def _trend_of_product(f: sympy.Expr, sizes: frozenset[sympy.Symbol]) -> Trend:
    factors = [_trend(part, sizes) for part in f.args]
    turns = 0
    for i, factor in enumerate(factors):
        if not _is_above(factor.low, sympy.S.Zero, closed=True):
            factors[i], turns = factor.turned, turns + 1
            if not _is_above(factors[i].low, sympy.S.Zero, closed=True):
                raise NotMonotone(
                    f"be proven never to fall where a size grows, and {f.args[i]} changes its sign"
                )
    low = reduce(_product_end, (p.low for p in factors))
    high = reduce(_product_end, (p.high for p in factors))
    result = _together(f, factors, low, high)
    return result.turned if turns % 2 else result


def _product_end(a: Any, b: Any) -> Any:
    return sympy.S.Zero if a == 0 or b == 0 else a * b


def _trend_of_power(f: sympy.Expr, sizes: frozenset[sympy.Symbol]) -> Trend:
    base, exponent = _trend(f.base, sizes), f.exp
    positive = exponent.is_Rational and exponent > 0
    if not exponent.is_Rational or not _is_above(base.low, sympy.S.Zero, closed=positive):
        raise NotMonotone(f"be proven never to fall where a size grows, and no rule says so of {f}")

    def power(value: Any, up: int) -> Any:
        if not value.is_finite:
            return sympy.oo if positive else sympy.S.Zero
        return _ends(value**exponent)[up]

    if positive:
        return Trend(base.rises, base.falls, power(base.low, 0), power(base.high, 1))
    return Trend(base.falls, base.rises, power(base.high, 0), power(base.low, 1))


def _through(function: Any, end: Any) -> tuple[Any, Any]:
    """Ends of a rising function at an end of its argument."""
    value = function(end)
    return _ends(value)


def _ends(number: sympy.Expr) -> tuple[Any, Any]:
    """Rationals below and above a number; itself if it is one."""
    if number.is_Rational or not number.is_finite:
        return number, number
    value = sympy.N(number, NUMBER_DIGITS)
    if not ALMOST_ZERO < abs(value) < 1 / ALMOST_ZERO:  # whose digits would fill the memory
        size = (sympy.S.Zero, ALMOST_ZERO) if abs(value) < 1 else (1 / ALMOST_ZERO, sympy.oo)
        return size if value > 0 else (-size[1], -size[0])
    value = sympy.Rational(str(value))
    off = END_WIDENING * (abs(value) + END_WIDENING)
    return value - off, value + off


def _is_above(low: Any, limit: Any, *, closed: bool) -> bool:
    """Whether what is at least `low` is above a limit, or at it."""
    if limit == -sympy.oo:
        return True
    return bool(low >= limit) if closed else bool(low > limit)
