"""Formulas, against an evaluator of our own on 60 (or 400) digits.

The text is parsed by Python's own parser and evaluated by mpmath, node by node; neither SymPy nor
the product takes part. A formula that the product accepts must have the same value wherever both
are defined; and it must not accept what is no arithmetic.
"""

import ast
import random
from typing import Any

import mpmath
import sympy

from certrack.core.errors import CertrackError
from certrack.core.expressions import parse
from fuzz.runner import Finding

NAMES = ("x1", "x2", "t")
POINTS = ({"x1": 0.7, "x2": -1.3, "t": 2.1}, {"x1": -2.2, "x2": 0.4, "t": 0.3})
RELATIVE_ERROR = 1e-9

#: Larger numbers are not followed: their digits are more than the precision has.
LARGEST = mpmath.mpf("1e50")

#: What is smaller is zero to 60 digits.
RESIDUE = mpmath.mpf("1e-50")

ONE_ARGUMENT = (
    "sin cos tan asin acos atan sinh cosh tanh exp log sqrt abs sign".split()  # white list
)
#: What SymPy makes of quotients of them.
OF_SYMPY = "cot sec csc coth sech csch asinh acosh atanh".split()

NUMBERS = (
    "0 1 2 3 0.5 1e-3 1.5e2 10 7 0.1 .25 5. 1e300 1e-300 64 12345678901234567890 1_0 00 0x1F 0b1 "
    "1e400 1j 4.076 1e-7 0.0000001 33.5 1e16 1.0000001"
).split()
EXPONENTS = (
    "2 3 0.5 -1 -2 1/2 (1/3) 0 1.5 -0.5 4 64 65 0.0000001 1e-300 (1/7) 3.7 -64 x1 0.123456789"
).split()

#: Texts that try what a formula must not do, or that were slow or wrong in some version.
ATTACKS = (
    '__import__("os").system("true")',
    "x1.__class__.__mro__",
    "(lambda: x1)()",
    "[x for x in (1,2)]",
    "(x1:=2)",
    "x1 if t else x2",
    'f"{x1}"',
    '"a"*9',
    "sin(x=1)",
    "sin(*[1])",
    "sin(**{})",
    "x1[0]",
    "...",
    "True",
    "x1<x2",
    "await x1",
    "a;b",
    "sin",
    "E",
    "oo",
    "zoo",
    "nan",
    'sympify("1")',
    "10**10**10",
    "2**64**64",
    "exp(exp(exp(99)))",
    "exp(700)*exp(700)",
    "9**9**9**9",
    "sin(10**300)",
    "(x1**64)**64",
    "x1**64**2",
    "(1/3)**64" + "*(1/3)**64" * 100,
    "(x1+x2+t)**64",
    "(" * 99 + "x1" + ")" * 99,
    "-" * 99 + "x1",
    "+".join(["x1"] * 1999),
    "*".join(["(x1+1)"] * 600),
    "**".join(["x1"] * 20),
    "abs(" * 90 + "x1" + ")" * 90,
    "sqrt(" * 90 + "2" + ")" * 90,
    "tan(" * 60 + "x1" + ")" * 60,
    "max(" + ",".join(["x1", "x2", "t", "1", "2", "3", "4", "5"]) + ")",
    "max(max(max(x1,x2),max(x1,t)),max(max(x2,t),max(x1,-x2)))",
    "cosh(" * 20 + "0" + ")" * 20,
    "exp(" * 5 + "x1-x1" + ")" * 5,
    "(x1-x1)**-1",
    "0**0",
    "0**-1",
    "(x1-x1)**(x1-x1)",
    "x1/0",
    "atan2(0,0)",
    "log(0)",
    "sqrt(-1)",
    "sqrt(-x1**2)",
    "acos(2)",
    "asin(1.0000001)",
    "(-8)**(1/3)",
    "1e308*10",
    "7" * 4301,
    "0." + "1" * 5000,
    "1e-1000000",
    "x1**1e-300",
    "x1**0.123456789",
    "4.076**0.0000001",
    "1.0000001**0.0000001",
    "12345678901234567890**(1/7)",
    "2**0.1234567890123",
    "(2/3)**0.33333333333",
    "exp(1)**64",
    "(pi+exp(1)+sqrt(2))**64",
    "tan(pi/2)",
    "cos(1)**64*1e300",
    "((((x1**2)**2)**2)**2)**2",
    "-2**2",
    "x1**-x2",
    "5%3",
    "sign(sign(x1))",
    "abs(-0.0)",
    "min(x1,x1)",
    "max(1,1)",
    "acos(cos(3))",
)
MANGLERS = [*"()+-*/.,e x1t_0[]\"'\\:=<>!%@^&|~#\n\t", "sin(", "**", "abs("]
NOISE = "x12t()+-*/.,e 0_[]{}<>=!&|^%@:;\"'\\\n\t#$~`é\u0661\uff11\x00\u202e"


