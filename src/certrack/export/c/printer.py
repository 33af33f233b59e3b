"""Formulas to C99, in one type of real numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.printing import ATOM, PRODUCT, SUM, FormulaPrinter, Part

NUMBER_TYPES = ("double", "float")

#: Characters of a line of C, at most.
C_LINE_WIDTH = 96

#: SymPy's name -> that of <math.h>.
MATH_FUNCTIONS = {"Abs": "fabs"} | {
    name: name
    for name in "sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt pow".split()
}

#: Recognised selection -> the helper, and the order of its arguments.
SELECTION_HELPERS = {
    "max": ("larger", (0, 1)),
    "min": ("smaller", (1, 0)),
    "clamp": ("clamp", (1, 0, 2)),
}

#: Small functions that a file gets when it uses them: name -> (arguments, body, note).
C_HELPERS = {
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


def c_literal(value: float, real: str) -> str:
    """A number as a literal of its type."""
    if real == "double":
        return repr(float(value))
    with np.errstate(over="ignore"):
        single = np.float32(value)
    if not np.isfinite(single):
        raise InputError("--real", f"float cannot hold the number {value:g}", remedy="Use double")
    return f"{single!s}F"


def initialiser(values: Iterable[float], real: str) -> str:
    """An initialiser of an array or a structure of numbers."""
    return "{" + ", ".join(c_literal(float(value), real) for value in values) + "}"


class CPrinter(FormulaPrinter):
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
        Which of :data:`C_HELPERS` were used.
    calls : bool
        Whether a function of <math.h> was.
    """

    language = "C"
    functions = MATH_FUNCTIONS
    first_term = other_terms = ATOM

    def __init__(
        self, names: Mapping[sympy.Symbol, str], real: str, constants: Collection[sympy.Symbol]
    ) -> None:
        super().__init__(names)
        self._real, self._constants = real, constants
        self._order = {name: i for i, name in enumerate(names)}
        self.helpers: set[str] = set()
        self.calls = False

    def literal(self, value: float) -> str:
        return c_literal(value, self._real)

    def call(self, name: str, *arguments: sympy.Expr) -> Part:
        self.calls = True
        return super().call(name + ("f" if self._real == "float" else ""), *arguments)

    def terms(self, expr: sympy.Add) -> list[sympy.Expr]:
        return sorted(expr.args, key=self._rank)

    def factors(self, expr: sympy.Mul) -> list[sympy.Expr]:
        return sorted(expr.args, key=lambda f: (f not in self._constants, self._rank(f)))

    def _rank(self, term: sympy.Expr) -> tuple[bool, bool, int]:
        """Numbers, then products of names, then all others, each in the order of the names."""
        first = min((self._order[name] for name in term.free_symbols), default=-1)
        return (bool(term.free_symbols), term.has(sympy.Add, sympy.Function), first)

    def quotient(self, above: list[sympy.Expr], below: list[sympy.Expr]) -> str:
        factors = [self.text(factor, PRODUCT if factor.is_Pow else ATOM) for factor in above]
        numerator = " * ".join(factors) or self.literal(1)
        if not below:
            return numerator
        if len(above) > 1:
            numerator = f"({numerator})"
        denominator = " * ".join(self.text(factor, ATOM) for factor in below)
        return f"{numerator} / {denominator if len(below) == 1 else f'({denominator})'}"

    def recognised(self, name: str, arguments: tuple[sympy.Expr, ...]) -> Part:
        if name == "abs":
            return self.call("fabs", *arguments)
        helper, order = SELECTION_HELPERS[name]
        return self._helper(helper, *(arguments[i] for i in order))

    def choice(self, expr: sympy.Expr) -> Part:
        a, b, yes, no = (self.text(part, ATOM) for part in expr.args)
        return f"({a} > {b}) ? {yes} : {no}", SUM

    def _helper(self, name: str, *arguments: sympy.Expr) -> Part:
        self.helpers.add(name)
        return f"{name}({', '.join(map(self.text, arguments))})", ATOM

    def _print_sign(self, expr: sympy.Expr) -> Part:
        return self._helper("sign", *expr.args)


def helper_definition(name: str, type_name: str, real: str) -> str:
    """The definition of one of :data:`C_HELPERS`."""
    arguments, body, note = C_HELPERS[name]
    typed = ", ".join(f"{type_name} {argument}" for argument in arguments)
    body = body.format(zero=c_literal(0, real), one=c_literal(1, real))
    signature = wrapped(f"static {type_name} {name}({typed})", "")
    return f"/* {note} */\n{signature}\n{{\n    return {body};\n}}\n"


def wrapped(text: str, indent: str = "    ") -> str:
    """A statement on as many lines as it needs, broken where the fewest parentheses are open."""
    lines, start = [], indent
    while len(start + text) > C_LINE_WIDTH:
        depth, best = 0, None
        for mark in re.finditer(
            r"[()]| (?=[-+*/?:] )|(?<=,) ", text[: C_LINE_WIDTH - len(start) + 1]
        ):
            depth += {"(": 1, ")": -1}.get(mark[0], 0)
            late = mark.start() > C_LINE_WIDTH // 4
            if mark[0] == " " and late and (best is None or depth <= best[0]):
                best = depth, mark.start()
        if best is None:
            break
        lines.append(start + text[: best[1]])
        text, start = text[best[1] + 1 :], indent + "    "
    return "\n".join([*lines, start + text])


def comment(lines: list[str]) -> str:
    """A block comment that nothing in it can end or disturb; ASCII, no nesting, no trigraphs."""
    safe = [line.encode("ascii", "backslashreplace").decode() for line in lines]
    for pattern, spaced in ((r"\*(?=/)", "* "), (r"/(?=[/*])", "/ "), (r"\?(?=\?)", "? ")):
        safe = [re.sub(pattern, spaced, line) for line in safe]
    body = "".join(f" * {line}".rstrip() + "\n" for line in safe)
    return f"/*\n{body} */\n"
