"""Powers of numbers that SymPy would compute for minutes, kept as what they are.

SymPy takes integer roots out of 4.076**0.0000001: it raises the prime factors of 1019/250 to the
ten-millionth power first, and does so again whenever two such powers meet in a product. Roots other
than square roots therefore become a :class:`ConstantPower`, which SymPy takes for a number like pi:
real, positive, of any precision that is asked for.

For the same reason the exponent of x**0.123456789 is one. As a rational it makes a formula a
polynomial in the 10^9th root of x wherever SymPy asks for a common divisor, which fills the memory,
and it asks whenever it makes a function of the formula anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sympy
from mpmath import mp
from sympy.core.evalf import PrecisionExhausted

#: Bits of the numerator and denominator of any constant: larger powers are not computed.
MAX_BITS = 20_000

#: Roots beyond this one are fine: x**(1/65) is written with an exponent that is no rational.
FINEST_ROOT = 64

#: Digits of a base that must be known, if it is to be positive.
SIGN_DIGITS = 15

#: Bits by which a base is known better than its power: those of its exponent, and some.
GUARD_BITS = 40


class ConstantPower(sympy.NumberSymbol):
    """A positive number to a power that is no integer, as a number of its own.

    Parameters
    ----------
    base : positive number
    exponent : number
        1 for an exponent of a fine root, which is the base itself.
    """

    __slots__ = ("base", "exponent")

    is_commutative = True
    is_real = True
    is_positive = True
    is_finite = True
    is_irrational = None

    def __new__(cls, base: sympy.Expr, exponent: sympy.Expr) -> ConstantPower:
        self = sympy.AtomicExpr.__new__(cls)
        self.base, self.exponent = base, exponent
        return self

    def __getnewargs__(self) -> tuple[sympy.Expr, sympy.Expr]:
        return self.base, self.exponent

    def _hashable_content(self) -> tuple[sympy.Expr, sympy.Expr]:
        return self.base, self.exponent

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, ConstantPower)
            and self._hashable_content() == other._hashable_content()
        )

    def __hash__(self) -> int:
        return hash((ConstantPower, self.base, self.exponent))

    def _as_mpf_val(self, precision: int) -> Any:
        bits = precision + GUARD_BITS + int(abs(float(self.exponent))).bit_length()
        with mp.workprec(bits):
            base, exponent = (part._to_mpmath(bits) for part in (self.base, self.exponent))
            return mp.mpf(base**exponent)._mpf_

    def approximation_interval(self, number_cls: Any) -> None:
        """None: there is no interval of integers or rationals to tell."""

    def _sympystr(self, printer: Any) -> str:
        if self.exponent == 1:
            return f"({printer.doprint(self.base)})"
        return f"(({printer.doprint(self.base)})**({printer.doprint(self.exponent)}))"

    def _latex(self, printer: Any) -> str:
        base, exponent = printer.doprint(self.base), printer.doprint(self.exponent)
        if self.exponent == 1:
            return str(base)
        return rf"\left({base}\right)^{{{exponent}}}"


def too_long(number: sympy.Expr) -> bool:
    """Whether an exact number has more digits than any is allowed to have."""
    return bool(
        number.is_Rational and number.q.bit_length() + abs(number.p).bit_length() > MAX_BITS
    )


def power(base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
    """base**exponent, without computing what would not end.

    Parameters
    ----------
    base : formula or number
    exponent : number

    Raises
    ------
    OverflowError
        For an integer power that would have more than :data:`MAX_BITS` bits.
    ArithmeticError
        For a root of a negative constant, or of one whose digits do not show that it is positive.
    """
    if base.is_Rational and exponent.is_Rational:
        size = max(int(base.p).bit_length(), int(base.q).bit_length())
        if size * (abs(exponent.p) // exponent.q + 1) > MAX_BITS and base not in (0, 1, -1):
            raise OverflowError("a power of too many digits")
    is_plain = exponent.is_Integer or base in (0, 1)
    is_root = base.is_Rational and exponent.is_Rational and exponent.q == 2
    if is_plain or is_root or base.is_NumberSymbol or base is sympy.E:
        return base**exponent
    if not base.free_symbols:
        if not (base.is_positive or _is_clearly_positive(base)):
            raise ArithmeticError("a power of what is negative, or cannot be told from zero")
        return ConstantPower(base, exponent)
    factor, remainder = base.as_coeff_Mul()
    if factor in (1, -1):
        return without_fine_roots(base**exponent)
    size = abs(factor)
    return power(size, exponent) * power(sympy.sign(factor) * remainder, exponent)


def exponential(argument: sympy.Expr) -> sympy.Expr:
    """exp of a formula, where SymPy would compute a**b for the b log(a) in it."""
    factors, others = [], []
    for term in sympy.Add.make_args(argument):
        logs = [part for part in sympy.Mul.make_args(term) if isinstance(part, sympy.log)]
        weight = term / logs[0] if len(logs) == 1 else term
        if len(logs) == 1 and weight.is_number:
            factors.append(power(logs[0].args[0], weight))
        else:
            others.append(term)
    return sympy.Mul(*factors, sympy.exp(sympy.Add(*others)))


#: What takes the place of SymPy's own.
BUILDERS = {sympy.Pow: power, sympy.exp: exponential}


def put_in(formula: sympy.Expr, numbers: Mapping[sympy.Symbol, sympy.Expr]) -> sympy.Expr:
    """The formula with numbers in the place of symbols, its powers taken by :func:`power`."""
    known: dict[sympy.Expr, sympy.Expr] = {}

    def build(part: sympy.Expr) -> sympy.Expr:
        if part in numbers:
            return numbers[part]
        if not part.args or not part.free_symbols & numbers.keys():
            return part
        if part not in known:
            args = [build(arg) for arg in part.args]
            known[part] = BUILDERS.get(part.func, part.func)(*args)
        return known[part]

    return without_fine_roots(build(formula))


def without_fine_roots(expr: sympy.Expr) -> sympy.Expr:
    """The formula with kept exponents, where x**(1/61)*x**(1/63) has become a fine root.

    Powers of one base are gathered, so that the derivative of x**1.234 is no quotient of zeros
    at x = 0.
    """
    powers = [part for part in expr.atoms(sympy.Pow) if part.base.free_symbols]
    if all(part.exp.is_Rational and not _is_fine(part.exp) for part in powers):
        return expr
    return expr.replace(
        lambda part: isinstance(part, sympy.Pow) and part.base.free_symbols,
        lambda part: part.base ** _written_exponent(part.exp),
    ).replace(sympy.Mul, _gathered)


def _gathered(*factors: sympy.Expr) -> sympy.Expr:
    exponents: dict[sympy.Expr, list[sympy.Expr]] = {}
    for factor in factors:
        base, exponent = factor.as_base_exp() if factor.free_symbols else (factor, sympy.S.One)
        exponents.setdefault(base, []).append(exponent)
    return sympy.Mul(
        *(base ** _written_exponent(sympy.Add(*parts)) for base, parts in exponents.items())
    )


def _is_clearly_positive(number: sympy.Expr) -> bool:
    """Whether digits show it, where SymPy does not know: log(tanh(1300)) has none, sin(1) has."""
    try:
        value = number.evalf(SIGN_DIGITS, strict=True)
    except PrecisionExhausted:
        return False
    return bool(value.is_Float and value > 0)


def _is_fine(exponent: sympy.Expr) -> bool:
    return bool(exponent.is_Rational and exponent.q > FINEST_ROOT)


def _written_exponent(exponent: sympy.Expr) -> sympy.Expr:
    """The exponent, as a number of its own if it is that of a fine root."""
    exponents = [part for part in exponent.atoms(ConstantPower) if part.exponent == 1]
    exact = exponent.xreplace({part: part.base for part in exponents})
    if not _is_fine(exact):
        return exact
    return sympy.sign(exact) * ConstantPower(abs(exact), sympy.S.One)
