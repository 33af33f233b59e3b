"""Floats that stand for rationals, and floats on a chosen side of a number.

A number of a system file is the rational of its text: 1/3 is no float, nor is a decimal of 20
digits. Computations take the nearest float, proofs the rational.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import sympy

#: Digits with which an irrational number is compared with a float, which has 17.
COMPARED_DIGITS = 80

#: Beyond these a literal is taken by its float: its rational would be of any length.
LONGEST_LITERAL, SMALLEST_LITERAL = 200, 1e-300

#: Longer integers are written in groups of so many digits: a file holds none beyond 1e300.
DIGITS_AT_ONCE = 200


class RationalFloat(float):
    """The float nearest to a rational that its own decimal text is not.

    It equals what stands for the same rational only: what is proven of a system with the one is not
    proven of a system with the other.

    Parameters
    ----------
    exact : Fraction

    Attributes
    ----------
    exact : Fraction
        What the user wrote.
    """

    exact: Fraction

    def __new__(cls, exact: Fraction) -> RationalFloat:
        """The nearest float, with the rational."""
        self = super().__new__(cls, exact.numerator / exact.denominator)
        self.exact = exact
        return self

    def __eq__(self, other: object) -> bool:
        """Whether both stand for the same rational."""
        return isinstance(other, RationalFloat) and self.exact == other.exact

    def __ne__(self, other: object) -> bool:
        """Whether they stand for different ones; a float's own would compare the floats."""
        return not self == other

    __hash__ = float.__hash__

    def __reduce__(self) -> tuple[type[RationalFloat], tuple[Fraction]]:
        """For copies and for pickle."""
        return RationalFloat, (self.exact,)

    @property
    def text(self) -> str:
        """The rational as a formula that a system file can hold."""
        (top, high), (bottom, low) = map(_grouped, self.exact.as_integer_ratio())
        power = f"1e{DIGITS_AT_ONCE}"
        return f"{top}/{bottom}" + f"*{power}" * (high - low) + f"/{power}" * (low - high)


def _grouped(value: int) -> tuple[str, int]:
    """An integer as a formula of integers that a file may hold, over a power of the group's size.

    >>> _grouped(-12), _grouped(10**400)
    (('-12', 0), ('(1 + (0 + 0/1e200)/1e200)', 2))
    """
    groups, remaining = [], abs(value)
    while remaining >= 10**DIGITS_AT_ONCE:
        remaining, group = divmod(remaining, 10**DIGITS_AT_ONCE)
        groups.append(group)
    if not groups:
        return str(value), 0
    text = str(groups[0])
    for group in (*groups[1:], remaining):
        text = f"({group} + {text}/1e{DIGITS_AT_ONCE})"
    return f"{'-' * (value < 0)}{text}", len(groups)


def exact_rational(value: float) -> Fraction:
    """The rational that a finite float stands for: that of its decimal text unless it knows one."""
    return value.exact if isinstance(value, RationalFloat) else Fraction(repr(float(value)))


def nearest_float(exact: Fraction) -> float:
    """The float nearest to a rational, which keeps it where the float's decimal text does not."""
    near = exact.numerator / exact.denominator
    return near if Fraction(repr(near)) == exact else RationalFloat(exact)


def float_of(expr: sympy.Expr) -> float:
    """The float nearest to a constant formula; of a rational, one that stands for it."""
    if expr.is_Rational:
        return nearest_float(Fraction(int(expr.p), int(expr.q)))
    return float(expr)


def decimal_float(text: str) -> float:
    """The float of a decimal literal, standing for all of its digits."""
    value = float(text)
    sane = len(text) <= LONGEST_LITERAL and SMALLEST_LITERAL <= abs(value) < math.inf
    return nearest_float(Fraction(text)) if sane else value


def float_above(value: Any) -> float:
    """The smallest float not below a number, a constant formula or a Fraction.

    Neither its binary value nor its decimal text is below.
    """
    exact = _symbolic(value)
    exact = exact if exact.is_Rational else sympy.N(exact, COMPARED_DIGITS)
    near = float(exact)
    while min(sympy.Rational(*near.as_integer_ratio()), sympy.Rational(repr(near))) < exact:
        near = math.nextafter(near, math.inf)
    return near


def float_below(value: Any) -> float:
    """The largest float that is not above a number."""
    return -float_above(-_symbolic(value))


def stated_above(value: float) -> float:
    """The smallest float that is not below what a float stands for."""
    return float_above(exact_rational(value))


def _symbolic(value: Any) -> sympy.Expr:
    if isinstance(value, Fraction):
        return sympy.Rational(value.numerator, value.denominator)
    return value


def exactly_positive_definite(matrix: Sequence[Sequence[Fraction]]) -> bool:
    """Whether a symmetric matrix of rationals is positive definite: exactly, by its pivots."""
    scale = math.lcm(*(entry.denominator for row in matrix for entry in row))
    rows = [[int(entry * scale) for entry in row] for row in matrix]
    last = 1  # Bareiss: every division is exact, and a pivot is a leading determinant
    for k in range(len(rows)):
        pivot = rows[k][k]
        if pivot <= 0:
            return False
        for i in range(k + 1, len(rows)):
            rows[i] = [
                (pivot * rows[i][j] - rows[i][k] * rows[k][j]) // last for j in range(len(rows))
            ]
        last = pivot
    return True
