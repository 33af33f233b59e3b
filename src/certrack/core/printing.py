"""Formulas as text of a language: what the printers of C, Structured Text and vectors share.

A printed part is its text and how closely that binds, so parentheses stand where the language, or
its reader, wants them. A language says how it writes numbers, calls and choices; it overrides more
where it has more to say.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import sympy
from sympy.printing.printer import Printer

from certrack.core.errors import InputError
from certrack.core.select import Select

#: How closely a text binds: a sum (or a sign, or a choice), a product, or what stands for itself.
SUM, PRODUCT, ATOM = range(3)

#: Powers up to this one are products: faster than the library's power, and as accurate.
MAX_FACTORS = 8

#: A text and how closely it binds.
Part = tuple[str, int]


def is_negative(term: sympy.Expr) -> bool:
    """Whether the number before a term is negative."""
    return bool(term.as_coeff_Mul()[0].is_negative)


def recognise_selection(choice: sympy.Expr) -> tuple[str, tuple[sympy.Expr, ...]] | None:
    """The usual function that a :class:`~certrack.core.select.Select` is, if it is one.

    Parameters
    ----------
    choice : formula

    Returns
    -------
    name, arguments
        "max" or "min" with (a, b), "abs" with (a,), or "clamp" with (low, value, high).
    """
    if not isinstance(choice, Select):
        return None
    a, b, yes, no = choice.args
    if (yes, no) == (a, b):
        return "max", (a, b)
    if (yes, no) == (b, a):
        return "min", (a, b)
    if (b, yes, no) == (0, a, -a):
        return "abs", (a,)
    if yes == a and isinstance(no, Select):
        high = no.args[1]
        if no == Select(b, high, high, b):
            return "clamp", (a, b, high)
    return None


def selection_of(name: str, arguments: tuple[sympy.Expr, ...]) -> sympy.Expr:
    """The :class:`~certrack.core.select.Select` that :func:`recognise_selection` would name so.

    Parameters
    ----------
    name : str
        "max", "min", "abs" or "clamp".
    arguments : tuple of formulas
    """
    a, *others = arguments
    if name == "abs":
        return Select(a, 0, a, -a)
    b, *high = others
    if name == "clamp":
        return Select(a, b, a, selection_of("min", (b, *high)))
    return Select(a, b, a, b) if name == "max" else Select(a, b, b, a)


class FormulaPrinter(Printer):
    """Base of the printers.

    Parameters
    ----------
    names : mapping
        Text of every symbol.

    Attributes
    ----------
    language : str
        For messages.
    functions : mapping
        Name of SymPy's class -> name in the language, for what has a function there; also "sqrt"
        and "pow".
    first_term, other_terms : int
        How closely the terms of a sum must bind.
    """

    language: str
    functions: Mapping[str, str]
    first_term: int = SUM
    other_terms: int = PRODUCT

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__()
        self._names = names

    # What a language says.

    def literal(self, value: float) -> str:
        """A number."""
        raise NotImplementedError

    def call(self, name: str, *arguments: sympy.Expr) -> Part:
        """A call of a function of the language."""
        return f"{name}({', '.join(map(self.argument, arguments))})", ATOM

    def argument(self, formula: sympy.Expr) -> str:
        """An argument of a call."""
        return self.text(formula)

    def recognised(self, name: str, arguments: tuple[sympy.Expr, ...]) -> Part:
        """What :func:`recognise_selection` has found."""
        raise NotImplementedError

    def choice(self, expr: sympy.Expr) -> Part:
        """Any other :class:`~certrack.core.select.Select`."""
        raise NotImplementedError

    def terms(self, expr: sympy.Add) -> Iterable[sympy.Expr]:
        """The terms of a sum in the order in which they are printed."""
        return expr.as_ordered_terms()

    def factors(self, expr: sympy.Mul) -> Iterable[sympy.Expr]:
        """The factors of a product in the order in which they are printed."""
        return expr.as_ordered_factors()

    def factor(self, base: sympy.Expr) -> str:
        """The base of a power that is printed as a product."""
        return self.text(base, ATOM)

    def quotient(self, above: list[sympy.Expr], below: list[sympy.Expr]) -> str:
        """The product of some factors over that of others; both may be empty."""
        raise NotImplementedError

    # What they share.

    def text(self, formula: sympy.Expr, least: int = SUM) -> str:
        """The formula as text that binds at least so closely."""
        text, level = self._print(formula)
        return text if level >= least else f"({text})"

    def _print(self, expr: sympy.Basic, **_: object) -> Part:
        if expr.is_number:
            value = float(expr)
            return self.literal(value), SUM if value < 0 else ATOM
        printed: Part = super()._print(expr)
        return printed

    def _print_Symbol(self, expr: sympy.Symbol) -> Part:
        return self._names[expr], ATOM

    def _print_Add(self, expr: sympy.Add) -> Part:
        first, *others = sorted(self.terms(expr), key=is_negative)
        text = self.text(first, self.first_term)
        for term in others:
            negative = is_negative(term)
            sign = " - " if negative else " + "
            text += sign + self.text(-term if negative else term, self.other_terms)
        return text, SUM

    def _print_Mul(self, expr: sympy.Mul) -> Part:
        if is_negative(expr):
            return f"-{self.text(-expr, self.other_terms)}", SUM
        above: list[sympy.Expr] = []
        below: list[sympy.Expr] = []
        for factor in self.factors(expr):
            inverse = factor.is_Pow and factor.exp.is_negative
            (below if inverse else above).append(1 / factor if inverse else factor)
        return self.quotient(above, below), PRODUCT

    def _print_Pow(self, expr: sympy.Pow) -> Part:
        base, exponent = expr.args
        if exponent.is_negative:
            return self.quotient([], [1 / expr]), PRODUCT
        if exponent == sympy.Rational(1, 2):
            return self.call(self.functions["sqrt"], base)
        if exponent.is_Integer and exponent <= MAX_FACTORS:
            return " * ".join([self.factor(base)] * int(exponent)), PRODUCT
        return self.call(self.functions["pow"], base, exponent)

    def _print_Select(self, expr: sympy.Expr) -> Part:
        usual = recognise_selection(expr)
        return self.choice(expr) if usual is None else self.recognised(*usual)

    def _print_Function(self, expr: sympy.Expr) -> Part:
        name = type(expr).__name__
        if name not in self.functions:
            raise self._unprintable(name)
        return self.call(self.functions[name], *expr.args)

    def emptyPrinter(self, expr: sympy.Basic) -> Part:
        raise self._unprintable(type(expr).__name__)

    def _unprintable(self, name: str) -> InputError:
        return InputError("export", f"has no {self.language} form of the function {name}")
