"""Proofs of |f(t, x)| <= a ||x|| + b for all t >= 0 and all states: Assumption 1 without samples.

A *majorant* of f is a polynomial with coefficients >= 0 in s = ||x|| (Euclidean) that is never
below |f|. Majorants of sums and products are sums and products; a bounded function has its bound as
well as what its argument gives, so a formula has several, none of which need be the smallest.
Coefficients are exact fractions, roots of them are rounded up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import islice, product
from typing import Any

import sympy
from mpmath import iv, mp

from certrack.certificates.intervals import enclosure
from certrack.core.expressions import TIME
from certrack.references.supremum import sinusoid_supremum

#: Coefficients of 1, s, s^2 ...
Majorant = tuple[Fraction, ...]

#: So many majorants of a formula are kept, and combinations of those of its parts are tried.
MAX_KEPT, MAX_TRIED = 8, 512

#: Powers beyond this are not multiplied out: no bound of Assumption 1 comes of them.
MAX_DEGREE = 8

#: Roots are rounded up to so many binary digits after the point.
ROOT_BITS = 100

#: |f(z)| <= |z|, and |f(u^2)| <= c u for all u >= 0: sup of log(1 + u^2)/u is 0.8048 (u = 1.98), of
#: atan(u^2)/u 0.8038; sin and tanh are at most min(1, u^2) <= u.
ROOT_FACTORS: dict[Any, Fraction] = {
    sympy.sin: Fraction(1),
    sympy.tanh: Fraction(1),
    sympy.atan: Fraction(81, 100),
    sympy.log: Fraction(81, 100),
}


def whole_space(
    states: Sequence[sympy.Symbol], region: Sequence[Fraction] | None = None
) -> dict[sympy.Symbol, Any]:
    """All states, or those with |x_i| <= region_i, and all t >= 0, as intervals."""
    if region is None:
        sizes = [iv.mpf(["-inf", "inf"])] * len(states)
    else:
        sizes = [iv.mpf([-1, 1]) * r.numerator / r.denominator for r in region]
    return {TIME: iv.mpf([0, "inf"]), **dict(zip(states, sizes, strict=True))}


def interval_ends(
    formula: sympy.Expr, box: Mapping[sympy.Symbol, Any]
) -> tuple[float | Fraction, float | Fraction]:
    """Ends between which the formula lies on the box, infinite where no rule bounds it."""
    try:
        values = enclosure(formula, box)
    except (ArithmeticError, ValueError, TypeError, NotImplementedError):
        return -math.inf, math.inf
    return _exact(values.a), _exact(values.b)


def _exact(end: Any) -> float | Fraction:
    value = mp.mpf(end)
    if not mp.isfinite(value):
        return float(value)
    sign, mantissa, exponent, _ = value._mpf_
    return (-1) ** sign * Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def majorants(formula: sympy.Expr, states: Sequence[sympy.Symbol]) -> list[Majorant]:
    """Majorants of a formula of t and the states, the lowest degrees first; empty if none is known.

    Parameters
    ----------
    formula : sympy.Expr
        Without other symbols.
    states : symbols
        All of them: s is the norm of this vector.

    Examples
    --------
    >>> import sympy
    >>> x = sympy.symbols("x1 x2", real=True)
    >>> majorants(3 * x[0] + 4 * x[1], x)
    [(Fraction(0, 1), Fraction(5, 1))]
    """
    return _Majorants(states).of(formula)


def covers(
    candidates: Sequence[Majorant],
    gamma: Fraction,
    beta: Fraction,
    strength: Fraction = Fraction(1),
) -> bool:
    """Whether one of the majorants, times the strength, proves |f| <= gamma s + beta."""
    limits = (beta, gamma)
    return any(
        all(strength * c <= (limits[i] if i < 2 else 0) for i, c in enumerate(majorant))
        for majorant in candidates
    )


class _Majorants:
    """Majorants of the parts of one formula."""

    def __init__(self, states: Sequence[sympy.Symbol]) -> None:
        self.states, self.box = frozenset(states), whole_space(states)
        self._known: dict[sympy.Expr, list[Majorant]] = {}

    def of(self, f: sympy.Expr) -> list[Majorant]:
        if f not in self._known:
            self._known[f] = _best([*self._by_interval(f), *self._by_rule(f)])
        return self._known[f]

    def _by_interval(self, f: sympy.Expr) -> Iterator[Majorant]:
        low, high = interval_ends(f, self.box)
        if isinstance(low, Fraction) and isinstance(high, Fraction):
            yield (max(abs(low), abs(high)),)
        if isinstance(f, sympy.Add) and f.free_symbols == {TIME}:
            wave = sinusoid_supremum(f)
            if wave is not None:
                yield (Fraction(wave[0]),)

    def _by_rule(self, f: sympy.Expr) -> Iterator[Majorant]:
        if f in self.states:
            yield (Fraction(0), Fraction(1))
        elif f.is_Rational:
            yield (abs(Fraction(int(f.p), int(f.q))),)
        elif isinstance(f, sympy.Add):
            yield from self._sum(f)
        elif isinstance(f, sympy.Mul):
            for parts in _combinations([self.of(arg) for arg in f.args]):
                result: Majorant = (Fraction(1),)
                for part in parts:
                    result = _times(result, part)
                if len(result) <= MAX_DEGREE + 1:
                    yield result
        elif isinstance(f, sympy.Pow):
            yield from self._power(f)
        elif isinstance(f, (sympy.sin, sympy.cos, sympy.sign)):
            yield (Fraction(1),)
            if isinstance(f, sympy.sin):
                yield from self._below_argument(f.func, f.args[0])
        elif isinstance(f, (sympy.tanh, sympy.atan)):
            yield from self._below_argument(f.func, f.args[0])
        elif isinstance(f, sympy.log):
            yield from self._logarithm(f.args[0])
        elif isinstance(f, sympy.Abs):
            yield from self.of(f.args[0])
        elif isinstance(f, (sympy.Min, sympy.Max)):
            for parts in _combinations([self.of(arg) for arg in f.args]):
                width = max(map(len, parts))
                yield tuple(
                    max(p[i] if i < len(p) else Fraction(0) for p in parts) for i in range(width)
                )

    def _below_argument(self, function: Any, argument: sympy.Expr) -> Iterator[Majorant]:
        """|f(z)| <= |z|, and <= c sqrt(p) s where |z| <= p s^2."""
        for majorant in self.of(argument):
            yield majorant
            if len(majorant) == 3 and not any(majorant[:2]):
                yield (Fraction(0), ROOT_FACTORS[function] * root_above(majorant[2]))

    def _logarithm(self, argument: sympy.Expr) -> Iterator[Majorant]:
        """log(c + z) <= log(c) + log(1 + z/c) for c >= 1, z >= 0."""
        offset, z = argument.as_coeff_Add()
        if not (offset.is_Rational and offset >= 1 and self._nonnegative(z)):
            return
        extra = (Fraction(0),) if offset == 1 else (_logarithm_above(offset),)
        for majorant in self._below_argument(sympy.log, z / offset):
            yield _plus(majorant, extra)

    def _power(self, f: sympy.Pow) -> Iterator[Majorant]:
        base, exponent = f.args
        if not (exponent.is_Rational and exponent > 0 and exponent.q in (1, 2)):
            return
        for majorant in self.of(base):
            part = majorant if exponent.q == 1 else _root_of(majorant)
            if part is not None and int(exponent.p) * (len(part) - 1) <= MAX_DEGREE:
                result: Majorant = (Fraction(1),)
                for _ in range(int(exponent.p)):
                    result = _times(result, part)
                yield result

    def _sum(self, f: sympy.Add) -> Iterator[Majorant]:
        """Linear terms by their Euclidean norm, squares by the largest; roots less their offset."""
        linear: dict[sympy.Expr, Fraction] = {}
        squares = constant = Fraction(0)
        others: list[list[Majorant]] = []
        for term in f.args:
            number, factor = term.as_coeff_Mul()
            if not number.is_Rational:
                number, factor = sympy.S.One, term
            c = Fraction(int(number.p), int(number.q))
            if factor == 1:
                constant += c
            elif (
                state := factor.args[0] if isinstance(factor, sympy.Abs) else factor
            ) in self.states:
                linear[state] = linear.get(state, Fraction(0)) + abs(c)
            elif isinstance(factor, sympy.Pow) and factor.exp == 2 and factor.base in self.states:
                squares = max(squares, abs(c))
            else:
                offset, candidates = self._root_less_offset(factor)
                constant += c * offset
                others.append([_times((abs(c),), majorant) for majorant in candidates])
        norm = root_above(sum((c**2 for c in linear.values()), Fraction(0)))
        direct: Majorant = (abs(constant), norm, squares)
        for parts in _combinations(others):
            result = direct
            for part in parts:
                result = _plus(result, part)
            yield result

    def _root_less_offset(self, f: sympy.Expr) -> tuple[Fraction, list[Majorant]]:
        """sqrt(z + d) = sqrt(d) + r, 0 <= r <= sqrt(z), where z >= 0 and sqrt(d) is rational."""
        if isinstance(f, sympy.Pow) and f.exp == sympy.S.Half:
            d, z = f.base.as_coeff_Add()
            root = sympy.sqrt(d) if d.is_Rational and d > 0 else None
            if root is not None and root.is_Rational and self._nonnegative(z):
                return Fraction(int(root.p), int(root.q)), self.of(sympy.sqrt(z))
        return Fraction(0), self.of(f)

    def _nonnegative(self, f: sympy.Expr) -> bool:
        return interval_ends(f, self.box)[0] >= 0


def _combinations(choices: list[list[Majorant]]) -> Iterator[tuple[Majorant, ...]]:
    return islice(product(*choices), MAX_TRIED)


def _plus(a: Majorant, b: Majorant) -> Majorant:
    width = max(len(a), len(b))
    return tuple(
        (a[i] if i < len(a) else Fraction(0)) + (b[i] if i < len(b) else Fraction(0))
        for i in range(width)
    )


def _times(a: Majorant, b: Majorant) -> Majorant:
    result = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, p in enumerate(a):
        for j, q in enumerate(b):
            result[i + j] += p * q
    return tuple(result)


def root_above(square: Fraction) -> Fraction:
    """Square root, exact where it is rational, else rounded up."""
    p, q = math.isqrt(square.numerator), math.isqrt(square.denominator)
    if p * p == square.numerator and q * q == square.denominator:
        return Fraction(p, q)
    scaled = (square.numerator << 2 * ROOT_BITS) // square.denominator
    return Fraction(math.isqrt(scaled) + 1, 1 << ROOT_BITS)


def _logarithm_above(number: sympy.Rational) -> Fraction:
    """A fraction not below the logarithm."""
    end = _exact(iv.log(iv.mpf(int(number.p)) / iv.mpf(int(number.q))).b)
    assert isinstance(end, Fraction)
    return end


def _root_of(majorant: Majorant) -> Majorant | None:
    """sqrt(b + a s + p s^2) <= sqrt(b) + m s, m = max(sqrt(p), a/(2 sqrt(b)))."""
    b, a, p, *higher = (*majorant, Fraction(0), Fraction(0), Fraction(0))[: max(3, len(majorant))]
    if any(higher) or (a and not b):
        return None
    slope = root_above(p)
    if a:
        low = Fraction(math.isqrt((b.numerator << 2 * ROOT_BITS) // b.denominator), 1 << ROOT_BITS)
        if not low:
            return None
        slope = max(slope, a / (2 * low))
    return (root_above(b), slope)


def _best(candidates: list[Majorant]) -> list[Majorant]:
    """Without those that another one beats in every coefficient; the lowest degrees first."""
    best: list[Majorant] = []
    for majorant in sorted({_trimmed(m) for m in candidates}, key=lambda m: (len(m), m[::-1])):
        if not any(_below(other, majorant) for other in best):
            best.append(majorant)
    return best[:MAX_KEPT]


def _trimmed(majorant: Majorant) -> Majorant:
    end = len(majorant)
    while end > 1 and not majorant[end - 1]:
        end -= 1
    return majorant[:end]


def _below(a: Majorant, b: Majorant) -> bool:
    return len(a) <= len(b) and all(p <= q for p, q in zip(a, b, strict=False))
