"""Enclosures of a formula of t and of its Taylor coefficients, on many intervals of time at once.

The formula is walked once, with one array operation for all intervals. Of the value and of the
first coefficient intervals are kept, of the higher coefficients magnitudes:

    c_k = f^(k)(t)/k! h^k  for every t of an interval of half the width h.

Rounding is covered by widening every result by a few units in the last place; where a formula is
not defined everywhere on an interval, the enclosure is infinite.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import TIME

#: Every operation widens its result by this part of its magnitude: more than its roundings.
WIDENING = 2.0**-50

#: What the underflow of a product or a power loses, at most.
LOST_BY_UNDERFLOW = 2.0**-1070

#: Values of symbols: the same on all intervals, or one on each, or a pair of bounds.
Known = Mapping[sympy.Symbol, Any]


@dataclass(frozen=True)
class IntervalArray:
    """What is known of a formula on each of N intervals.

    Attributes
    ----------
    low, high : (2, N) arrays
        Bounds of the value, and of the first Taylor coefficient.
    sizes : (K+1, N) array
        Bounds of the magnitudes of the coefficients 0 ... K, K >= 1.
    """

    low: Array
    high: Array
    sizes: Array

    @property
    def order(self) -> int:
        return len(self.sizes) - 1


def enclose(
    formula: sympy.Expr, begins: Array, ends: Array, known: Known, order: int
) -> IntervalArray:
    """Enclose a formula of t on the intervals [begins, ends].

    Parameters
    ----------
    formula : sympy.Expr
        Of the functions that a system file may contain.
    begins, ends : (N,) arrays, s
    known : mapping
        Values of all symbols but t; arrays have one for each interval. A pair stands for any value
        between two.
    order : int >= 1
        Number of Taylor coefficients beyond the value.

    Returns
    -------
    IntervalArray
        Infinite where nothing is known.
    """
    half = np.maximum((ends - begins) / 2, 0.0)
    memory: dict[sympy.Basic, IntervalArray] = {}

    def constant(value: Any) -> IntervalArray:
        low, high = (
            np.broadcast_to(np.asarray(bound, dtype=float), half.shape)
            for bound in (value if isinstance(value, tuple) else (value, value))
        )
        return _of_bounds(low, order, high)

    def time() -> IntervalArray:
        linear = _of_bounds(begins, order, ends)
        linear.low[1], linear.high[1], linear.sizes[1] = half, half, half
        return linear

    def walk(expr: sympy.Basic) -> IntervalArray:
        if expr not in memory:
            memory[expr] = compute(expr)
        return memory[expr]

    def compute(expr: sympy.Basic) -> IntervalArray:
        if expr == TIME:
            return time()
        if expr in known:
            return constant(known[expr])
        if not expr.free_symbols:
            return _widened(constant(float(expr)))
        if isinstance(expr, sympy.Pow):
            base, exponent = expr.args
            return _power(walk(base), exponent)
        if type(expr) in _FOLDED:
            return reduce(_FOLDED[type(expr)], map(walk, expr.args))
        if type(expr) in _FUNCTIONS:
            return _FUNCTIONS[type(expr)](*map(walk, expr.args))
        raise TypeError(f"no enclosure of {type(expr).__name__}")

    with np.errstate(all="ignore"):
        value = walk(formula)
        unknown = np.isnan(value.low) | np.isnan(value.high)
        return IntervalArray(
            np.where(unknown, -np.inf, value.low),
            np.where(unknown, np.inf, value.high),
            np.where(np.isnan(value.sizes), np.inf, value.sizes),
        )


def _of_bounds(low: Array, order: int, high: Array | None = None) -> IntervalArray:
    """A function whose value alone is known, as a constant."""
    high = low if high is None else high
    bounds = np.zeros((2, 2, len(low)))
    bounds[0, 0], bounds[1, 0] = low, high
    sizes = np.zeros((order + 1, len(low)))
    sizes[0] = np.maximum(np.abs(low), np.abs(high))
    return IntervalArray(bounds[0], bounds[1], sizes)


def _widened(value: IntervalArray) -> IntervalArray:
    """The enclosure with its rounding, and magnitudes that fit its bounds."""
    low = value.low - WIDENING * np.abs(value.low)
    high = value.high + WIDENING * np.abs(value.high)
    sizes = value.sizes * (1 + WIDENING)
    sizes[:2] = np.fmin(sizes[:2], np.maximum(np.abs(low), np.abs(high)))
    return IntervalArray(low, high, sizes)


def _add(a: IntervalArray, b: IntervalArray) -> IntervalArray:
    """The sum; its rounding is that of its parts' magnitudes."""
    blur = WIDENING * (a.sizes[:2] + b.sizes[:2]) * ((a.sizes[:2] > 0) & (b.sizes[:2] > 0))
    low, high = a.low + b.low - blur, a.high + b.high + blur
    return _widened(IntervalArray(low, high, a.sizes + b.sizes))


