"""Formulas to C99, in one type of real numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

import numpy as np
import sympy
from sympy.printing.c import C99CodePrinter

from certrack.core.errors import InputError
from certrack.core.select import Select
from certrack.export.program import MOST_FACTORS

REALS = ("double", "float")

WIDTH = 96

#: SymPy's name -> that of C, where they differ.
FUNCTIONS = {"Abs": "fabs"}

PLAIN = frozenset("sin cos tan asin acos atan atan2 sinh cosh tanh exp log".split())

#: Small functions that a file gets when it uses them: name -> (arguments, body, note).
HELPERS = {
    "clamp": (
        ("value", "low", "high"),
        "(low > value) ? low : ((value > high) ? high : value)",
        "The value within [low, high]; what is not a number stays so.",
    ),
    "larger": (("a", "b"), "(a > b) ? a : b", "The larger of two."),
    "smaller": (("a", "b"), "(b > a) ? a : b", "The smaller of two."),
    "sign": (
        ("value",),
        "(value > {zero}) ? {one} : ((value < {zero}) ? -{one} : value)",
        "-1, 0 or 1.",
    ),
}


def literal(value: float, real: str) -> str:
    """A number as a literal of its type."""
    if real == "double":
        return repr(float(value))
    with np.errstate(over="ignore"):
        single = np.float32(value)
    if not np.isfinite(single):
        raise InputError("--real", f"float cannot hold the number {value:g}", remedy="Use double")
    return f"{single!s}F"


class CPrinter(C99CodePrinter):
    """Formulas of named symbols: products for small powers, parentheses for the reader.

    Parameters
    ----------
    names : mapping
        Text of every symbol, in the order in which the terms of a sum are wanted.
    real : {"double", "float"}
    constants : symbols
        What comes first in a product.

    Attributes
    ----------
    helpers : set of str
        Which of :data:`HELPERS` were used.
    calls : bool
        Whether a function of <math.h> was.
    """

    def __init__(
        self, names: Mapping[sympy.Symbol, str], real: str, constants: Collection[sympy.Symbol]
    ) -> None:
        super().__init__()
        self._names, self._real, self._constants = names, real, constants
        self._order = {name: i for i, name in enumerate(names)}
        self.helpers: set[str] = set()
        self.calls = False

    def text(self, formula: sympy.Expr) -> str:
        """The formula without outer parentheses."""
        return _bare(self._print(formula))

    def function(self, name: str, *arguments: str) -> str:
        """A call of a function of <math.h>."""
        self.calls = True
        suffix = "f" if self._real == "float" else ""
        return f"{name}{suffix}({', '.join(_bare(argument) for argument in arguments)})"

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names[expr]

    def _print_number(self, expr: sympy.Expr) -> str:
        value = literal(float(expr), self._real)
        return f"({value})" if value.startswith("-") else value

    _print_Rational = _print_Integer = _print_Float = _print_NumberSymbol = _print_number

    def _print_Add(self, expr: sympy.Add) -> str:
        terms = sorted(expr.args, key=lambda term: (_is_negative(term), *self._rank(term)))
        text = self._print(terms[0])
        for term in terms[1:]:
            negative = _is_negative(term)
            text += (" - " if negative else " + ") + self._print(-term if negative else term)
        return f"({text})"

    def _rank(self, term: sympy.Expr) -> tuple[bool, bool, int]:
        """Numbers, then products of names, then the rest, each in the order of the names."""
        first = min((self._order[name] for name in term.free_symbols), default=-1)
        return (bool(term.free_symbols), term.has(sympy.Add, sympy.Function), first)

    def _constants_first(self, factor: sympy.Expr) -> tuple[bool, tuple[bool, bool, int]]:
        return factor not in self._constants, self._rank(factor)

    def _print_Mul(self, expr: sympy.Mul) -> str:
        if expr.is_number:
            return self._print_number(expr)
        if _is_negative(expr):
            return f"(-{self._print(-expr)})"
        above: list[sympy.Expr] = []
        below: list[sympy.Expr] = []
        for factor in sorted(expr.args, key=self._constants_first):
            inverse = factor.is_Pow and factor.exp.is_Rational and factor.exp < 0
            (below if inverse else above).append(1 / factor if inverse else factor)
        factors = [_bare(self._print(f)) if f.is_Pow else self._print(f) for f in above]
        numerator = " * ".join(factors) or literal(1, self._real)
        if len(above) > 1 and below:
            numerator = f"({numerator})"
        if not below:
            return f"({numerator})"
        denominator = " * ".join(map(self._print, below))
        return f"({numerator} / {denominator if len(below) == 1 else f'({denominator})'})"

    def _print_Pow(self, expr: sympy.Pow) -> str:
        base, exponent = expr.args
        if expr.is_number:
            return self._print_number(expr)
        if exponent.is_Rational and exponent < 0:
            return f"({literal(1, self._real)} / {self._print(1 / expr)})"
        if exponent == sympy.Rational(1, 2):
            return self.function("sqrt", self._print(base))
        if exponent.is_Integer and exponent <= MOST_FACTORS:
            return "(" + " * ".join([self._print(base)] * int(exponent)) + ")"
        return self.function("pow", self._print(base), self._print(exponent))

    def _print_Select(self, expr: sympy.Expr) -> str:
        a, b, yes, no = expr.args
        if (b, yes, no) == (0, a, -a):
            return self.function("fabs", self._print(a))
        if (yes, no) in ((a, b), (b, a)):
            larger = (yes, no) == (a, b)
            return self._helper("larger", a, b) if larger else self._helper("smaller", b, a)
        if yes == a and isinstance(no, Select) and no.args[0] == b and no == _upper(b, no.args[1]):
            return self._helper("clamp", b, a, no.args[1])
        above = f"({self._print(a)} > {self._print(b)})"
        return f"({above} ? {self._print(yes)} : {self._print(no)})"

    def _helper(self, name: str, *arguments: sympy.Expr) -> str:
        self.helpers.add(name)
        return f"{name}({', '.join(map(self.text, arguments))})"

    def _print_sign(self, expr: sympy.Expr) -> str:
        return self._helper("sign", *expr.args)

    def _print_Function(self, expr: sympy.Expr) -> str:
        if expr.is_number:
            return self._print_number(expr)
        name = type(expr).__name__
        if name not in FUNCTIONS and name not in PLAIN:
            raise InputError("export", f"has no C form of the function {name}")
        return self.function(FUNCTIONS.get(name, name), *map(self._print, expr.args))

    _print_Abs = _print_sin = _print_cos = _print_tan = _print_Function
    _print_asin = _print_acos = _print_atan = _print_atan2 = _print_Function
    _print_sinh = _print_cosh = _print_tanh = _print_exp = _print_log = _print_Function
    _print_Max = _print_Min = _print_Function


def _is_negative(term: sympy.Expr) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)


def _upper(value: sympy.Expr, high: sympy.Expr) -> sympy.Expr:
    return Select(value, high, high, value)


def _bare(text: str) -> str:
    """Without a pair of parentheses around all of it."""
    if not text.startswith("("):
        return text
    depth = 0
    for i, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if i == len(text) - 1 else text
    return text


def helper(name: str, type_name: str, real: str) -> str:
    """The definition of one of :data:`HELPERS`."""
    arguments, body, note = HELPERS[name]
    given = ", ".join(f"{type_name} {argument}" for argument in arguments)
    body = body.format(zero=literal(0, real), one=literal(1, real))
    signature = wrapped(f"static {type_name} {name}({given})", "")
    return f"/* {note} */\n{signature}\n{{\n    return {body};\n}}\n"


def wrapped(text: str, indent: str = "    ") -> str:
    """A statement on as many lines as it needs, broken where the fewest parentheses are open."""
    lines, start = [], indent
    while len(start + text) > WIDTH:
        depth, best = 0, None
        for place in re.finditer(r"[()]| (?=[-+*/?:] )|(?<=,) ", text[: WIDTH - len(start) + 1]):
            depth += {"(": 1, ")": -1}.get(place[0], 0)
            late = place.start() > WIDTH // 4
            if place[0] == " " and late and (best is None or depth <= best[0]):
                best = depth, place.start()
        if best is None:
            break
        lines.append(start + text[: best[1]])
        text, start = text[best[1] + 1 :], indent + "    "
    return "\n".join([*lines, start + text])


def comment(lines: list[str]) -> str:
    """A block comment that nothing in it can end or disturb; ASCII, no nesting, no trigraphs."""
    safe = [line.encode("ascii", "backslashreplace").decode() for line in lines]
    for pattern, put in ((r"\*(?=/)", "* "), (r"/(?=[/*])", "/ "), (r"\?(?=\?)", "? ")):
        safe = [re.sub(pattern, put, line) for line in safe]
    body = "".join(f" * {line}".rstrip() + "\n" for line in safe)
    return f"/*\n{body} */\n"
