"""What a run of few steps is judged by, from its Taylor series, in compiled C (``extremes.c``).

The same searches as those of the metrics in NumPy, where such a run spends most of its time on
calls for short arrays. Nothing of the system is compiled: its error and input are handed over as a
list of operations, so a machine compiles one library, once, and keeps it on disk. Where it cannot
be kept, or there is no compiler, NumPy does it; both agree to rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import numpy as np
import sympy

from certrack.core import library_cache
from certrack.core.arrays import Array
from certrack.core.expressions import TIME
from certrack.core.select import Select
from certrack.integrators.base import PARTS, MethodUnavailable, fractions
from certrack.integrators.many.native import compiled_library
from certrack.integrators.single.taylor import TaylorSeries
from certrack.loops.continuous import INTEGRALS, ClosedLoop

#: Operations of extremes.c, in its order, and the functions that are one of them.
OPERATIONS = (
    *("add", "multiply", "divide", "larger", "smaller", "above", "choose", "pow", "atan2", "Abs"),
    *("sign", "sqrt", "sin", "cos", "exp", "log", "tan", "asin", "acos", "atan", "sinh", "cosh"),
    "tanh",
)
CODES = {name: code for code, name in enumerate(OPERATIONS)}
NAMED_OPERATIONS = frozenset(OPERATIONS[CODES["atan2"] :])

#: Numbers that extremes.c returns.
RESULT_COUNT = 7

#: Where on a step its samples lie.
STEP_SAMPLES = fractions(PARTS)

assert INTEGRALS == ("integral_u2", "integral_e2", "integral_e")  # as extremes.c takes them

#: A register before it has its place: what kind it is, and which of them.
_Register = tuple[str, int]


@dataclass(frozen=True, eq=False)
class SignalProgram:
    """The tracking error and the input of a loop as operations on registers.

    Attributes
    ----------
    which : (U,) array of int32
        States that these need, then that of the integral of e_1.
    places : (P,) array of int
        Which of the loop's parameters they need.
    constants : (C,) array
    pieces : int
        Parameters that change from step to step.
    code : (N, 4) array of int32
        Operation and registers: states, time, parameters, constants, pieces, earlier results.
    outputs : two int
        Registers of e_1 and u.
    """

    which: Array
    places: Array
    constants: Array
    pieces: int
    code: Array
    outputs: tuple[int, int]


def signal_program(loop: ClosedLoop) -> SignalProgram | None:
    """The program of a loop's signals; None where they hold a function that it does not know."""
    signals = (loop.e_1, loop.u)
    used = set().union(*(formula.free_symbols for formula in signals))
    count = len(loop.parameters) - loop.pieces
    states = [i for i, state in enumerate(loop.states) if state in used]
    places = [i for i, name in enumerate(loop.parameters[:count]) if name in used]
    known: dict[sympy.Basic, _Register] = {TIME: ("state", len(states))}
    known |= {loop.states[i]: ("state", k) for k, i in enumerate(states)}
    known |= {loop.parameters[i]: ("parameter", k) for k, i in enumerate(places)}
    known |= {name: ("piece", k) for k, name in enumerate(loop.parameters[count:])}
    writer = _Writer(known)
    try:
        results = [writer.place(formula) for formula in signals]
    except NotImplementedError:
        return None
    offsets, total = {}, 0
    for kind, size in (
        ("state", len(states) + 1),
        ("parameter", len(places)),
        ("constant", len(writer.constants)),
        ("piece", loop.pieces),
        ("result", 0),
    ):
        offsets[kind], total = total, total + size

    def register(where: _Register) -> int:
        return offsets[where[0]] + where[1]

    code = [[CODES[name], *map(register, arguments)] for name, arguments in writer.operations]
    return SignalProgram(
        np.array([*states, len(loop.states) - 1], dtype=np.int32),
        np.array(places, dtype=int),
        np.array(writer.constants, dtype=float),
        loop.pieces,
        np.array([(*row, 0, 0, 0)[:4] for row in code], dtype=np.int32).reshape(-1, 4),
        (register(results[0]), register(results[1])),
    )