def _scaled(a: IntervalArray, factor: float) -> IntervalArray:
    first, last = factor * a.low, factor * a.high
    return IntervalArray(np.minimum(first, last), np.maximum(first, last), abs(factor) * a.sizes)


def _times(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    """Product of intervals; zero times infinity is zero, for an infinite bound is not attained."""
    corners = np.array([a[i] * b[j] for i in (0, 1) for j in (0, 1)])
    corners = np.where(np.isnan(corners), 0.0, corners)
    unknown = np.isnan([*a, *b]).any(axis=0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return np.where(unknown, np.nan, low), np.where(unknown, np.nan, high)


def _multiply(a: IntervalArray, b: IntervalArray) -> IntervalArray:
    low, high = _times((a.low[0], a.high[0]), (b.low[0], b.high[0]))
    lost = LOST_BY_UNDERFLOW * ((a.sizes[0] > 0) & (b.sizes[0] > 0))
    low, high = low - lost, high + lost
    one = _times((a.low[1], a.high[1]), (b.low[0], b.high[0]))
    two = _times((a.low[0], a.high[0]), (b.low[1], b.high[1]))
    sizes = np.array([_convolved(a.sizes, b.sizes, k) for k in range(a.order + 1)])
    return _widened(
        IntervalArray(np.array([low, one[0] + two[0]]), np.array([high, one[1] + two[1]]), sizes)
    )


def _convolved(a: Array, b: Array, k: int) -> Array:
    """Coefficient k of a product."""
    products = a[: k + 1] * b[k::-1]
    total: Array = np.where(np.isnan(products), 0.0, products).sum(axis=0)
    return total


def _chain(inner: IntervalArray, low: Array, high: Array, slope: IntervalArray) -> IntervalArray:
    """f(inner) from the bounds of its value and the enclosure of f'(inner).

    The coefficients follow from k y_k = sum_j j x_j slope_{k-j}.
    """
    order = inner.order
    value = _of_bounds(low, order, high)
    for k in range(1, order + 1):
        terms = np.array([j * inner.sizes[j] * slope.sizes[k - j] for j in range(1, k + 1)])
        value.sizes[k] = np.where(np.isnan(terms), 0.0, terms).sum(axis=0) / k
    bounds = _times((slope.low[0], slope.high[0]), (inner.low[1], inner.high[1]))
    value.low[1], value.high[1] = bounds
    return _widened(value)


def _monotone(function: Callable[[Array], Array], x: IntervalArray) -> tuple[Array, Array]:
    low, high = function(x.low[0]), function(x.high[0])
    return low - WIDENING * np.abs(low), high + WIDENING * np.abs(high)


def _exp(x: IntervalArray) -> IntervalArray:
    low, high = _monotone(np.exp, x)
    high = high + LOST_BY_UNDERFLOW
    value = _of_bounds(low, x.order, high)
    for k in range(1, x.order + 1):
        terms = np.array([j * x.sizes[j] * value.sizes[k - j] for j in range(1, k + 1)])
        value.sizes[k] = np.where(np.isnan(terms), 0.0, terms).sum(axis=0) / k
    return _chain(x, low, high, value)


def _log(x: IntervalArray) -> IntervalArray:
    low, high = _monotone(np.log, x)
    inverse = _power(x, sympy.Integer(-1))
    return _chain(x, low, high, inverse)


def _waves(x: IntervalArray) -> tuple[IntervalArray, IntervalArray]:
    """Sine and cosine."""
    ranges = []
    for shift in (0.0, np.pi / 2):  # cos x = sin(x + pi/2)
        a, b = x.low[0] + shift, x.high[0] + shift
        blur = 4 * WIDENING * (1 + x.sizes[0])
        top = np.ceil((a - np.pi / 2 - blur) / (2 * np.pi)) <= (b - np.pi / 2 + blur) / (2 * np.pi)
        bottom = np.ceil((a + np.pi / 2 - blur) / (2 * np.pi)) <= (b + np.pi / 2 + blur) / (
            2 * np.pi
        )
        f, g = (np.sin if not shift else np.cos)(np.array([x.low[0], x.high[0]]))
        low = np.where(bottom, -1.0, np.minimum(f, g) - WIDENING)
        high = np.where(top, 1.0, np.maximum(f, g) + WIDENING)
        wide = ~(b - a < 2 * np.pi)
        ranges.append((np.where(wide, -1.0, low), np.where(wide, 1.0, high)))
    sine, cosine = (_of_bounds(low, x.order, high) for low, high in ranges)
    for k in range(1, x.order + 1):
        j = np.arange(1, k + 1)[:, None] * x.sizes[1 : k + 1]
        sine.sizes[k] = (j * cosine.sizes[k - 1 :: -1][:k]).sum(axis=0) / k
        cosine.sizes[k] = (j * sine.sizes[k - 1 :: -1][:k]).sum(axis=0) / k
    slopes = (x.low[1], x.high[1])
    sine.low[1], sine.high[1] = _times((cosine.low[0], cosine.high[0]), slopes)
    cosine.low[1], cosine.high[1] = _times((-sine.high[0], -sine.low[0]), slopes)
    return _widened(sine), _widened(cosine)


def _tanh(x: IntervalArray) -> IntervalArray:
    low, high = _monotone(np.tanh, x)
    nearest = np.where(
        (x.low[0] <= 0) & (x.high[0] >= 0), 0.0, np.fmin(abs(x.low[0]), abs(x.high[0]))
    )
    steepest = (1 / np.cosh(np.minimum(nearest, 700.0))) ** 2  # 1 - tanh^2 would cancel
    flattest = (1 / np.cosh(np.minimum(x.sizes[0], 700.0))) ** 2
    value = _of_bounds(low, x.order, high)
    rates = _of_bounds(flattest * (1 - WIDENING), x.order, steepest * (1 + WIDENING))
    for k in range(1, x.order + 1):
        value.sizes[k] = sum(j * x.sizes[j] * rates.sizes[k - j] for j in range(1, k + 1)) / k
        rates.sizes[k] = _convolved(value.sizes, value.sizes, k)  # of 1 - tanh^2
    return _chain(x, low, high, rates)


def _hyperbolic(x: IntervalArray, *, odd: bool) -> IntervalArray:
    """sinh, or cosh."""
    up, down = _exp(x), _exp(_scaled(x, -1.0))
    return _scaled(_add(up, _scaled(down, -1.0 if odd else 1.0)), 0.5)


def _one_plus_square(x: IntervalArray, sign: float) -> IntervalArray:
    one = _of_bounds(np.ones(x.low.shape[1]), x.order)
    return _add(one, _scaled(_power(x, sympy.Integer(2)), sign))


def _atan(x: IntervalArray) -> IntervalArray:
    slope = _power(_one_plus_square(x, 1.0), sympy.Integer(-1))
    return _chain(x, *_monotone(np.arctan, x), slope)


def _arcsine(x: Array) -> Array:
    """Of an argument that rounding may have brought past 1."""
    return np.arcsin(np.where(abs(x) <= 1 + 8 * WIDENING, np.clip(x, -1, 1), np.nan))


def _asin(x: IntervalArray) -> IntervalArray:
    slope = _power(_one_plus_square(x, -1.0), sympy.Rational(-1, 2))
    return _chain(x, *_monotone(_arcsine, x), slope)


def _acos(x: IntervalArray) -> IntervalArray:
    return _add(_of_bounds(np.full(x.low.shape[1], np.pi / 2), x.order), _scaled(_asin(x), -1.0))


def _angle(y: IntervalArray, x: IntervalArray) -> IntervalArray:
    value = _atan(_multiply(y, _power(x, sympy.Integer(-1))))
    right = x.low[0] > 0
    return IntervalArray(
        np.where(right, value.low, [[-np.pi], [-np.inf]]),
        np.where(right, value.high, [[np.pi], [np.inf]]),
        np.where(right, value.sizes, np.inf),
    )


def _power(x: IntervalArray, exponent: sympy.Expr) -> IntervalArray:
    if exponent.is_Integer and exponent > 0:
        return _natural_power(x, int(exponent))
    p, low, high = float(exponent), x.low[0], x.high[0]
    if exponent.is_Integer:  # not through zero
        defined = (low > 0) | (high < 0)
    else:
        defined = low > 0
    ends = np.array([np.where(defined, low, high) ** p, high**p])
    bounded = defined if exponent.is_Integer or p < 0 else high >= 0
    first = np.where(defined, ends.min(axis=0), 0.0)  # a root begins at zero
    value = _of_bounds(
        np.where(bounded, first, np.nan), x.order, np.where(bounded, ends.max(axis=0), np.nan)
    )
    smallest = np.fmin(abs(low), abs(high))
    for k in range(1, x.order + 1):  # k x_0 y_k = sum_j (p j - (k - j)) x_j y_{k-j}
        weights = [abs(p * j - (k - j)) for j in range(1, k + 1)]
        terms = sum(w * x.sizes[j + 1] * value.sizes[k - j - 1] for j, w in enumerate(weights))
        value.sizes[k] = np.where(defined, terms / (k * smallest), np.inf)
    value.sizes[0] = np.where(bounded, value.sizes[0], np.inf)
    slopes = np.array([p * ends[0] / low, p * ends[1] / high])
    bounds = _times((slopes.min(axis=0), slopes.max(axis=0)), (x.low[1], x.high[1]))
    value.low[1], value.high[1] = (np.where(defined, bound, np.nan) for bound in bounds)
    return _widened(value)


def _natural_power(x: IntervalArray, p: int) -> IntervalArray:
    """By squaring; the value of an even power is not negative."""
    if p == 1:
        return x
    half = _natural_power(x, p // 2)
    square = _multiply(half, half)
    value = _multiply(square, x) if p % 2 else square
    if p % 2 == 0:
        crosses = (x.low[0] <= 0) & (x.high[0] >= 0)
        ends = np.array([np.abs(x.low[0]) ** p, np.abs(x.high[0]) ** p])
        value.low[0] = np.where(crosses, 0.0, ends.min(axis=0) * (1 - p * WIDENING))
        value.high[0] = ends.max(axis=0) * (1 + p * WIDENING)
        slopes = _times(
            (p * _signed(x.low[0], p - 1), p * _signed(x.high[0], p - 1)), (x.low[1], x.high[1])
        )
        value.low[1], value.high[1] = slopes
        return _widened(value)
    return value


def _signed(x: Array, p: int) -> Array:
    return np.sign(x) * np.abs(x) ** p


def _abs(x: IntervalArray) -> IntervalArray:
    return _larger(x, _scaled(x, -1.0))


def _enclosed_sign(x: IntervalArray) -> IntervalArray:
    value = _of_bounds(np.sign(x.low[0]), x.order, np.sign(x.high[0]))
    jumps = value.low[0] < value.high[0]
    value.low[1], value.high[1] = np.where(jumps, -np.inf, 0.0), np.where(jumps, np.inf, 0.0)
    value.sizes[1:] = np.where(jumps, np.inf, 0.0)
    return value


def _larger(a: IntervalArray, b: IntervalArray) -> IntervalArray:
    first, second = a.low[0] >= b.high[0], b.low[0] >= a.high[0]

    def chosen(of_a: Array, of_b: Array, otherwise: Array) -> Array:
        return np.where(first, of_a, np.where(second, of_b, otherwise))

    low = np.array([np.fmax(a.low[0], b.low[0]), np.minimum(a.low[1], b.low[1])])
    high = np.array([np.fmax(a.high[0], b.high[0]), np.maximum(a.high[1], b.high[1])])
    sizes = np.maximum(a.sizes, b.sizes)
    sizes[2:] = np.where(first | second, sizes[2:], np.inf)  # a kink has no second coefficient
    low, high = chosen(a.low, b.low, low), chosen(a.high, b.high, high)
    sizes = chosen(a.sizes, b.sizes, sizes)
    sizes[0] = np.maximum(np.abs(low[0]), np.abs(high[0]))
    return IntervalArray(low, high, sizes)


def _smaller(a: IntervalArray, b: IntervalArray) -> IntervalArray:
    return _scaled(_larger(_scaled(a, -1.0), _scaled(b, -1.0)), -1.0)


_FOLDED: dict[Any, Callable[[IntervalArray, IntervalArray], IntervalArray]] = {
    sympy.Add: _add,
    sympy.Mul: _multiply,
    sympy.Max: _larger,
    sympy.Min: _smaller,
}

_FUNCTIONS: dict[Any, Callable[..., IntervalArray]] = {
    sympy.exp: _exp,
    sympy.log: _log,
    sympy.sin: lambda x: _waves(x)[0],
    sympy.cos: lambda x: _waves(x)[1],
    sympy.tan: lambda x: _multiply(_waves(x)[0], _power(_waves(x)[1], sympy.Integer(-1))),
    sympy.sinh: lambda x: _hyperbolic(x, odd=True),
    sympy.cosh: lambda x: _hyperbolic(x, odd=False),
    sympy.tanh: _tanh,
    sympy.atan: _atan,
    sympy.asin: _asin,
    sympy.acos: _acos,
    sympy.atan2: _angle,
    sympy.Abs: _abs,
    sympy.sign: _enclosed_sign,
}
