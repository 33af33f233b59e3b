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

from certrack.core.printing import ATOM, PRODUCT, SUM, FormulaPrinter, Part, recognise_selection
from certrack.core.select import Select, larger, smaller
from certrack.export.program import Step

INDENT = "    "

#: Characters of a line of Structured Text, at most.
ST_LINE_WIDTH = 84

#: SymPy's name -> that of the standard.
STANDARD_FUNCTIONS = {
    "Abs": "ABS",
    "sin": "SIN",
    "cos": "COS",
    "tan": "TAN",
    "asin": "ASIN",
    "acos": "ACOS",
    "atan": "ATAN",
    "exp": "EXP",
    "log": "LN",
    "sqrt": "SQRT",
    "pow": "EXPT",
}

#: Recognised selection -> the standard's function.
SELECTION_FUNCTIONS = {"max": "MAX", "min": "MIN", "abs": "ABS", "clamp": "LIMIT"}

#: tanh is 1 from here on in double precision; limiting its argument keeps EXP from overflowing.
TANH_LIMIT = 20


def _angle(y: sympy.Expr, x: sympy.Expr) -> sympy.Expr:
    """atan2, by halves of the plane."""
    slope, pi = sympy.atan(y / x), sympy.pi
    left = Select(0, y, slope - pi, slope + pi)
    upright = Select(y, 0, pi / 2, Select(0, y, -pi / 2, 0))
    return Select(x, 0, slope, Select(0, x, left, upright))


#: Functions that the standard lacks, of variables.
MISSING_FUNCTIONS: dict[Any, Callable[..., sympy.Expr]] = {
    sympy.sinh: lambda a: (sympy.exp(a) - sympy.exp(-a)) / 2,
    sympy.cosh: lambda a: (sympy.exp(a) + sympy.exp(-a)) / 2,
    sympy.tanh: lambda a: 1 - 2 / (sympy.exp(2 * larger(smaller(TANH_LIMIT, a), -TANH_LIMIT)) + 1),
    sympy.sign: lambda a: Select(a, 0, 1, Select(0, a, -1, 0)),
    sympy.atan2: _angle,
}


def st_literal(value: float) -> str:
    """An LREAL; it needs a decimal point."""
    mantissa, _, exponent = repr(float(value)).partition("e")
    point = "" if "." in mantissa else ".0"
    return mantissa + point + (f"E{int(exponent)}" if exponent else "")


def comment_text(text: str) -> str:
    """Text that ends no comment and begins none, in ASCII."""
    return re.sub(r"\*(?=\))|\((?=\*)", r"\g<0> ", text).encode("ascii", "replace").decode()


def declaration(name: str, value: float | None = None, note: str = "", kind: str = "LREAL") -> str:
    """The declaration of a variable, with its initial value and a comment."""
    start = "" if value is None else f" := {st_literal(value)}"
    return f"{name} : {kind}{start};" + (f" (* {comment_text(note)} *)" if note else "")


def unused_name(label: str, used_names: set[str]) -> str:
    """The label, or one like it, that is an identifier and not taken; it is from now on."""
    name = label = re.sub("_+", "_", label).strip("_")
    base, count = re.sub(r"_\d+$", "", label), 1
    while name.lower() in used_names:
        count += 1
        name = f"{base}_{count}"
    used_names.add(name.lower())
    return name


class Variables:
    """The variables of a block.

    Parameters
    ----------
    names : mapping
        Identifier of every symbol.

    Attributes
    ----------
    names : dict
        Those, and the temporary ones.
    temporary : identifiers
        For parts that are no expressions in Structured Text, or occur twice in one.
    """

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        self.names = dict(names)
        self.temporary: list[str] = []
        self._used_names = {name.lower() for name in names.values()}

    def add(self) -> sympy.Symbol:
        """One more temporary variable."""
        name = unused_name("part_1", self._used_names)
        symbol = sympy.Symbol(name, real=True)
        self.names[symbol] = name
        self.temporary.append(name)
        return symbol


