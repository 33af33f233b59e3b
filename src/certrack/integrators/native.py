"""Members in the lanes of vector registers: C written for the system, compiled where it runs.

The fastest way by far, where there is a C compiler with GCC's vector extensions (gcc, clang);
``lanes.c`` beside this file holds the method, ``vector_math.h`` the arithmetic; this module writes
the system for them.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from scipy.integrate import DOP853
from sympy.printing.c import C99CodePrinter

from certrack.expressions import TIME, without_minmax
from certrack.integrators.flow import BEGIN, STEP, Flow
from certrack.lowering import Select

FLAGS = (
    "-std=gnu11 -O3 -march=native -fno-math-errno -fno-trapping-math -fno-signed-zeros "
    "-fschedule-insns -shared -fPIC"
).split()
WIDE = ["-mprefer-vector-width=512"]

#: The error estimate of DOP853 exceeds its error by far: this many times the tolerance is allowed.
#: The error of the states then still stays below the tolerance (a test measures it).
CAUTION = 10.0

#: Outcome of a member whose group took too many steps, or none that is long enough.
STUCK = 2

#: A compilation that takes longer has failed, s.
PATIENCE = 300

#: Vector functions of the C library, from the most to none: older ones lack some or all.
VECTOR_MATH = (
    ["-DVECTOR_MATH", "-DMORE_VECTOR_MATH", "-lmvec", "-lm"],
    ["-DVECTOR_MATH", "-lmvec", "-lm"],
    ["-lm"],
)

#: Vector functions that lanes.c has anyway, and those of two arguments.
OWN = set("abs max min sqrt sign sin cos exp log Extremum Entry".split())
OF_TWO = {"pow", "atan2"}


@lru_cache(maxsize=1)
def compiler() -> str | None:
    """Path of a C compiler that can do it, or None."""
    for name in ("gcc", "cc", "clang"):
        path = shutil.which(name)
        if path is not None and _attempt(path, "int main(void) { return 0; }\n", []) is not None:
            return path
    return None


class Unavailable(Exception):
    """Compiled C cannot be had on this machine."""


def _attempt(path: str, source: str, flags: Sequence[str]) -> ctypes.CDLL | None:
    """The shared library compiled from `source`, or None."""
    try:
        with tempfile.TemporaryDirectory(prefix="certrack-") as folder:
            text, made = Path(folder) / "lanes.c", Path(folder) / "lanes.so"
            text.write_text(source, "utf-8")
            command = [path, *FLAGS, str(text), "-o", str(made), *flags]
            subprocess.run(command, capture_output=True, check=True, timeout=PATIENCE)
            return ctypes.CDLL(str(made))  # stays loaded when the file is gone
    except (OSError, subprocess.SubprocessError):
        return None


def _shipped(name: str) -> str:
    return (files("certrack.integrators") / name).read_text("utf-8")


class _Task(ctypes.Structure):
    """As in lanes.c."""

    _fields_ = [
        ("count", ctypes.c_int64),
        ("pitch", ctypes.c_int64),
        ("starts", ctypes.c_void_p),
        ("parameters", ctypes.c_void_p),
        ("segments", ctypes.c_int64),
        ("edges", ctypes.c_void_p),
        ("shared", ctypes.c_void_p),
        ("points", ctypes.c_int64),
        ("grid", ctypes.c_void_p),
        ("centre", ctypes.c_void_p),
        ("pace", ctypes.c_void_p),
        ("tolerance", ctypes.c_double),
        ("limit", ctypes.c_double),
        ("most", ctypes.c_int64),
        ("values", ctypes.c_void_p),
        ("totals", ctypes.c_void_p),
        ("ends", ctypes.c_void_p),
        ("outcomes", ctypes.c_void_p),
        ("steps", ctypes.c_void_p),
    ]


@dataclass(frozen=True)
class Timeline:
    """What all members share.

    Attributes
    ----------
    edges : (K+1,) array, s
        Segments; between them rates and signals may jump.
    shared : (K, H) array
        Values of the shared symbols on every segment.
    grid : (T,) array, s
        Where the shown values are looked at; begins with the first edge.
    centre, unit : (R, T) and (R,) arrays
        The shown values are reduced by them: (value - centre)/unit.
    """

    edges: np.ndarray
    shared: np.ndarray
    grid: np.ndarray
    centre: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True)
class Passed:
    """What came of some members.

    Attributes
    ----------
    values : (T, R, N + padding) array of float32
        Reduced shown values; NaN after the end of a member.
    totals : (integrals + memories, N) array
    ends : (N,) array, s
    outcomes : (N,) array
        0 finished, 1 escaped, 2 stuck.
    steps : int
    """

    values: np.ndarray
    totals: np.ndarray
    ends: np.ndarray
    outcomes: np.ndarray
    steps: int


class Native:
    """A compiled :class:`Flow`; may be used by several threads at once.

    Parameters
    ----------
    flow : Flow
    shown : formulas
        Of the states and of the signals' symbols at the end of a step.

    Raises
    ------
    Unavailable
        If no compiler can do it.
    """

    def __init__(self, flow: Flow, shown: Sequence[sympy.Expr]) -> None:
        self._sizes = (len(shown), len(flow.integrands) + len(flow.memories))
        text = _shipped("lanes.c")
        text = text.replace('#include "vector_math.h"\n', _shipped("vector_math.h"))
        text = text.replace('#include "system.h"\n', system_header(flow, shown))
        path = compiler()
        if path is None:
            raise Unavailable("no C compiler (gcc or clang) was found")
        flags = ([*w, *m] for w in (WIDE, []) for m in VECTOR_MATH)
        made = next((m for f in flags if (m := _attempt(path, text, f)) is not None), None)
        if made is None:
            raise Unavailable(f"the C compiler {path} failed")
        self._library = made

    def integrate(
        self,
        starts: np.ndarray,
        parameters: np.ndarray,
        timeline: Timeline,
        tolerance: float,
        limit: float,
        most: int,
    ) -> Passed:
        """Integrate members; starts (S, N), parameters (P, N). Releases the interpreter lock."""
        count, (shown, kept) = starts.shape[1], self._sizes
        pitch = -(-count // 8) * 8 + 16  # not a power of two: rows must not share cache sets
        points = len(timeline.grid)
        steps = np.zeros(1, dtype=np.int64)
        values = np.full((points, shown, pitch), np.nan, dtype=np.float32)
        totals, ends = np.full((kept, count), np.nan), np.zeros(count)
        outcomes = np.zeros(count, dtype=np.uint8)
        inputs = [np.ascontiguousarray(a, dtype=float) for a in (starts, parameters)]
        inputs += [
            np.ascontiguousarray(a, dtype=float)
            for a in (timeline.edges, timeline.shared, timeline.grid, timeline.centre)
        ]
        inputs.append(1.0 / np.asarray(timeline.unit, dtype=float))
        pointers = [array.ctypes.data for array in inputs]
        task = _Task(
            count,
            pitch,
            *pointers[:2],
            len(timeline.edges) - 1,
            *pointers[2:4],
            points,
            *pointers[4:],
            CAUTION * tolerance,
            limit,
            most,
            *(array.ctypes.data for array in (values, totals, ends, outcomes, steps)),
        )
        if self._library.integrate(ctypes.byref(task)):
            raise MemoryError
        return Passed(values, totals, ends, outcomes, int(steps[0]))

    def count(self, passed: Passed, part: slice, side: int, bits: int, counts: np.ndarray) -> None:
        """Count the reduced values of some members in the bins of each row."""
        values = passed.values
        first, last, _ = part.indices(len(passed.ends))
        self._library.count(
            ctypes.c_int64(values.shape[0] * values.shape[1]),
            ctypes.c_int64(last - first),
            ctypes.c_int64(values.shape[2]),
            ctypes.c_void_p(values.ctypes.data + first * values.itemsize),
            ctypes.c_int64(side),
            ctypes.c_int32(bits),
            ctypes.c_void_p(counts.ctypes.data),
        )


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
        scalar = all(self._names[name].startswith("s[") for name in expr.free_symbols)
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
            return f"choose({a} > {b}, {yes}, {no})"
        if expr.is_number:
            return self._print_number(expr)
        names = {sympy.Abs: "v_abs", sympy.sign: "v_sign", sympy.atan2: "v_atan2"}
        name = names.get(type(expr)) or f"v_{type(expr).__name__}"
        return f"{name}({', '.join(arguments)})"

    _print_Abs = _print_sign = _print_sin = _print_cos = _print_tan = _print_Function
    _print_asin = _print_acos = _print_atan = _print_atan2 = _print_Function
    _print_sinh = _print_cosh = _print_tanh = _print_exp = _print_log = _print_Function
    _print_Select = _print_Extremum = _print_Entry = _print_Function

    def _print_NumberSymbol(self, expr: sympy.Expr) -> str:
        return self._print_number(expr)


def _power(base: str, exponent: int) -> str:
    if exponent == 1:
        return base
    if exponent > 8:
        return f"v_pow({base}, SPLAT({float(exponent)!r}))"
    return "(" + "*".join([base] * exponent) + ")"


def system_header(flow: Flow, shown: Sequence[sympy.Expr]) -> str:
    """The generated part of lanes.c."""
    timeless, found = flow.without_time()
    names: dict[sympy.Symbol, str] = {TIME: "t", BEGIN: "t", STEP: "h"}
    for letter, symbols in (
        ("c", list(found.values())),
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
        "STATES": len(flow.states),
        "WATCHED": flow.watched,
        "PARAMETERS": len(flow.parameters),
        "SHARED": len(flow.shared),
        "COMMON": len(found),
        "INTEGRALS": len(flow.integrands),
        "SIGNALS": len(flow.signals),
        "MEMORIES": len(flow.memories),
        "SHOWN": len(shown),
        "STAGES": len(DOP853.B),
        "ALL_STAGES": len(DOP853.A_EXTRA[0]),
    }
    assert sizes["SHOWN"] and sizes["SIGNALS"] and sizes["MEMORIES"]

    def function(name: str, arguments: str, *results: tuple[str, Sequence[sympy.Expr]]) -> str:
        targets = [(f"{to}[{i}]", f) for to, formulas in results for i, f in enumerate(formulas)]
        return _function(name, arguments, targets, names)

    memories = [formula for _, formula in timeless.memories]
    parts = [
        "enum { " + ", ".join(f"{name} = {size}" for name, size in sizes.items()) + " };",
        *_tables(),
        function("common", "V t, const double *s, V *out", ("out", list(found))),
        function(
            "rates",
            "const V *c, const V *x, const V *p, V *k, V *q",
            ("k", timeless.rates),
            ("q", timeless.integrands),
        ),
        function(
            "signals",
            "const V *c, const V *x, const V *p, const V *k, V *out",
            ("out", timeless.signals),
        ),
        function(
            "memories",
            "V t, V h, const V *c, const V *p, const V *y, const V *y_end, V *m",
            ("m", memories),
        ),
        function("shown", "const V *x, const V *y_end, V *out", ("out", shown)),
    ]
    text = "\n".join(parts) + "\n"
    called = sorted(set(re.findall(r"\bv_(\w+)\(", text)) - OWN)
    macros = {name: "ELEMENTARY_OF_TWO" if name in OF_TWO else "ELEMENTARY" for name in called}
    return "".join(f"{macro}({name})\n" for name, macro in macros.items()) + text


def _tables() -> list[str]:
    """Coefficients of the method, as SciPy has them."""
    stages, every = len(DOP853.B), len(DOP853.A_EXTRA[0])
    A, C = np.zeros((every, every)), np.ones(every)
    A[:stages, :stages], A[stages + 1 :] = DOP853.A, DOP853.A_EXTRA
    C[:stages], C[stages + 1 :] = DOP853.C, DOP853.C_EXTRA
    assert DOP853.E3[-1] == DOP853.E5[-1] == 0
    found = {"A": A, "B": DOP853.B, "C": C, "E3": DOP853.E3, "E5": DOP853.E5, "D": DOP853.D}
    lines = []
    for name, table in found.items():
        shape = "".join(f"[{size}]" for size in table.shape)
        lines.append(f"static const double {name}{shape} = {_braces(table.tolist())};")
    return lines


def _braces(values: Any) -> str:
    if isinstance(values, list):
        return "{" + ", ".join(map(_braces, values)) + "}"
    return repr(values)


def _function(
    name: str,
    arguments: str,
    results: Sequence[tuple[str, sympy.Expr]],
    names: dict[sympy.Symbol, str],
) -> str:
    """A C function that assigns the results; common subexpressions are computed once."""
    temporaries = sympy.numbered_symbols("c", real=True)
    formulas = [without_minmax(formula) for _, formula in results]
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
    return f"static void {name}({arguments}) {{\n{unused}{body}\n}}\n"
