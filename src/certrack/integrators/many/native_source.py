"""The generated part of ``native.c``: a system's formulas as C of vectors."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.kinks import without_minmax
from certrack.core.printing import (
    ATOM,
    MAX_FACTORS,
    PRODUCT,
    SUM,
    FormulaPrinter,
    Part,
    recognise_selection,
)
from certrack.core.select import STEP_BEGIN, STEP_LENGTH, Select
from certrack.integrators.base import ESCAPING, MemberOutcome
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.pairs import DOP853, THIRD_ORDER_WEIGHT
from certrack.integrators.registers import GROUP_SIZE, LANES

#: Vector functions that vector_math.h has anyway, and those of two arguments.
IN_VECTOR_MATH = set("abs max min sqrt sign sin cos exp log Extremum Entry".split())
OF_TWO = {"pow", "atan2"}

#: Functions up to so many letters are inlined where they are called: the rates at every stage.
MAX_INLINED = 3000

#: How a member ended, for C.
OUTCOME_NAMES = {outcome.name.upper(): outcome.value for outcome in MemberOutcome}

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


def _short_form(select: Select) -> sympy.Expr:
    """A selection that is a single instruction as such."""
    name, arguments = recognise_selection(select) or ("", ())
    if name == "max":
        return Larger(*arguments)
    return Magnitude(*arguments) if name == "abs" else select


#: SymPy's name, or one of ours -> the function of vectors.
VECTOR_FUNCTIONS = {
    name: f"v_{name}"
    for name in "sign sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt pow "
    "Extremum Entry".split()
} | {"Abs": "v_abs", "Magnitude": "v_abs", "Larger": "v_max"}


class VectorPrinter(FormulaPrinter):
    """Formulas of vectors, every part in parentheses; sums and products as SymPy has them."""

    language = "vector"
    functions = VECTOR_FUNCTIONS

    def literal(self, value: float) -> str:
        return repr(value)

    def vector(self, expr: sympy.Expr) -> str:
        """The formula as a vector even where it is a number."""
        if not expr.free_symbols:
            return f"SPLAT({float(expr)!r})"
        text = self.text(expr, ATOM)
        scalar = all(SCALAR.match(self._names[name]) for name in expr.free_symbols)
        return f"SPLAT({text})" if scalar else text

    def argument(self, formula: sympy.Expr) -> str:
        return self.vector(formula)

    def choice(self, expr: sympy.Expr) -> Part:
        return self.call("greater", *expr.args)

    _print_Select = choice

    def _print_Add(self, expr: sympy.Add) -> Part:
        return " + ".join(self.text(arg, ATOM) for arg in expr.args), SUM

    def _print_Mul(self, expr: sympy.Mul) -> Part:
        return "*".join(self.text(arg, ATOM) for arg in expr.args), PRODUCT

    def _print_Pow(self, expr: sympy.Pow) -> Part:
        base, exponent = expr.args
        if not (exponent.is_Rational and exponent.q in (1, 2)):
            return self.call("v_pow", base, exponent)
        root = self.vector(base) if exponent.q == 1 else self.call("v_sqrt", base)[0]
        power = _power(root, abs(int(exponent.p)))
        return (power if exponent.p > 0 else f"(1.0/{power})"), ATOM


def _power(base: str, exponent: int) -> str:
    if exponent == 1:
        return base
    if exponent > MAX_FACTORS:
        return f"v_pow({base}, SPLAT({float(exponent)!r}))"
    return "(" + "*".join([base] * exponent) + ")"


#: Writes a C function of the system: its name, its arguments, what it assigns to each of them, and
#: the names of further symbols.
FunctionWriter = Callable[..., str]


@dataclass(frozen=True)
class StepSource:
    """What the steps of native.c want of ``system.h`` besides the system.

    Attributes
    ----------
    stages : int
    tables : tuple of str
        The coefficients of the method, as C.
    dense : (d, s+1) array
        Coefficients of its dense output, as those of :class:`~certrack.integrators.pairs.Pair`.
    functions : callable, optional
        Gets the flow, in which what depends on time alone is one symbol each, and a
        :data:`FunctionWriter`; returns further parts of the header.
    """

    stages: int
    tables: tuple[str, ...]
    dense: np.ndarray
    functions: Callable[[AugmentedFlow, FunctionWriter], list[str]] | None = None


def system_header(
    flow: AugmentedFlow, shown: Sequence[sympy.Expr], steps: StepSource | None = None
) -> str:
    """The generated part of native.c: sizes, tables of the method, and functions of the system.

    Parameters
    ----------
    flow : AugmentedFlow
    shown : formulas
        Formulas of the states and of the signals' symbols at the end of a step.
    steps : StepSource, optional
        By default explicit ones.
    """
    steps = steps or _explicit_steps()
    dense = np.pad(steps.dense, ((0, 0), (0, -steps.dense.shape[1] % 8)))  # whole vectors
    timeless, common = flow.without_time()
    names: dict[sympy.Symbol, str] = {TIME: "t", STEP_BEGIN: "begin", STEP_LENGTH: "h"}
    for letter, symbols in (
        ("c", list(common.values())),
        ("x", flow.states),
        ("p", flow.parameters),
        ("s", (*flow.shared, *flow.numbers)),
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
        "SHARED": len(flow.shared) + len(flow.numbers),
        "COMMON": len(common),
        "INTEGRALS": len(flow.integrands),
        "SIGNALS": len(flow.signals),
        "MEMORIES": len(flow.memories),
        "SHOWN": len(shown),
        "STAGES": steps.stages,
        "TERMS": len(dense),
        "SURFACES": len(flow.held),
    }
    assert sizes["SHOWN"] and sizes["SIGNALS"] and sizes["MEMORIES"]

    def function(
        name: str,
        arguments: str,
        *results: tuple[str, Sequence[sympy.Expr]],
        more: Mapping[sympy.Symbol, str] = MappingProxyType({}),
    ) -> str:
        targets = [(f"{to}[{i}]", f) for to, formulas in results for i, f in enumerate(formulas)]
        return c_function(name, arguments, targets, {**names, **more})

    memories = [formula for _, formula in timeless.memories]
    parts = [
        c_enum(sizes),
        c_enum(OUTCOME_NAMES),
        f"static const double ESCAPING = {ESCAPING!r};",
        *steps.tables,
        c_table("DENSE", dense),
        function("common", "V t, const double *s, V *out", ("out", list(common))),
        function(
            "rates",
            "const double *s, const double *c, const V *x, const V *p, V *k, V *q",
            ("k", timeless.rates),
            ("q", timeless.integrands),
        ),
        function(
            "signals",
            "const double *s, const double *c, const V *x, const V *p, const V *k, V *out",
            ("out", timeless.signals),
        ),
        function(
            "memories",
            "double begin, double h, const double *s, const double *c, const V *p, const V *y, "
            "const V *y_end, V *m",
            ("m", memories),
        ),
        c_table("HELD", np.array([*flow.held, 0.0])).replace("double", "int").replace(".0", ""),
        function(
            "surfaces",
            "const double *s, const double *c, const V *x, const V *p, V *f, V *d, V *e",
            *zip(("f", "d", "e"), _thirds(timeless.surfaces), strict=True),
        ),
        function("shown", "const V *x, const V *y_end, V *out", ("out", shown)),
    ]
    if steps.functions is not None:
        parts += steps.functions(timeless, function)
    return with_elementary(parts)


def _thirds(formulas: Sequence[sympy.Expr]) -> list[Sequence[sympy.Expr]]:
    count = len(formulas) // 3
    return [formulas[i * count : (i + 1) * count] for i in range(3)]


def with_elementary(parts: Sequence[str]) -> str:
    """The parts, preceded by the vector forms of the elementary functions that they call."""
    text = "\n".join(parts) + "\n"
    called = sorted(set(re.findall(r"\bv_(\w+)\(", text)) - IN_VECTOR_MATH)
    macros = {name: "ELEMENTARY_OF_TWO" if name in OF_TWO else "ELEMENTARY" for name in called}
    return "".join(f"{macro}({name})\n" for name, macro in macros.items()) + text


def _explicit_steps() -> StepSource:
    """Coefficients of DOP853 and of its dense output."""
    fifth, third = DOP853.errors
    assert fifth[-1] == third[-1] == 0  # the error estimate does not need the slope at the end
    assert DOP853.dense is not None
    tables = (
        c_table("A", DOP853.A),
        c_table("B", DOP853.B),
        c_table("C", np.append(DOP853.C, 1.0)),
        c_table("E3", third),
        c_table("E5", fifth),
        f"static const double THIRD_ORDER_WEIGHT = {THIRD_ORDER_WEIGHT!r};",
    )
    return StepSource(DOP853.stages, tables, DOP853.dense)


def c_enum(values: Mapping[str, int]) -> str:
    """C names of integers."""
    return "enum { " + ", ".join(f"{name} = {value}" for name, value in values.items()) + " };"


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
        without_minmax(formula).replace(Select, lambda *args: _short_form(Select(*args)))
        for _, formula in results
    ]
    common, reduced = sympy.cse(formulas, temporaries)
    known = names | {symbol: f"{symbol.name}_" for symbol, _ in common}
    printer = VectorPrinter(known)
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