class Expressions:
    """Formulas of states and time."""

    name, suffix = "expressions", ".txt"

    def make(self, rng: random.Random) -> bytes:
        kind = rng.random()
        if kind < 0.6:
            text = formula(rng, rng.choice([1, 2, 3, 3, 4, 5]))
        elif kind < 0.85:
            text = mangled(rng, formula(rng, 3))
        elif kind < 0.93:
            text = mangled(rng, rng.choice(ATTACKS))
        elif kind < 0.94:
            text = rng.choice(ATTACKS)
        else:
            text = "".join(rng.choice(NOISE) for _ in range(rng.randrange(1, 30)))
        return text.encode()

    def examine(self, data: bytes) -> str:
        text = data.decode()
        try:
            expression = parse("key", text, NAMES)
        except CertrackError as refusal:
            if "\n" in str(refusal) or len(str(refusal)) > 1000:
                raise Finding("a message of more than one line") from None
            return "refused"
        try:
            tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError):
            raise Finding("accepted, though it is no Python expression") from None
        words = {compared(tree, expression.expr, point) for point in POINTS}
        return "compared" if "compared" in words else words.pop()


def formula(rng: random.Random, depth: int) -> str:
    """A random formula; now and then with something that is not allowed."""
    kind = rng.random()
    if depth <= 0 or kind < 0.22:
        kind = rng.random()
        if kind < 0.5:
            return rng.choice(NAMES)
        if kind < 0.6:
            return "pi"
        return rng.choice(NUMBERS) if kind < 0.8 else str(round(rng.uniform(-5, 5), 3))
    if kind < 0.62:
        allowed = ["+", "-", "*", "/", "+", "*", "-", "**"]
        operator = rng.choice(["//", "%", "@", "<<", "&"] if rng.random() < 0.01 else allowed)
        left, right = formula(rng, depth - 1), formula(rng, depth - 1)
        if operator == "**" and rng.random() < 0.8:
            right = rng.choice(EXPONENTS)
        left = f"({left})" if rng.random() < 0.7 else left
        right = f"({right})" if rng.random() < 0.6 else right
        return left + operator + right
    if kind < 0.9:
        return f"{rng.choice(ONE_ARGUMENT)}({formula(rng, depth - 1)})"
    if kind < 0.96:
        count = rng.choice([1, 2, 2, 3, 4, 8, 9])
        arguments = ",".join(formula(rng, depth - 1) for _ in range(count))
        return f"{rng.choice(['min', 'max'])}({arguments})"
    if kind < 0.98:
        return f"atan2({formula(rng, depth - 1)},{formula(rng, depth - 1)})"
    return rng.choice(["-", "+", "--", "- "]) + formula(rng, depth - 1)


def mangled(rng: random.Random, text: str) -> str:
    """A text with some characters taken out, put in, or a piece doubled or lost."""
    for _ in range(rng.choice([1, 1, 2, 3])):
        i, kind = rng.randrange(len(text) + 1), rng.random()
        if kind < 0.4:
            text = text[:i] + text[i + 1 :]
        elif kind < 0.8:
            text = text[:i] + rng.choice(MANGLERS) + text[i:]
        else:
            j = rng.randrange(len(text) + 1)
            text = text[: min(i, j)] + text[max(i, j) :]
    return text


def compared(tree: ast.AST, expr: sympy.Expr, point: dict[str, float]) -> str:
    """Compare at one point; a word for the result."""
    with mpmath.workdps(400):
        exact = {name: mpmath.mpf(repr(value)) for name, value in point.items()}
    with mpmath.workdps(60):
        try:
            expected = float(evaluated(tree, exact))
        except Undefined:
            return "undefined"
        try:
            rounded = {name: +value for name, value in exact.items()}  # else t - t is a residue
            found = float(value_of(expr, rounded))
        except Undefined:
            return "undefined for the product"  # complex or infinite, or a step on the way
    if near(found, expected):
        return "compared"
    rng = random.Random(0)
    try:
        with mpmath.workdps(400):
            if near(found, float(evaluated(tree, exact))):
                return "compared"
        with mpmath.workdps(60):
            if near(found, float(evaluated(tree, exact, without_residue))):
                return "compared"
            noisy = [float(evaluated(tree, exact, lambda v: noise(rng, v))) for _ in range(8)]
    except Undefined:
        return "ill-conditioned"
    if not all(near(value, noisy[0]) for value in noisy):
        return "ill-conditioned"  # the sign of what is zero, for example
    raise Finding("another value than mpmath's")


