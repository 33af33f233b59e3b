"""Numbers that enclose a function of t on a whole interval, which may have no end.

On [a, b] a :class:`GrowthEnclosure` is a sum of t^k e^(r t), each with an interval of factors, so
that what grows and what decays is told apart: t e^(-t) is bounded, and (1 + t)/(2 + t) is near 1,
though each t is not. Factors are exact rationals where they can be, else Arb's balls; all are
rounded outward.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from flint import arb, fmpq

from certrack.core.errors import CertrackError

#: A power of t and a rate, of t^k e^(r t).
Growth = tuple[fmpq, fmpq]

CONSTANT: Growth = (fmpq(0), fmpq(0))
LINEAR: Growth = (fmpq(1), fmpq(0))

INFINITE = arb(float("inf"))

#: Slower rates count as none, and faster ones as this fast, so that no number has endless digits.
SLOWEST, FASTEST = 2.0**-40, 2**40

#: Terms of a sum; more are merged.
MAX_TERMS = 6

#: log t <= 8/e t^(1/8) for t >= 1.
LOG_POWER = fmpq(1, 8)


class Undefined(CertrackError, ArithmeticError):
    """A function may have no value on the interval, or jump there; the text says which."""


def ball(low: Any, high: Any) -> arb:
    """The interval from low to high, each perhaps itself an interval, or infinite."""
    return arb(low).union(arb(high))


def _rate(slope: arb) -> fmpq:
    """A rational that is not above a positive point, of few digits; zero if there is none."""
    if not (slope > SLOWEST):
        return fmpq(0)
    return fmpq(FASTEST) if slope > FASTEST else slope.fmpq()


def sech2(x: arb) -> arb:
    """1/cosh^2 x of a point x >= 0, which may be infinite."""
    small = (-2 * x).exp()
    return 4 * small / (1 + small) ** 2


@dataclass(frozen=True)
class Span:
    """Times a <= t <= b; b may be infinite.

    Attributes
    ----------
    begin, end : arb
        Points.
    """

    begin: arb
    end: arb
    _ranges: dict[Growth, tuple[arb, arb]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def is_endless(self) -> bool:
        """Whether it goes on for ever."""
        return not self.end.is_finite()

    def range_of(self, growth: Growth) -> tuple[arb, arb]:
        """Least and largest value of t^k e^(r t)."""
        if growth not in self._ranges:
            self._ranges[growth] = self._range_of(*growth)
        return self._ranges[growth]

    def _range_of(self, k: fmpq, r: fmpq) -> tuple[arb, arb]:
        values = [self._value(k, r, self.begin), self._limit(k, r)]
        if k * r < 0:
            turning = arb(-k / r)
            if not (turning < self.begin or turning > self.end):
                values.append(self._value(k, r, turning))
        return _least(v.lower() for v in values), _largest(v.upper() for v in values)

    def _limit(self, k: fmpq, r: fmpq) -> arb:
        if not self.is_endless:
            return self._value(k, r, self.end)
        order = r or k
        return INFINITE if order > 0 else arb(int(not order))

    def _value(self, k: fmpq, r: fmpq, t: arb) -> arb:
        if k and t == 0:
            return arb(0) if k > 0 else INFINITE
        power = (arb(k) * t.log()).exp() if k else arb(1)
        return power * (arb(r) * t).exp() if r else power


def _least(values: Any) -> arb:
    best = None
    for value in values:
        best = value if best is None or value < best else best
    assert best is not None
    return best


def _largest(values: Any) -> arb:
    return -_least(-value for value in values)


def _times(factor: arb, low: arb, high: arb) -> tuple[arb, arb]:
    """Ends of [factor] [low, high] with 0 <= low; zero times infinity is zero."""
    a, b = factor.lower(), factor.upper()

    def product(x: arb, y: arb) -> arb:
        return arb(0) if x == 0 or y == 0 else x * y

    least = product(a, high if a < 0 else low).lower()
    most = product(b, low if b < 0 else high).upper()
    return least, most


def _is_zero(factor: Any) -> bool:
    """Whether it is exactly zero; a ball that only contains zero is neither equal to it nor not."""
    return bool(factor == 0)


class GrowthEnclosure:
    """Encloses a function on a span.

    Parameters
    ----------
    span : Span
    terms : mapping
        Factor of each t^k e^(r t).
    """

    __slots__ = ("_ends", "span", "terms")

    def __init__(self, span: Span, terms: Mapping[Growth, Any]) -> None:
        self.span = span
        self.terms = {growth: factor for growth, factor in terms.items() if not _is_zero(factor)}
        self._ends: tuple[arb, arb] | None = None
        while len(self.terms) > MAX_TERMS:
            self._merge()

    def _merge(self) -> None:
        """Write the term that grows least by the growth of the next."""
        order = sorted(self.terms, key=lambda growth: (growth[1], growth[0]))
        (k, r), (m, s) = order[:2]
        low, high = _times(arb(self.terms.pop((k, r))), *self.span.range_of((k - m, r - s)))
        self.terms[m, s] = self.terms[m, s] + ball(low, high)

    def _constant(self, value: Any) -> GrowthEnclosure:
        return GrowthEnclosure(
            self.span, {CONSTANT: fmpq(value) if isinstance(value, int) else value}
        )

    # Arithmetic.

    def __add__(self, other: Any) -> GrowthEnclosure:
        other = other if isinstance(other, GrowthEnclosure) else self._constant(other)
        terms = dict(self.terms)
        for growth, factor in other.terms.items():
            terms[growth] = terms[growth] + factor if growth in terms else factor
        return GrowthEnclosure(self.span, terms)

    __radd__ = __add__

    def __neg__(self) -> GrowthEnclosure:
        return GrowthEnclosure(
            self.span, {growth: -factor for growth, factor in self.terms.items()}
        )

    def __sub__(self, other: Any) -> GrowthEnclosure:
        return self + (-other)

    def __rsub__(self, other: Any) -> GrowthEnclosure:
        return -self + other

    def __mul__(self, other: Any) -> GrowthEnclosure:
        if not isinstance(other, GrowthEnclosure):
            return GrowthEnclosure(
                self.span, {g: factor * other for g, factor in self.terms.items()}
            )
        terms: dict[Growth, Any] = {}
        for (k, r), factor in self.terms.items():
            for (m, s), second in other.terms.items():
                growth = (k + m, r + s)
                product = factor * second
                terms[growth] = terms[growth] + product if growth in terms else product
        return GrowthEnclosure(self.span, terms)

    __rmul__ = __mul__

    def __truediv__(self, divisor: int) -> GrowthEnclosure:
        return self * fmpq(1, divisor)

    def inverse(self) -> GrowthEnclosure:
        """1/f; Undefined where f may be zero."""
        if not self.span.is_endless and self.nonzero():
            return self._constant(1 / self.interval())
        (k, r), remainder = self._leading()
        if remainder is None or not (remainder > 0 or remainder < 0):
            raise Undefined("a denominator may be zero")
        return GrowthEnclosure(self.span, {(-k, -r): 1 / remainder})

    def _leading(self) -> tuple[Growth, arb | None]:
        """f = t^k e^(r t) B with the fastest growth of f: that growth, and the interval B."""
        if not self.terms:
            return CONSTANT, arb(0)
        k, r = max(self.terms, key=lambda growth: (growth[1], growth[0]))
        scaled = {(m - k, s - r): factor for (m, s), factor in self.terms.items()}
        low, high = self._sum(scaled)
        return (k, r), ball(low, high) if low.is_finite() and high.is_finite() else None

    def _sum(self, terms: Mapping[Growth, Any]) -> tuple[arb, arb]:
        low, high = arb(0), arb(0)
        for growth, factor in terms.items():
            least, most = _times(arb(factor), *self.span.range_of(growth))
            low, high = low + least, high + most
        ends = low.lower(), high.upper()
        return (
            ends[0] if not ends[0].is_nan() else -INFINITE,
            ends[1] if not ends[1].is_nan() else INFINITE,
        )

    # Its values.

    def ends(self) -> tuple[arb, arb]:
        """A lower and an upper bound, perhaps infinite."""
        if self._ends is None:
            low, high = self._sum(self.terms)
            growth, remainder = self._leading()
            if len(self.terms) > 1 and remainder is not None:
                least, most = _times(remainder, *self.span.range_of(growth))
                low = least if least > low else low
                high = most if most < high else high
            self._ends = low, high
        return self._ends

    def interval(self) -> arb:
        """All values in one ball, which may be infinite."""
        return ball(*self.ends())

    def nonzero(self) -> bool:
        """Whether no value is zero, and all have one sign."""
        low, high = self.ends()
        return bool(low > 0 or high < 0)

    # Functions.

    def monotone(self, function: Callable[[arb], arb]) -> GrowthEnclosure:
        """An increasing function that is bounded, or infinite, at infinity."""
        low, high = self.ends()
        return self._constant(ball(function(low).lower(), function(high).upper()))

    def exp(self) -> GrowthEnclosure:
        """e^f."""
        rate = self.terms.get(LINEAR, fmpq(0))
        remainder = GrowthEnclosure(self.span, {g: v for g, v in self.terms.items() if g != LINEAR})
        low, high = remainder.ends()
        if isinstance(rate, fmpq) and low.is_finite() and high.is_finite():
            return GrowthEnclosure(self.span, {(fmpq(0), rate): ball(low, high).exp()})
        decay = _rate(-self._per_time().ends()[1])
        if decay:
            return GrowthEnclosure(self.span, {(fmpq(0), -decay): ball(0, 1)})
        top = self.ends()[1]
        return self._constant(ball(0, top.exp().upper() if top.is_finite() else INFINITE))

    def _per_time(self) -> GrowthEnclosure:
        """f/t."""
        return GrowthEnclosure(self.span, {(k - 1, r): v for (k, r), v in self.terms.items()})

    def log(self) -> GrowthEnclosure:
        """log f of a positive f."""
        (k, r), remainder = self._leading()
        if remainder is None or not remainder > 0:
            if self.ends()[0] > 0:
                low, high = self.ends()
                top = high.log().upper() if high.is_finite() else INFINITE
                return self._constant(ball(low.log().lower(), top))
            raise Undefined("the argument of log may be zero or negative")
        total = GrowthEnclosure(self.span, {CONSTANT: remainder.log(), LINEAR: r})
        if not k:
            return total
        if not self.span.is_endless and self.span.begin > 0:
            return total + k * ball(self.span.begin.log(), self.span.end.log())
        if self.span.begin >= 1:
            size = ball(0, 8 * arb(-1).exp())
            return total + GrowthEnclosure(self.span, {(LOG_POWER, fmpq(0)): k * size})
        raise Undefined("the argument of log may be zero or negative")

    def power(self, exponent: fmpq) -> GrowthEnclosure:
        """f^exponent of a positive f."""
        (k, r), remainder = self._leading()
        if remainder is not None and remainder > 0:
            factor = (arb(exponent) * remainder.log()).exp()
            return GrowthEnclosure(self.span, {(k * exponent, r * exponent): factor})
        low, high = self.ends()
        if not (low > 0 and high.is_finite()):
            raise Undefined("the base of a power that is no integer may be zero or negative")
        return self._constant((arb(exponent) * ball(low, high).log()).exp())

    def tanh(self) -> GrowthEnclosure:
        """tanh f, near 1 or -1 where f grows."""
        low, high = self._per_time().ends()
        for sign, slope in ((1, low), (-1, -high)):
            if rate := _rate(slope):  # 1 - 2/(1 + e^2f) >= 1 - 2 e^(-2 rate t)
                near = GrowthEnclosure(self.span, {(fmpq(0), -2 * rate): ball(0, 2)})
                return sign * (1 - near)
        return self.monotone(arb.tanh)

    def sech2(self) -> GrowthEnclosure:
        """1/cosh^2 f."""
        low, high = self._per_time().ends()
        if rate := _rate(low) or _rate(-high):  # <= 4 e^(-2 rate t)
            return GrowthEnclosure(self.span, {(fmpq(0), -2 * rate): ball(0, 4)})
        low, high = self.ends()
        near = arb(0) if not self.nonzero() else _least([abs(low), abs(high)])
        far = _largest([abs(low), abs(high)])
        return self._constant(ball(sech2(far), sech2(near)))
