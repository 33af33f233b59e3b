"""Taylor coefficients of a formula, enclosed for all t of an interval at once.

A formula's coefficients are f^(k)(t)/k!, k = 0 ... m, each a rational, a ball of Arb, or an
:class:`~certrack.references.growth.GrowthEnclosure`; the rules are those of automatic
differentiation. A value that may not exist raises Undefined; a derivative that may not is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy
from flint import arb, fmpq

from certrack.core.expressions import TIME
from certrack.core.powers import ConstantPower
from certrack.references.growth import GrowthEnclosure, Undefined, ball, sech2

#: Taylor coefficients, from the value on.
Series = list[Any]

UNKNOWN = arb("nan")
ONE = ball(-1, 1)


@dataclass
class Evaluation:
    """Coefficients of formulas, with min and max written by abs, on one interval.

    Parameters
    ----------
    time : arb or GrowthEnclosure
        All times of the interval.
    order : int
        Highest coefficient.
    phases : mapping
        Argument wt + r of a sine -> wt modulo 2 pi, and r, where the phase is told apart from t.
    smooth : bool
        Raise Undefined also where a derivative may not exist, except at kinks.
    """

    time: Any
    order: int
    phases: Mapping[sympy.Expr, tuple[arb, sympy.Expr]] = field(default_factory=dict)
    smooth: bool = False

    def __post_init__(self) -> None:
        self._known: dict[sympy.Expr, Series] = {
            TIME: self._padded([self.time, fmpq(1)][: self.order + 1])
        }

    def series(self, expr: sympy.Expr) -> Series:
        """Taylor coefficients of a formula of t.

        Raises
        ------
        Undefined
            Where a part of it may have no value.
        """
        if expr not in self._known:
            self._known[expr] = self._build(expr)
        return self._known[expr]

    @property
    def work(self) -> int:
        """About how many operations it took."""
        coefficients = (value for series in self._known.values() for value in series)
        costs = (
            8 + 8 * len(v.terms) ** 2 if isinstance(v, GrowthEnclosure) else 1 for v in coefficients
        )
        return (self.order + 1) * sum(costs)

    def _padded(self, head: Series) -> Series:
        return [*head, *[fmpq(0)] * (self.order + 1 - len(head))]

    def _build(self, expr: sympy.Expr) -> Series:
        if not expr.args:
            return self._padded([constant(expr)])
        if isinstance(expr, sympy.Pow):
            return self._power(*expr.args)
        parts = [self.series(arg) for arg in expr.args]
        if isinstance(expr, sympy.Add):
            return [sum(column[1:], column[0]) for column in zip(*parts, strict=True)]
        if isinstance(expr, sympy.Mul):
            product = parts[0]
            for part in parts[1:]:
                product = self._product(product, part)
            return product
        rule = RULES.get(expr.func)
        if rule is None:
            raise Undefined(f"{expr.func.__name__} may jump")
        result: Series = getattr(self, rule)(parts[0], expr.args[0])
        return result

    # Arithmetic.

    def _product(self, a: Series, b: Series) -> Series:
        if a is b:
            return self._square(a)
        return [_dot(a[: k + 1], b[: k + 1][::-1]) for k in range(self.order + 1)]

    def _square(self, a: Series) -> Series:
        others = [_dot(a[: k + 1], a[: k + 1][::-1]) for k in range(1, self.order + 1)]
        return [_integer_power(a[0], 2), *others]

    def _quotient(self, a: Series, b: Series) -> Series:
        over = _inverse(b[0])
        q: Series = []
        for k in range(self.order + 1):
            q.append((a[k] - _dot(b[1 : k + 1], q[::-1])) * over)
        return q

    def _power(self, base: sympy.Expr, exponent: sympy.Expr) -> Series:
        a = self.series(base)
        if exponent.is_Integer:
            if exponent < 0:
                one = self._padded([fmpq(1)])
                return self._quotient(one, self._integer_power(a, -int(exponent)))
            return self._integer_power(a, int(exponent))
        if not exponent.is_number:
            raise Undefined("an exponent depends on t")
        e = constant(exponent)
        if not _positive(a[0]):
            return self._power_at_zero(a[0], base, e)
        p = [_power_of(a[0], e)]
        over = _inverse(a[0])
        for k in range(1, self.order + 1):
            terms = (((e * i) - (k - i)) * _dot([a[i]], [p[k - i]]) for i in range(1, k + 1))
            p.append(sum(terms, fmpq(0)) * over / k)
        return p

    def _power_at_zero(self, base: Any, expr: sympy.Expr, exponent: Any) -> Series:
        """A base that may be zero, but not negative: a value, but no derivative."""
        never_negative = isinstance(expr, (sympy.Abs, sympy.Max)) and expr.is_nonnegative
        if self.smooth or not (
            never_negative and exponent > 0 and not isinstance(base, GrowthEnclosure)
        ):
            raise Undefined("the base of a power that is no integer may be zero or negative")
        top = _power_of(arb(base).abs_upper(), exponent)
        return [ball(0, top.upper()), *[UNKNOWN] * self.order]

    def _integer_power(self, a: Series, n: int) -> Series:
        result: Series | None = None
        square = a
        exponent = n
        while exponent:
            if exponent & 1:
                result = square if result is None else self._product(result, square)
            exponent >>= 1
            if exponent:
                square = self._square(square)
        assert result is not None
        return [_integer_power(a[0], n), *result[1:]]

    # Functions: each is told its argument as a formula, too.

    def _exp(self, a: Series, _: sympy.Expr) -> Series:
        e = [_value(a[0]).exp()]
        for k in range(1, self.order + 1):
            e.append(_dot([i * a[i] for i in range(1, k + 1)], e[::-1]) / k)
        return e

    def _log(self, a: Series, _: sympy.Expr) -> Series:
        if not _positive(a[0]):
            raise Undefined("the argument of log may be zero or negative")
        logs, over = [_value(a[0]).log()], _inverse(a[0])
        for k in range(1, self.order + 1):
            inner = _dot([i * logs[i] for i in range(1, k)], a[1:k][::-1])
            logs.append((a[k] - inner / k) * over)
        return logs

    def _sin(self, a: Series, arg: sympy.Expr) -> Series:
        return self._sine_and_cosine(a, arg)[0]

    def _cos(self, a: Series, arg: sympy.Expr) -> Series:
        return self._sine_and_cosine(a, arg)[1]

    def _sine_and_cosine(self, a: Series, arg: sympy.Expr) -> tuple[Series, Series]:
        angle = _value(a[0])
        if arg in self.phases:
            phase, offset = self.phases[arg]
            angle = phase + self.series(offset)[0]
        if isinstance(angle, GrowthEnclosure):
            angle = angle.interval()
        s, c = ([v] if v.is_finite() else [ONE] for v in (angle.sin(), angle.cos()))
        slopes = [i * a[i] for i in range(1, self.order + 1)]
        for k in range(1, self.order + 1):
            s_k, c_k = (_dot(slopes[:k], v[::-1]) / k for v in (c, s))
            s.append(s_k)
            c.append(-c_k)
        return s, c

    def _tan(self, a: Series, _: sympy.Expr) -> Series:
        angle = _value(a[0])
        angle = angle.interval() if isinstance(angle, GrowthEnclosure) else angle
        cosine = angle.cos()  # has one sign on the whole interval, which thus has no pole
        if not (cosine > 0 or cosine < 0):
            raise Undefined("tan may have a pole")
        return self._riccati(a, angle.tan(), 1 / _integer_power(cosine, 2), 1)

    def _tanh(self, a: Series, _: sympy.Expr) -> Series:
        x = _value(a[0])
        if isinstance(x, GrowthEnclosure):
            return self._riccati(a, x.tanh(), x.sech2(), -1)
        slope = ball(sech2(x.abs_upper()), sech2(x.abs_lower()))
        return self._riccati(a, x.tanh(), slope, -1)

    def _riccati(self, a: Series, value: Any, slope: Any, sign: int) -> Series:
        """u = tan f (sign 1) or tanh f (sign -1): u' = w f', w = 1 + sign u^2."""
        u, w = [value], [slope]
        for k in range(1, self.order + 1):
            u.append(_dot([i * a[i] for i in range(1, k + 1)], w[::-1]) / k)
            w.append(sign * _dot(u, u[::-1]))
        return u

    def _sinh(self, a: Series, arg: sympy.Expr) -> Series:
        return self._half_sum(a, arg, -1)

    def _cosh(self, a: Series, arg: sympy.Expr) -> Series:
        return self._half_sum(a, arg, 1)

    def _half_sum(self, a: Series, arg: sympy.Expr, sign: int) -> Series:
        up, down = self._exp(a, arg), self._exp([-v for v in a], arg)
        total = [(x + sign * y) / 2 for x, y in zip(up, down, strict=True)]
        if not isinstance(
            total[0], GrowthEnclosure
        ):  # tighter where e^f and e^-f depend on each other
            x = _value(a[0])
            total[0] = x.cosh() if sign > 0 else x.sinh()
        return total

    def _atan(self, a: Series, _: sympy.Expr) -> Series:
        x = _value(a[0])
        u = [x.monotone(arb.atan) if isinstance(x, GrowthEnclosure) else x.atan()]
        q = self._square(a)
        q[0] = q[0] + 1
        return self._integrated(u, a, q)

    def _asin(self, a: Series, arg: sympy.Expr) -> Series:
        x = _value(a[0])
        x = x.interval() if isinstance(x, GrowthEnclosure) else x
        inside = bool(abs(x) < 1)
        if not inside and (self.smooth or not _is_part_of_sine(arg)):
            raise Undefined("the argument of asin or acos may reach 1 or -1")
        if not inside:
            low, high = x.lower(), x.upper()
            ends = (low if low > -1 else arb(-1)), (high if high < 1 else arb(1))
            return [ball(ends[0].asin(), ends[1].asin()), *[UNKNOWN] * self.order]
        w = self._square(a)
        w = [1 - w[0], *[-v for v in w[1:]]]
        root = [_power_of(w[0], fmpq(1, 2))]
        for k in range(1, self.order + 1):
            root.append((w[k] - _dot(root[1:k], root[1:k][::-1])) * _inverse(2 * root[0]))
        return self._integrated([x.asin()], a, root)

    def _acos(self, a: Series, arg: sympy.Expr) -> Series:
        u = self._asin(a, arg)
        return [arb.pi() / 2 - u[0], *[-v for v in u[1:]]]

    def _integrated(self, u: Series, a: Series, q: Series) -> Series:
        """u with q u' = a'."""
        over = _inverse(q[0]) if self.order else fmpq(1)
        for k in range(1, self.order + 1):
            inner = _dot([i * u[i] for i in range(1, k)], q[1:k][::-1])
            u.append((k * a[k] - inner) * over / k)
        return u

    def _abs(self, a: Series, _: sympy.Expr) -> Series:
        x = _value(a[0])
        low, high = x.ends() if isinstance(x, GrowthEnclosure) else (x.lower(), x.upper())
        if low > 0 or high < 0:
            return a if low > 0 else [-v for v in a]
        top = -low if -low > high else high
        slope = [_between(a[1])] if self.order else []
        return [ball(0, top), *slope, *[UNKNOWN] * (self.order - 1)]


#: What computes the series of a function of one argument.
RULES: dict[Any, str] = {
    sympy.exp: "_exp",
    sympy.log: "_log",
    sympy.sin: "_sin",
    sympy.cos: "_cos",
    sympy.tan: "_tan",
    sympy.sinh: "_sinh",
    sympy.cosh: "_cosh",
    sympy.tanh: "_tanh",
    sympy.asin: "_asin",
    sympy.acos: "_acos",
    sympy.atan: "_atan",
    sympy.Abs: "_abs",
}


def constant(expr: sympy.Expr) -> Any:
    """A number as a rational, or as a ball around it."""
    if expr.is_Rational:
        return fmpq(int(expr.p), int(expr.q))
    if expr is sympy.pi:
        return arb.pi()
    if expr is sympy.E:
        return arb(1).exp()
    if isinstance(expr, ConstantPower):
        if expr.exponent == 1:
            return constant(expr.base)
        return (_value(constant(expr.exponent)) * _value(constant(expr.base)).log()).exp()
    if not expr.args:
        raise Undefined(f"{expr} has no value")
    return Evaluation(arb(0), 0).series(expr)[0]


def _value(x: Any) -> Any:
    """Rationals as balls."""
    return arb(x) if isinstance(x, fmpq) else x


def _dot(a: Series, b: Series) -> Any:
    """Sum of products; what is exactly zero does not count, whatever it is multiplied by."""
    total: Any = fmpq(0)
    for x, y in zip(a, b, strict=False):
        if not (x == 0 or y == 0):
            total = total + x * y
    return total


def _inverse(x: Any) -> Any:
    if isinstance(x, GrowthEnclosure):
        return x.inverse()
    if not (x > 0 or x < 0):
        raise Undefined("a denominator may be zero")
    return 1 / x


def _positive(x: Any) -> bool:
    return bool((x.ends()[0] if isinstance(x, GrowthEnclosure) else x) > 0)


def _power_of(x: Any, exponent: Any) -> Any:
    """x^exponent of a positive x."""
    if isinstance(x, GrowthEnclosure):
        return x.power(exponent) if isinstance(exponent, fmpq) else (x.log() * exponent).exp()
    x = arb(x)
    return x.sqrt() if exponent == fmpq(1, 2) else (arb(exponent) * x.log()).exp()


def _integer_power(x: Any, n: int) -> Any:
    """x^n, n > 0: not negative where n is even."""
    if isinstance(x, fmpq):
        return x**n
    if isinstance(x, GrowthEnclosure):
        power = x
        for _ in range(n - 1):
            power = power * x
        return power
    if n % 2:
        low, high = x.lower(), x.upper()
        return ball(_of_point(low, n), _of_point(high, n))
    return ball(_of_point(x.abs_lower(), n), _of_point(x.abs_upper(), n))


def _of_point(x: arb, n: int) -> arb:
    power = arb(1)
    for _ in range(n):
        power = power * x
    return power


def _between(slope: Any) -> Any:
    """All between -slope and slope."""
    return ONE * slope


def _is_part_of_sine(arg: sympy.Expr) -> bool:
    """Whether this is c sin(...) or c cos(...) with |c| <= 1."""
    factor, wave = arg.as_coeff_Mul()
    return isinstance(wave, (sympy.sin, sympy.cos)) and abs(factor) <= 1
