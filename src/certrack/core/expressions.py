"""Text to SymPy, safely.

A system file may come from a stranger, so the text is never evaluated by Python or by SymPy's own
parser. It is parsed to Python's syntax tree and rebuilt node by node from a white list: the listed
names, numbers, arithmetic and a few functions. Size is bounded at every level, and every constant
sub-expression is checked in floating point before SymPy sees it, so that ``9**9**9**9`` or
``exp(exp(exp(99)))`` is refused instead of computed.
"""

from __future__ import annotations

import ast
import keyword
import math
import numbers
import operator
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any

import sympy

from certrack.core.errors import InputError, shorten
from certrack.core.formula_mistakes import decimal_comma, node_remedy, syntax_remedy
from certrack.core.formula_text import text_of
from certrack.core.powers import exponential, power, too_long, without_fine_roots
from certrack.core.rationals import RationalFloat
from certrack.core.spelling import hint

MAX_LENGTH = 10_000  # characters
MAX_NESTING = 100  # parentheses and operators
MAX_NODES = 4_000
MAX_POWER = 64  # magnitude of a numeric exponent
MAX_ARGUMENTS = 8  # of min and max
MAX_NAMES_SHOWN = 30  # of the known names in a message
MAX_SYMBOLS = 4096  # that are kept: SymPy takes its time to make one
MAX_INTEGER_BITS = 1000  # of an integer in the text; about MAX_MAGNITUDE
MAX_MAGNITUDE = 1e300  # of any constant

TIME = sympy.Symbol("t", real=True)


def _sign(value: float) -> float:
    return float((value > 0) - (value < 0))


def _atan2(y: sympy.Expr, x: sympy.Expr) -> sympy.Expr:
    """atan2 with the value 0 at the origin, which every language gives it there."""
    return sympy.S.Zero if y.is_zero and x.is_zero else sympy.atan2(y, x)


#: name -> (SymPy function, the same in floating point, fewest and most arguments)
ALLOWED_FUNCTIONS: dict[str, tuple[Any, Callable[..., float], int, int]] = {
    **{
        name: (getattr(sympy, name), getattr(math, name), 1, 1)
        for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
    },
    "exp": (sympy.exp, math.exp, 1, 1),
    "log": (sympy.log, math.log, 1, 1),
    "sqrt": (sympy.sqrt, math.sqrt, 1, 1),
    "atan2": (sympy.atan2, math.atan2, 2, 2),
    "abs": (sympy.Abs, abs, 1, 1),
    "sign": (sympy.sign, _sign, 1, 1),
    "min": (sympy.Min, min, 1, MAX_ARGUMENTS),
    "max": (sympy.Max, max, 1, MAX_ARGUMENTS),
}

#: What builds a function where SymPy's own would compute for ever, or has no value.
_BUILDERS: dict[Any, Callable[..., sympy.Expr]] = {
    sympy.exp: exponential,
    sympy.sqrt: lambda a: power(a, sympy.S.Half),
    sympy.atan2: _atan2,
}
#: What SymPy makes of some of them, and nothing else of certrack knows.
FOREIGN = (sympy.re, sympy.im, sympy.arg, sympy.cot, sympy.sec, sympy.csc, sympy.coth, sympy.sech)

RESERVED_NAMES = frozenset(ALLOWED_FUNCTIONS) | {"t", "pi", "inf", "nan"}

_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")


@dataclass(frozen=True)
class Expression:
    """A formula: the text the user wrote and what it means.

    Attributes
    ----------
    text : str
        The source text, kept so that a saved file reads like the loaded one.
    expr : sympy.Expr
        The parsed expression over real symbols; decimals are exact rationals.
    """

    text: str
    expr: sympy.Expr

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Expression({self.text!r})"


@lru_cache(maxsize=MAX_SYMBOLS)
def symbol(name: str) -> sympy.Symbol:
    """The real symbol every part of certrack uses for `name`."""
    return sympy.Symbol(name, real=True)


