"""The generated part of ``native.c``: a system's formulas as C of vectors."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy
from sympy.printing.c import C99CodePrinter

from certrack.core.expressions import TIME, without_minmax
from certrack.core.select import STEP_BEGIN, STEP_LENGTH, Select
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.many.registers import GROUP_SIZE, LANES
from certrack.integrators.pairs import DOP853

#: Vector functions that vector_math.h has anyway, and those of two arguments.
IN_VECTOR_MATH = set("abs max min sqrt sign sin cos exp log Extremum Entry".split())
OF_TWO = {"pow", "atan2"}

#: Functions up to so many letters are inlined where they are called: the rates at every stage.
MAX_INLINED = 3000

#: Names of numbers that are not vectors: the same for all members.
SCALAR = re.compile(r"[cs]\[|begin$|h$")


class Magnitude(sympy.Function):
    """|a|; SymPy's own would be rewritten."""

    nargs = 1
    is_real = True


class Larger(sympy.Function):
    """max(a, b)."""

    nargs = 2
    is_real = True


def _shorter(select: Select) -> sympy.Expr:
    """A selection that is a single instruction as such."""
    a, b, yes, no = select.args
    if (yes, no) == (a, b):
        return Larger(a, b)
    return Magnitude(a) if b == 0 and (yes, no) == (a, -a) else select


class _Printer(C99CodePrinter):
    """Formulas of vectors: known names, products for small powers, selections for kinks."""

    def __init__(self, names: dict[sympy.Symbol, str]) -> None:
        super().__init__()
        self._names = names

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        return self._names[expr]

    def _print_number(self, expr: sympy.Expr) -> str:
        value = repr(float(expr))
        return f"({value})" if value.startswith("-") else value

    _print_Rational = _print_Integer = _print_Float = _print_number

    def vector(self, expr: sympy.Expr) -> str:
        """The formula as a vector even where it is a number."""
        if not expr.free_symbols:
            return f"SPLAT({float(expr)!r})"
        text = self._print(expr)
        scalar = all(SCALAR.match(self._names[name]) for name in expr.free_symbols)
        return f"SPLAT({text})" if scalar else text

    def _print_Mul(self, expr: sympy.Mul) -> str:
        return "(" + "*".join(self._print(arg) for arg in expr.args) + ")"

    def _print_Add(self, expr: sympy.Add) -> str:
        return "(" + " + ".join(self._print(arg) for arg in expr.args) + ")"

    def _print_Pow(self, expr: sympy.Pow) -> str:
        base, exponent = expr.args
        if exponent.is_Rational and exponent.q in (1, 2):
            root = f"v_sqrt({self.vector(base)})" if exponent.q == 2 else self.vector(base)
            power = _power(root, abs(int(exponent.p)))
            return power if exponent.p > 0 else f"(1.0/{power})"
        return f"v_pow({self.vector(base)}, {self.vector(exponent)})"

    def _print_Function(self, expr: sympy.Function) -> str:
        arguments = [self.vector(arg) for arg in expr.args]
        if isinstance(expr, Select):
            a, b, yes, no = arguments
            return f"greater({a}, {b}, {yes}, {no})"
        if expr.is_number:
            return self._print_number(expr)
        names = {sympy.Abs: "v_abs", sympy.sign: "v_sign", sympy.atan2: "v_atan2"}
        names |= {Magnitude: "v_abs", Larger: "v_max"}
        name = names.get(type(expr)) or f"v_{type(expr).__name__}"
        return f"{name}({', '.join(arguments)})"

    _print_Abs = _print_sign = _print_sin = _print_cos = _print_tan = _print_Function
    _print_asin = _print_acos = _print_atan = _print_atan2 = _print_Function
    _print_sinh = _print_cosh = _print_tanh = _print_exp = _print_log = _print_Function
    _print_Select = _print_Extremum = _print_Entry = _print_Function
    _print_Magnitude = _print_Larger = _print_Function

    def _print_NumberSymbol(self, expr: sympy.Expr) -> str:
        return self._print_number(expr)


def _power(base: str, exponent: int) -> str:
    if exponent == 1:
        return base
    if exponent > 8:
        return f"v_pow({base}, SPLAT({float(exponent)!r}))"
    return "(" + "*".join([base] * exponent) + ")"