class _Writer:
    """Writes formulas as operations; equal parts are computed once."""

    def __init__(self, known: dict[sympy.Basic, _Register]) -> None:
        self._known = known
        self.constants: list[float] = []
        self.operations: list[tuple[str, tuple[_Register, ...]]] = []

    def place(self, expr: sympy.Basic) -> _Register:
        if expr not in self._known:
            self._known[expr] = self._written(expr)
        return self._known[expr]

    def _written(self, expr: sympy.Basic) -> _Register:
        if not expr.free_symbols:
            self.constants.append(float(expr))
            return "constant", len(self.constants) - 1
        if isinstance(expr, sympy.Pow):
            return self._power(*expr.args)
        parts = [self.place(part) for part in expr.args]
        folded = {sympy.Add: "add", sympy.Mul: "multiply", sympy.Max: "larger"}
        name = (folded | {sympy.Min: "smaller"}).get(type(expr))
        if name:
            return reduce(lambda a, b: self._add(name, a, b), parts)
        if isinstance(expr, Select):
            return self._add("choose", self._add("above", *parts[:2]), *parts[2:])
        if type(expr).__name__ not in NAMED_OPERATIONS or not isinstance(expr, sympy.Function):
            raise NotImplementedError
        return self._add(type(expr).__name__, *parts)

    def _power(self, base: sympy.Basic, exponent: sympy.Basic) -> _Register:
        if not (exponent.is_Rational and exponent.q in (1, 2)):
            return self._add("pow", self.place(base), self.place(exponent))
        root = self.place(base)
        if exponent.q == 2:
            root = self._add("sqrt", root)
        power = self._product(root, abs(int(exponent.p)))
        return power if exponent > 0 else self._add("divide", self.place(sympy.S.One), power)

    def _product(self, factor: _Register, count: int) -> _Register:
        """The product of so many equal factors, by squares."""
        if count == 1:
            return factor
        half = self._product(factor, count // 2)
        square = self._add("multiply", half, half)
        return self._add("multiply", square, factor) if count % 2 else square

    def _add(self, name: str, *arguments: _Register) -> _Register:
        self.operations.append((name, arguments))
        return "result", len(self.operations) - 1


class _ExtremesTask(ctypes.Structure):
    """``Task`` of extremes.c."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("steps", "states", "orders")),
        *((name, ctypes.c_void_p) for name in ("starts", "table")),
        ("end", ctypes.c_double),
        ("fractions", ctypes.c_void_p),
        ("used", ctypes.c_int64),
        ("which", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("scalars", "pieces")),
        *((name, ctypes.c_void_p) for name in ("values", "held")),
        ("operations", ctypes.c_int64),
        ("code", ctypes.c_void_p),
        ("outputs", ctypes.c_int64 * 2),
        *((name, ctypes.c_double) for name in ("scale", "band", "tail_start")),
        *((name, ctypes.c_int64) for name in ("smooth", "most")),
        ("results", ctypes.c_void_p),
    ]


@lru_cache(maxsize=1)
def extremes_library() -> Callable[[Any], int] | None:
    """The compiled function; None without a compiler, or where nothing can be kept on disk."""
    if library_cache.state().trouble:
        return None  # every process would compile it, for longer than it saves
    try:
        function: Callable[[Any], int] = compiled_library("single/extremes.c", "").integrate
    except MethodUnavailable:
        return None
    return function


@dataclass(frozen=True)
class SeriesSignals:
    """Error and input of one run, for :meth:`measure`.

    Attributes
    ----------
    program : SignalProgram
    parameters : (P,) array
        Of the loop, without those of the piece.
    pieces_at : callable
        Values of the symbols of the piece at times, a row each.
    """

    program: SignalProgram
    parameters: Array
    pieces_at: Callable[[Array], Array]

    def measure(
        self,
        series: TaylorSeries,
        end: float,
        scale: float,
        band: float,
        tail_start: float,
        *,
        smooth: bool,
        most: int,
    ) -> list[float] | None:
        """Metrics of the run; None where the searches in NumPy have to find them.

        Parameters
        ----------
        series : TaylorSeries
        end : float, s
        scale : float
            Unit of the integrals among the states.
        band, tail_start : float
            Of |e_1|, and s.
        smooth : bool
            Whether no kink lies inside a step.
        most : int
            Intervals on which one signal may have an extreme; more of them are not searched here.

        Returns
        -------
        list of float
            Settling time, s; tail error; integral of abs(e_1); peak and variation of u; integrals
            of u^2 and e_1^2.
        """
        library, program = extremes_library(), self.program
        if library is None or not end > 0.0:
            return None
        starts, table = (np.ascontiguousarray(part) for part in (series.starts, series.table))
        steps, states, orders = table.shape
        values = np.concatenate([self.parameters[program.places], program.constants])
        held = None
        if program.pieces:
            middles = (starts + np.append(starts[1:], end)) / 2
            held = np.ascontiguousarray(self.pieces_at(middles).T)
        results = np.empty(RESULT_COUNT)
        task = _ExtremesTask(
            *(steps, states, orders, starts.ctypes.data, table.ctypes.data, end),
            *(STEP_SAMPLES.ctypes.data, len(program.which), program.which.ctypes.data),
            *(len(values), program.pieces, values.ctypes.data),
            *(held if held is None else held.ctypes.data, len(program.code)),
            *(program.code.ctypes.data, program.outputs),
            *(scale, band, tail_start, smooth, most, results.ctypes.data),
        )
        if library(ctypes.byref(task)):
            return None
        settling, tail, magnitude, peak, variation, u2, e2 = results.tolist()
        return [settling, tail, magnitude, peak, variation, u2 * scale, e2 * scale]