def check_name(key: str, name: Any, used: Iterable[str] = ()) -> str:
    """Refuse a name that is not an identifier, is reserved, or is used already."""
    if not isinstance(name, str) or not _IDENTIFIER.fullmatch(name) or keyword.iskeyword(name):
        raise InputError(
            key, "names must be identifiers: a letter, then letters, digits and _", name
        )
    if name in RESERVED_NAMES:
        raise InputError(
            key, "this name is reserved (function, time or number)", name, "Choose another name"
        )
    if name in used:
        raise InputError(key, "names must be different from each other", name)
    return name


def parse(key: str, text: Any, names: Iterable[str] | Mapping[str, Any] | None = ()) -> Expression:
    """Parse `text`, a formula in the given names.

    Parameters
    ----------
    key : str
        Where the text stands, for messages.
    text : str, int, float, sympy.Expr or Expression
        The formula. A SymPy expression is taken by its own text, so the same rules hold.
    names : iterable of str, or mapping to numbers, or None
        Symbols that may occur; with a mapping, each name is replaced by its number (or by its
        formula, which may contain other symbols). With None any name may occur: for a formula whose
        names are checked later.

    Returns
    -------
    Expression

    Raises
    ------
    InputError
        For anything outside the white list or beyond the size bounds.
    """
    if isinstance(text, Expression):
        text = text.text
    if isinstance(text, sympy.Rational):  # known exactly: its digits need not fit into a text
        return _exact_number(key, text)
    if isinstance(text, sympy.Basic):
        text = text_of(text)
    if isinstance(text, numbers.Real) and not isinstance(text, (bool, int, float)):
        text = int(text) if isinstance(text, numbers.Integral) else float(text)  # NumPy's
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        raise InputError(key, "must be a formula (text) or a number", text)
    if isinstance(text, (int, float)):
        text = _number_text(key, text)
    return Expression(text, _Builder(key, text, names).build())


def _exact_number(key: str, value: sympy.Rational) -> Expression:
    if too_long(value) or not abs(float(value)) <= MAX_MAGNITUDE:
        raise InputError(key, "must be a finite number of sane size", str(value))
    return Expression(str(value), value)


def _number_text(key: str, value: float) -> str:
    if not abs(value) <= MAX_MAGNITUDE:
        raise InputError(key, "must be a finite number", value)
    if isinstance(value, RationalFloat):
        return value.text
    return repr(int(value)) if isinstance(value, int) else repr(float(value))


def number(key: str, text: Any, names: Mapping[str, Any] | None = None) -> Expression:
    """Parse a formula that must be a finite number once the constants are put in."""
    expression = parse(key, text, names or {})
    if expression.expr.free_symbols:  # pragma: no cover - the builder knows no other names
        raise InputError(key, "must be a number", expression.text)
    return expression


