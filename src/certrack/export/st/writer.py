"""Formulas to statements of Structured Text.

What the standard lacks is expressed by what it has: sinh, cosh and tanh by EXP, sign and atan2 by
IF. A selection is LIMIT, MAX, MIN or ABS where it is one of them, else an IF.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

import sympy

from certrack.core.select import Select, larger
from certrack.export.program import MOST_FACTORS, Step

INDENT, WIDTH = "    ", 84

FUNCTIONS: dict[Any, str] = {
    sympy.Abs: "ABS",
    sympy.sin: "SIN",
    sympy.cos: "COS",
    sympy.tan: "TAN",
    sympy.asin: "ASIN",
    sympy.acos: "ACOS",
    sympy.atan: "ATAN",
    sympy.exp: "EXP",
    sympy.log: "LN",
}

#: tanh is 1 from here on in double precision; limiting its argument keeps EXP from overflowing.
FLAT = 20


def _angle(y: sympy.Expr, x: sympy.Expr) -> sympy.Expr:
    """atan2, by halves of the plane."""
    slope, pi = sympy.atan(y / x), sympy.pi
    left = Select(0, y, slope - pi, slope + pi)
    upright = Select(y, 0, pi / 2, Select(0, y, -pi / 2, 0))
    return Select(x, 0, slope, Select(0, x, left, upright))


#: Functions that the standard lacks, of variables.
LACKING: dict[Any, Callable[..., sympy.Expr]] = {
    sympy.sinh: lambda a: (sympy.exp(a) - sympy.exp(-a)) / 2,
    sympy.cosh: lambda a: (sympy.exp(a) + sympy.exp(-a)) / 2,
    sympy.tanh: lambda a: 1 - 2 / (sympy.exp(2 * larger(Select(a, FLAT, FLAT, a), -FLAT)) + 1),
    sympy.sign: lambda a: Select(a, 0, 1, Select(0, a, -1, 0)),
    sympy.atan2: _angle,
}

#: What binds how closely.
SUM, PRODUCT, ATOM = range(3)


def literal(value: float) -> str:
    """An LREAL; it needs a decimal point."""
    mantissa, _, exponent = repr(float(value)).partition("e")
    point = "" if "." in mantissa else ".0"
    return mantissa + point + (f"E{int(exponent)}" if exponent else "")


def plain(text: str) -> str:
    """Text that ends no comment and begins none, in ASCII."""
    return re.sub(r"\*(?=\))|\((?=\*)", r"\g<0> ", text).encode("ascii", "replace").decode()


def free(label: str, taken: set[str]) -> str:
    """The label, or one like it, that is an identifier and not taken; it is from now on."""
    found = label = re.sub("_+", "_", label).strip("_")
    base, count = re.sub(r"_\d+$", "", label), 1
    while found.lower() in taken:
        count += 1
        found = f"{base}_{count}"
    taken.add(found.lower())
    return found


class Branch:
    """Statements in a row, and the variables whose values are known among them."""

    def __init__(self, known: Mapping[sympy.Expr, sympy.Symbol]) -> None:
        self.lines: list[str] = []
        self.known = dict(known)

    def add(self, text: str) -> None:
        """One statement, on several lines if it is long."""
        self.lines += textwrap.wrap(
            text,
            WIDTH,
            subsequent_indent=INDENT,
            break_long_words=False,
            break_on_hyphens=False,
        )


class Writer(Branch):
    """The statements of a block.

    Parameters
    ----------
    names : mapping
        Identifier of every symbol.

    Attributes
    ----------
    temporary : identifiers
        Variables for parts that are no expressions in Structured Text, or occur twice in one.
    """

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        super().__init__({})
        self._names = dict(names)
        self._taken = {name.lower() for name in names.values()}
        self.temporary: list[str] = []

    def note(self, text: str) -> None:
        """A comment of its own line."""
        self.lines += ["", f"(* {plain(text)} *)"]

    def step(self, step: Step) -> None:
        """A named formula, below what it means."""
        if step.note:
            self.note(step.note)
        self.assign(self._names[step.name], step.formula, self)

    def assign(self, target: str, formula: sympy.Expr, place: Branch) -> None:
        """Give `target` the value."""
        if not isinstance(formula, Select) or _call(formula):
            place.add(f"{target} := {self._text(formula, SUM, place)};")
            return
        a, b, yes, no = formula.args
        condition = f"{self._text(a, SUM, place)} > {self._text(b, SUM, place)}"
        then, other = Branch(place.known), Branch(place.known)
        self.assign(target, yes, then)
        self.assign(target, no, other)
        place.add(f"IF {condition} THEN")
        place.lines += [INDENT + line for line in then.lines]
        if other.lines[0].startswith("IF ") and len(other.known) == len(place.known):
            place.lines += [f"ELS{other.lines[0]}", *other.lines[1:]]
        else:
            place.lines += ["ELSE", *(INDENT + line for line in other.lines), "END_IF;"]

    def _text(self, formula: sympy.Expr, least: int, place: Branch) -> str:
        """The formula as an expression that binds at least so closely."""
        text, level = self._expression(formula, place)
        return text if level >= least else f"({text})"

    def _expression(self, formula: sympy.Expr, place: Branch) -> tuple[str, int]:
        formula = place.known.get(formula, formula)
        if formula.is_Symbol:
            return self._names[formula], ATOM
        if formula.is_number:
            value = float(formula)
            return literal(value), SUM if value < 0 else ATOM
        if formula.is_Add:
            return self._sum(formula, place), SUM
        if formula.is_Mul:
            return self._product(formula, place)
        if formula.is_Pow:
            return self._power(formula, place)
        if type(formula) in LACKING:
            parts = [self._part(argument, place) for argument in formula.args]
            replaced = LACKING[type(formula)](*parts)
            return self._expression(replaced, place)
        if call := _call(formula):
            name, arguments = call
            return f"{name}({', '.join(self._text(a, SUM, place) for a in arguments)})", ATOM
        return self._names[self._part(formula, place)], ATOM

    def _sum(self, formula: sympy.Expr, place: Branch) -> str:
        text = ""
        for term in sorted(formula.as_ordered_terms(), key=_is_negative):
            negative = _is_negative(term)
            part = self._text(-term if negative else term, PRODUCT, place)
            text += ((" - " if negative else " + ") if text else "-" * negative) + part
        return text

    def _product(self, formula: sympy.Expr, place: Branch) -> tuple[str, int]:
        number, rest = formula.as_coeff_Mul()
        if number.is_negative:
            return f"-{self._text(-formula, PRODUCT, place)}", SUM
        above = [] if number == 1 else [literal(float(number))]
        below = []
        for factor in rest.as_ordered_factors():
            if factor.is_Pow and factor.exp.is_negative:
                below.append(self._text(1 / factor, ATOM, place))
            else:
                above.append(self._text(factor, PRODUCT, place))
        return " / ".join([" * ".join(above) or literal(1), *below]), PRODUCT

    def _power(self, formula: sympy.Expr, place: Branch) -> tuple[str, int]:
        base, exponent = formula.args
        if exponent.is_negative:
            return f"{literal(1)} / {self._text(1 / formula, ATOM, place)}", PRODUCT
        if exponent == sympy.Rational(1, 2):
            return f"SQRT({self._text(base, SUM, place)})", ATOM
        if exponent.is_Integer and exponent <= MOST_FACTORS:
            return " * ".join([self._names[self._part(base, place)]] * int(exponent)), PRODUCT
        return f"EXPT({self._text(base, SUM, place)}, {literal(float(exponent))})", ATOM

    def _part(self, formula: sympy.Expr, place: Branch) -> sympy.Symbol:
        """A variable that has the value."""
        formula = place.known.get(formula, formula)
        if formula.is_Symbol:
            return formula
        name = free("part_1", self._taken)
        found = sympy.Symbol(name, real=True)
        self._names[found] = name
        self.temporary.append(name)
        self.assign(name, formula, place)
        place.known[formula] = found
        return found


def _is_negative(term: sympy.Expr) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)


def _call(formula: sympy.Expr) -> tuple[str, tuple[sympy.Expr, ...]] | None:
    """Name and arguments of the standard's function that `formula` is."""
    if type(formula) in FUNCTIONS:
        return FUNCTIONS[type(formula)], formula.args
    if not isinstance(formula, Select):
        return None
    a, b, yes, no = formula.args
    if (yes, no) == (a, b):
        return "MAX", (a, b)
    if (yes, no) == (b, a):
        return "MIN", (a, b)
    if (b, yes, no) == (0, a, -a):
        return "ABS", (a,)
    if yes == a and isinstance(no, Select) and no == Select(b, no.args[1], no.args[1], b):
        return "LIMIT", (a, b, no.args[1])
    return None