def value_of(expr: sympy.Expr, values: dict[str, mpmath.mpf]) -> mpmath.mpf:
    """The value of the product's formula, node by node: SymPy would compute roots exactly."""
    if expr.is_Rational:
        return mpmath.mpf(int(expr.p)) / int(expr.q)
    if expr.is_NumberSymbol:
        return mpmath.mpf(expr.evalf(mpmath.mp.dps)._mpf_)
    if expr.is_Symbol:
        return values[expr.name]
    args = [value_of(arg, values) for arg in expr.args]
    if expr.is_Add:
        return real(mpmath.fsum(args))
    if expr.is_Mul:
        return real(mpmath.fprod(args))
    if expr.is_Pow:
        return real(operation(ast.Pow(), *args))
    if isinstance(expr, sympy.exp):
        return real(mpmath.exp(*args))
    name = {"Abs": "abs", "Max": "max", "Min": "min"}.get(expr.func.__name__, expr.func.__name__)
    if name in OF_SYMPY:
        return real(getattr(mpmath, name)(*args))
    return real(call(name, args))


def near(a: float, b: float) -> bool:
    return abs(a - b) <= RELATIVE_ERROR * max(1.0, abs(b))


def noise(rng: random.Random, value: mpmath.mpf) -> mpmath.mpf:
    """A value with an error in the 50th digit."""
    return value * (1 + mpmath.mpf(rng.uniform(-1, 1)) * mpmath.mpf("1e-50"))


def without_residue(value: mpmath.mpf) -> mpmath.mpf:
    """0 in the place of what rounding left of it, such as tan(pi): its sign is none."""
    return value if abs(value) > RESIDUE else mpmath.mpf(0)


class Undefined(Exception):
    """No real number."""


def real(value: mpmath.mpf) -> mpmath.mpf:
    """The value, if it is a real number of a size whose sine can be computed."""
    if isinstance(value, mpmath.mpc) or not mpmath.isfinite(value) or abs(value) > LARGEST:
        raise Undefined
    return value


def evaluated(
    node: ast.AST, values: dict[str, mpmath.mpf], rounded: Any = lambda v: v
) -> mpmath.mpf:
    """The value of a syntax tree; a finding if it is no arithmetic of the white list."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            value = mpmath.mpf(repr(number))
            return rounded(value) if value > 1e15 else value  # an exponent stays what it is
        case ast.Name(id="pi"):
            return rounded(+mpmath.pi)
        case ast.Name(id=name) if name in values:
            return values[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -evaluated(operand, values, rounded)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return evaluated(operand, values, rounded)
        case ast.BinOp(left=left, op=op, right=right):
            a, b = evaluated(left, values, rounded), evaluated(right, values, rounded)
            return rounded(real(operation(op, a, b)))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            numbers = [evaluated(arg, values, rounded) for arg in args]
            return rounded(real(call(name, numbers)))
    raise Finding(f"accepted {type(node).__name__}, which is no arithmetic")


def operation(op: ast.operator, a: mpmath.mpf, b: mpmath.mpf) -> mpmath.mpf:
    """An operation, or undefined."""
    try:
        return _operation(op, a, b)
    except (ArithmeticError, ValueError):
        raise Undefined from None


def _operation(op: ast.operator, a: mpmath.mpf, b: mpmath.mpf) -> mpmath.mpf:
    match op:
        case ast.Add():
            return a + b
        case ast.Sub():
            return a - b
        case ast.Mult():
            return a * b
        case ast.Div():
            return a / b
        case ast.Pow():
            return mpmath.power(a, b)
    raise Finding(f"accepted the operator {type(op).__name__}")


def call(name: str, args: list[mpmath.mpf]) -> mpmath.mpf:
    """A function, or undefined."""
    try:
        return _call(name, args)
    except (ArithmeticError, ValueError):
        raise Undefined from None


def _call(name: str, args: list[mpmath.mpf]) -> mpmath.mpf:
    match name, args:
        case "sign", [a]:
            return mpmath.sign(a)
        case "abs", [a]:
            return abs(a)
        case (("min" | "max"), [_, *_]):
            return (min if name == "min" else max)(args)
        case "atan2", [a, b]:
            if a == 0 and b == 0:
                raise Undefined
            return mpmath.atan2(a, b)
        case _, [a] if name in ONE_ARGUMENT:
            return getattr(mpmath, name)(a)
    raise Finding(f"accepted {name} of {len(args)} arguments")