class _Builder:
    """One pass over the syntax tree; every node yields (SymPy expression, float or None)."""

    def __init__(
        self, key: str, text: str, names: Iterable[str] | Mapping[str, Any] | None
    ) -> None:
        self.key, self.text = key, text
        self.any_name = names is None
        self.names = names if isinstance(names, Mapping) else frozenset(names or ())
        self.nodes = 0

    def fail(self, expected: str, got: Any = None, remedy: str = "") -> InputError:
        return InputError(self.key, expected, self.text if got is None else got, remedy)

    def build(self) -> sympy.Expr:
        if len(self.text) > MAX_LENGTH:
            raise self.fail(
                f"formula is longer than {MAX_LENGTH} characters", f"{len(self.text)} characters"
            )
        depth = 0
        for char in self.text:
            depth += (char in "([{") - (char in ")]}")
            if depth > MAX_NESTING:
                raise self.fail(f"formula is nested deeper than {MAX_NESTING}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # e.g. "1if": the tree decides, not the warning
                tree = ast.parse(self.text.strip(), mode="eval")
            expr, value = self.visit(tree.body, 0)
            expr = without_fine_roots(expr)
        except (SyntaxError, ValueError, MemoryError, RecursionError) as problem:
            if isinstance(problem, InputError):
                raise
            got = None if self.text.strip() else "an empty text"
            raise self.fail("is not a formula (syntax)", got, syntax_remedy(self.text)) from None
        if value is None and not expr.free_symbols:
            value = self.checked(lambda: float(expr))
        if expr.has(sympy.nan, sympy.oo, sympy.zoo, sympy.I):
            raise self.fail("is not a finite real formula")
        for constant in expr.atoms(sympy.Rational):  # x*1e300*1e300 merges its factors
            self.checked(partial(float, constant))
        return expr

    def visit(self, node: ast.AST, depth: int) -> tuple[sympy.Expr, float | None]:
        self.nodes += 1
        if self.nodes > MAX_NODES or depth > MAX_NESTING:
            raise self.fail(
                f"formula is too large (more than {MAX_NODES} parts or deeper than {MAX_NESTING})"
            )
        match node:
            case ast.Constant(value=value):
                return self.constant(value)
            case ast.Name(id=name):
                return self.name(name)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
                expr, value = self.visit(operand, depth + 1)
                if isinstance(op, ast.UAdd):
                    return expr, value
                return -expr, None if value is None else -value
            case ast.BinOp(left=left, op=op, right=right):
                return self.binary(op, self.visit(left, depth + 1), self.visit(right, depth + 1))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                return self.call(name, [self.visit(arg, depth + 1) for arg in args])
        raise self.fail(
            f"{type(node).__name__} is not allowed in a formula",
            remedy=node_remedy(node, self.text)
            or "Allowed: names, numbers, + - * / **, and " + ", ".join(sorted(ALLOWED_FUNCTIONS)),
        )

    def name(self, name: str) -> tuple[sympy.Expr, float | None]:
        if name == "pi":
            return sympy.pi, math.pi
        if name in self.names and isinstance(self.names, Mapping):
            value = self.names[name]
            exact = sympy.nsimplify(value) if isinstance(value, Fraction) else sympy.sympify(value)
            return exact, None if exact.free_symbols else self.checked(partial(float, exact))
        if name in self.names or self.any_name:
            return symbol(name), None
        known = sorted({*self.names, "pi"})
        shown = ", ".join(known[:MAX_NAMES_SHOWN]) + ", ..." * (len(known) > MAX_NAMES_SHOWN)
        raise self.fail(
            f"unknown name {shorten(name)!r}", remedy=f"{hint(name, known)}Known here: {shown}"
        )

    def constant(self, value: Any) -> tuple[sympy.Expr, float]:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.fail(f"{type(value).__name__} is not a number", value)
        if isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
            raise self.fail(f"a number is larger than {MAX_MAGNITUDE:g}")
        if not abs(value) <= MAX_MAGNITUDE:
            raise self.fail(f"a number is larger than {MAX_MAGNITUDE:g}")
        exact = Fraction(repr(value))  # the decimal text, not the binary float
        return sympy.Rational(exact.numerator, exact.denominator), float(value)

    def binary(
        self,
        op: ast.operator,
        left: tuple[sympy.Expr, float | None],
        right: tuple[sympy.Expr, float | None],
    ) -> tuple[sympy.Expr, float | None]:
        (a, va), (b, vb) = left, right
        if isinstance(op, ast.Pow):
            return self.power(a, va, b, vb)
        compute = _ARITHMETIC.get(type(op))
        if compute is None:
            message = f"operator {type(op).__name__} is not allowed in a formula"
            raise self.fail(message, remedy=node_remedy(op, self.text))
        if isinstance(op, ast.Div) and (vb == 0 or b == 0):
            raise self.fail("divides by zero")
        is_constant = va is not None and vb is not None
        value = self.checked(partial(compute, va, vb)) if is_constant else None
        expr = compute(a, b)
        return self.exact(expr) if isinstance(op, (ast.Mult, ast.Div)) else expr, value

    def power(
        self, a: sympy.Expr, va: float | None, b: sympy.Expr, vb: float | None
    ) -> tuple[sympy.Expr, float | None]:
        va, vb = self.constant_value(a, va), self.constant_value(b, vb)
        if vb is None and self.any_name:  # it may be a constant
            return a**b, None
        if vb is None:
            raise self.fail("an exponent must be a number", remedy="Write exp(y*log(x))")
        if abs(vb) > MAX_POWER:
            raise self.fail(f"an exponent is larger than {MAX_POWER}")
        if va is not None:
            value = self.checked(lambda: math.pow(va, vb))
            return self.exact(self.built(power, a, b)), value
        if vb < 0 and a == 0:
            raise self.fail("divides by zero")
        result = self.built(power, a, b)
        merged = result.exp if isinstance(result, sympy.Pow) else sympy.S.One
        if merged.is_number and abs(merged) > MAX_POWER:  # (x**64)**64 merges its exponents
            raise self.fail(f"an exponent is larger than {MAX_POWER}")
        return result, None

    def call(
        self, name: str, args: list[tuple[sympy.Expr, float | None]]
    ) -> tuple[sympy.Expr, float | None]:
        if name not in ALLOWED_FUNCTIONS:
            known = f"{hint(name, ALLOWED_FUNCTIONS)}Known: {', '.join(sorted(ALLOWED_FUNCTIONS))}"
            known = f"Write {name}*(...)" if name in self.names else known
            raise self.fail(f"unknown function {shorten(name)!r}", remedy=known)
        function, compute, fewest, most = ALLOWED_FUNCTIONS[name]
        build = partial(self.built, _BUILDERS.get(function, function))
        if not fewest <= len(args) <= most:
            message, got = f"{name} takes {fewest} to {most} arguments", f"{len(args)} arguments"
            raise self.fail(message, got, decimal_comma(self.text))
        args = [(expr, self.constant_value(expr, value)) for expr, value in args]
        exprs = [without_fine_roots(expr) for expr, _ in args]
        values = [value for _, value in args if value is not None]
        if len(values) == len(args):
            return build(*exprs), self.checked(lambda: compute(*values))
        if name in ("min", "max") and len(exprs) > 1:  # SymPy would compare all pairs
            return function(*exprs, evaluate=False), None
        # |exp(acos(x))| would become exp(re(acos(x))), and tan(x + pi/2) a cotangent
        if (result := build(*exprs)).has(*FOREIGN):
            result = function(*exprs, evaluate=False)
        return result, None

    def built(self, build: Callable[..., sympy.Expr], *args: sympy.Expr) -> sympy.Expr:
        """What SymPy makes of a function or power; it has no value for some."""
        try:
            return build(*args)
        except OverflowError:
            raise self.fail("a constant in the formula has too many digits") from None
        except (ArithmeticError, TypeError, AttributeError, NotImplementedError):
            raise self.fail("a part of the formula has no value") from None

    def constant_value(self, expr: sympy.Expr, value: float | None) -> float | None:
        """The value of a part whose names have cancelled (x1 - x1), before SymPy computes on it."""
        if value is None and not expr.free_symbols:
            return self.checked(lambda: float(expr))
        return value

    def checked(self, compute: Callable[[], Any]) -> float:
        """The constant's value, refused unless it is a finite real number of sane size."""
        try:
            value = float(compute())
        except (ArithmeticError, ValueError, TypeError):
            raise self.fail("a constant in the formula is not a finite real number") from None
        if not abs(value) <= MAX_MAGNITUDE:
            raise self.fail("a constant in the formula is not a finite real number")
        return value

    def exact(self, expr: sympy.Expr) -> sympy.Expr:
        """Refuse rationals that grow without bound under repeated multiplication."""
        if too_long(expr):
            raise self.fail("a constant in the formula has too many digits")
        return expr