def system_header(flow: AugmentedFlow, shown: Sequence[sympy.Expr]) -> str:
    """The generated part of native.c: sizes, tables of the method, and functions of the system.

    Parameters
    ----------
    flow : AugmentedFlow
    shown : formulas
        Of the states and of the signals' symbols at the end of a step.
    """
    timeless, common = flow.without_time()
    names: dict[sympy.Symbol, str] = {TIME: "t", STEP_BEGIN: "begin", STEP_LENGTH: "h"}
    for letter, symbols in (
        ("c", list(common.values())),
        ("x", flow.states),
        ("p", flow.parameters),
        ("s", flow.shared),
        ("k", flow.slopes),
        ("y", [begin for begin, _ in flow.sides]),
        ("y_end", [end for _, end in flow.sides]),
        ("m", [symbol for symbol, _ in flow.memories]),
    ):
        names |= {symbol: f"{letter}[{i}]" for i, symbol in enumerate(symbols)}
    sizes = {
        "BLOCKS": GROUP_SIZE // LANES,
        "STATES": len(flow.states),
        "WATCHED": flow.watched,
        "PARAMETERS": len(flow.parameters),
        "SHARED": len(flow.shared),
        "COMMON": len(common),
        "INTEGRALS": len(flow.integrands),
        "SIGNALS": len(flow.signals),
        "MEMORIES": len(flow.memories),
        "SHOWN": len(shown),
        "STAGES": DOP853.stages,
        "TERMS": len(_dense_rows()),
    }
    assert sizes["SHOWN"] and sizes["SIGNALS"] and sizes["MEMORIES"]

    def function(name: str, arguments: str, *results: tuple[str, Sequence[sympy.Expr]]) -> str:
        targets = [(f"{to}[{i}]", f) for to, formulas in results for i, f in enumerate(formulas)]
        return c_function(name, arguments, targets, names)

    memories = [formula for _, formula in timeless.memories]
    parts = [
        "enum { " + ", ".join(f"{name} = {size}" for name, size in sizes.items()) + " };",
        f"static const double ESCAPING = {ESCAPING!r};",
        *_tables(),
        function("common", "V t, const double *s, V *out", ("out", list(common))),
        function(
            "rates",
            "const double *c, const V *x, const V *p, V *k, V *q",
            ("k", timeless.rates),
            ("q", timeless.integrands),
        ),
        function(
            "signals",
            "const double *c, const V *x, const V *p, const V *k, V *out",
            ("out", timeless.signals),
        ),
        function(
            "memories",
            "double begin, double h, const double *c, const V *p, const V *y, const V *y_end, V *m",
            ("m", memories),
        ),
        function("shown", "const V *x, const V *y_end, V *out", ("out", shown)),
    ]
    return with_elementary(parts)


def with_elementary(parts: Sequence[str]) -> str:
    """The parts, preceded by the vector forms of the elementary functions that they call."""
    text = "\n".join(parts) + "\n"
    called = sorted(set(re.findall(r"\bv_(\w+)\(", text)) - IN_VECTOR_MATH)
    macros = {name: "ELEMENTARY_OF_TWO" if name in OF_TWO else "ELEMENTARY" for name in called}
    return "".join(f"{macro}({name})\n" for name, macro in macros.items()) + text


def _tables() -> list[str]:
    """Coefficients of the method and of its dense output."""
    fifth, third = DOP853.errors
    assert fifth[-1] == third[-1] == 0  # the error estimate does not need the slope at the end
    return [
        c_table("A", DOP853.A),
        c_table("B", DOP853.B),
        c_table("C", np.append(DOP853.C, 1.0)),
        c_table("E3", third),
        c_table("E5", fifth),
        c_table("DENSE", _dense_rows()),
    ]


def _dense_rows() -> np.ndarray:
    """Coefficients of the dense output; rows are filled up to whole vectors."""
    assert DOP853.dense is not None
    return np.pad(DOP853.dense, ((0, 0), (0, -DOP853.dense.shape[1] % 8)))


def c_table(name: str, table: np.ndarray) -> str:
    """C constant array of a table's numbers."""
    shape = "".join(f"[{size}]" for size in table.shape)
    return f"static const double {name}{shape} = {braces(table.tolist())};"


def braces(values: Any) -> str:
    """Nested lists of numbers as a C initialiser."""
    if isinstance(values, list):
        return "{" + ", ".join(map(braces, values)) + "}"
    return repr(values)


def c_function(
    name: str,
    arguments: str,
    results: Sequence[tuple[str, sympy.Expr]],
    names: dict[sympy.Symbol, str],
) -> str:
    """A C function that assigns the results; common subexpressions are computed once."""
    temporaries = sympy.numbered_symbols("c", real=True)
    formulas = [
        without_minmax(formula).replace(Select, lambda *args: _shorter(Select(*args)))
        for _, formula in results
    ]
    common, reduced = sympy.cse(formulas, temporaries)
    known = names | {symbol: f"{symbol.name}_" for symbol, _ in common}
    printer = _Printer(known)
    unused = "".join(
        f"  (void){argument.split('*')[-1].split()[-1]};\n" for argument in arguments.split(", ")
    )
    lines = [f"  V {known[symbol]} = {printer.vector(formula)};" for symbol, formula in common]
    lines += [
        f"  V r{i}_ = {printer.vector(formula)};" for i, formula in enumerate(reduced)
    ]  # all before the first is assigned: a result may be an argument of another
    lines += [f"  {target} = r{i}_;" for i, (target, _) in enumerate(results)]
    body = "\n".join(lines)
    kind = "INLINE" if len(body) < MAX_INLINED else "static"
    return f"{kind} void {name}({arguments}) {{\n{unused}{body}\n}}\n"