class Statements(FormulaPrinter):
    """Statements in a row: those of a block, or of a branch within.

    Parameters
    ----------
    variables : Variables
        Of the block.
    computed : mapping, optional
        Variable of every part that has been computed before.

    Attributes
    ----------
    lines : texts
    """

    language = "Structured Text"
    functions = STANDARD_FUNCTIONS
    first_term, other_terms = SUM, PRODUCT

    def __init__(
        self, variables: Variables, computed: Mapping[sympy.Expr, sympy.Symbol] | None = None
    ) -> None:
        super().__init__(variables.names)
        self.lines: list[str] = []
        self._variables, self._computed = variables, dict(computed or {})

    def note(self, text: str) -> None:
        """A comment of its own lines."""
        self.lines += ["", *(f"(* {comment_text(line)} *)" for line in text.splitlines())]

    def step(self, step: Step) -> None:
        """A named formula, below what it means."""
        if step.note:
            self.note(step.note)
        self.assign(self._names[step.name], step.formula)

    def assign(self, target: str, formula: sympy.Expr) -> None:
        """Give `target` the value."""
        if not isinstance(formula, Select) or recognise_selection(formula):
            self._add(f"{target} := {self.text(formula)};")
            return
        a, b, yes, no = formula.args
        condition = f"{self.text(a)} > {self.text(b)}"
        then, other = (Statements(self._variables, self._computed) for _ in range(2))
        then.assign(target, yes)
        other.assign(target, no)
        self._add(f"IF {condition} THEN")
        self.lines += [INDENT + line for line in then.lines]
        if other.lines[0].startswith("IF ") and len(other._computed) == len(self._computed):
            self.lines += [f"ELS{other.lines[0]}", *other.lines[1:]]
        else:
            self.lines += ["ELSE", *(INDENT + line for line in other.lines), "END_IF;"]

    def _add(self, text: str) -> None:
        """One statement, on several lines if it is long."""
        self.lines += textwrap.wrap(
            text,
            ST_LINE_WIDTH,
            subsequent_indent=INDENT,
            break_long_words=False,
            break_on_hyphens=False,
        )

    def literal(self, value: float) -> str:
        return st_literal(value)

    def factors(self, expr: sympy.Mul) -> list[sympy.Expr]:
        number, others = expr.as_coeff_Mul()
        return [*([] if number == 1 else [number]), *others.as_ordered_factors()]

    def factor(self, base: sympy.Expr) -> str:
        return self._names[self._part(base)]

    def quotient(self, above: list[sympy.Expr], below: list[sympy.Expr]) -> str:
        numerator = " * ".join(self.text(factor, PRODUCT) for factor in above)
        denominators = (self.text(factor, ATOM) for factor in below)
        return " / ".join([numerator or self.literal(1), *denominators])

    def recognised(self, name: str, arguments: tuple[sympy.Expr, ...]) -> Part:
        return self.call(SELECTION_FUNCTIONS[name], *arguments)

    def choice(self, expr: sympy.Expr) -> Part:
        return self._names[self._part(expr)], ATOM

    def _print(self, expr: sympy.Basic, **_: object) -> Part:
        return super()._print(self._computed.get(expr, expr))

    def _print_Function(self, expr: sympy.Expr) -> Part:
        if type(expr) in MISSING_FUNCTIONS:
            return self._print(MISSING_FUNCTIONS[type(expr)](*map(self._part, expr.args)))
        return super()._print_Function(expr)

    def _part(self, formula: sympy.Expr) -> sympy.Symbol:
        """A variable that has the value."""
        formula = self._computed.get(formula, formula)
        if formula.is_Symbol:
            return formula
        symbol = self._variables.add()
        self.assign(self._names[symbol], formula)
        self._computed[formula] = symbol
        return symbol
