"""The largest |e_1| of many members, each with steps of its own, in compiled C (``peaks.c``)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import TIME
from certrack.core.memo import remembered
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.native import compiled_library
from certrack.integrators.many.native_source import (
    OUTCOME_NAMES,
    c_enum,
    c_function,
    c_table,
    with_elementary,
)
from certrack.integrators.pairs import DORMAND_PRINCE
from certrack.integrators.sampled import step_control


@dataclass(frozen=True)
class PeakFlow:
    """Rates of a system, and the signal whose largest magnitude is sought.

    Attributes
    ----------
    states : symbols
    rates : formulas of time, states and parameters
    parameters : symbols
    signal, slope : formulas
        The signal and its rate.
    watched : int
        The first states, which must stay within a limit.
    """

    states: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]
    parameters: tuple[sympy.Symbol, ...]
    signal: sympy.Expr
    slope: sympy.Expr
    watched: int


class _PeakTask(ctypes.Structure):
    """``Task`` of peaks.c."""

    _fields_ = [
        ("count", ctypes.c_int64),
        ("starts", ctypes.c_void_p),
        ("parameters", ctypes.c_void_p),
        *((name, ctypes.c_double) for name in ("begin", "end", "tolerance", "max_state")),
        ("max_steps", ctypes.c_int64),
        ("largest", ctypes.c_void_p),
        ("outcomes", ctypes.c_void_p),
        ("next", ctypes.c_int64),
    ]


class LargestErrors:
    """A compiled :class:`PeakFlow`.

    Parameters
    ----------
    flow : PeakFlow
    tolerance : float
        Of the states, in a step, relative and absolute.
    max_state : float
        A watched state beyond it has escaped.
    max_steps : int
        A member that needs more is given up.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it.
    """

    def __init__(self, flow: PeakFlow, tolerance: float, max_state: float, max_steps: int) -> None:
        self._library = compiled_library("peaks.c", _header(flow))
        self._tolerance, self._max_state, self._max_steps = tolerance, max_state, max_steps

    def largest(
        self, starts: Array, parameters: Array, begin: float, end: float
    ) -> tuple[Array, Array]:
        """Largest magnitude of the signal of every member from `begin` to `end`.

        Parameters
        ----------
        starts : (S, N) array
            At the time 0.
        parameters : (P, N) array
        begin, end : float, s

        Returns
        -------
        largest : (N,) array
            Of a member that ended early, until then.
        outcomes : (N,) array of MemberOutcome
        """
        count = starts.shape[1]
        largest, outcomes = np.zeros(count), np.zeros(count, dtype=np.uint8)
        inputs = [np.ascontiguousarray(a, dtype=float) for a in (starts, parameters)]
        task = _PeakTask(
            count,
            *(a.ctypes.data for a in inputs),
            *(begin, end, self._tolerance, self._max_state, self._max_steps),
            *(a.ctypes.data for a in (largest, outcomes)),
        )
        if self._library.integrate(ctypes.byref(task)):
            raise MemoryError
        return largest, outcomes


@remembered
def _header(flow: PeakFlow) -> str:
    """The generated part of peaks.c."""
    names: dict[sympy.Symbol, str] = {TIME: "t"}
    for letter, symbols in (("x", flow.states), ("p", flow.parameters)):
        names |= {symbol: f"{letter}[{i}]" for i, symbol in enumerate(symbols)}
    results: list[tuple[str, sympy.Expr]] = [
        *((f"k[{i}]", rate) for i, rate in enumerate(flow.rates)),
        ("e_out[0]", flow.signal),
        ("e_out[1]", flow.slope),
    ]
    pair = DORMAND_PRINCE
    constants: Sequence[tuple[str, float]] = (
        ("ESCAPING", ESCAPING),
        ("PER_ORDER", 1.0 / pair.order),
        *((name, getattr(step_control, name)) for name in ("SAFETY", "MIN_FACTOR", "MAX_FACTOR")),
    )
    sizes = {
        "STATES": len(flow.states),
        "WATCHED": flow.watched,
        "PARAMETERS": len(flow.parameters),
    }
    return with_elementary(
        [
            c_enum(sizes),
            c_enum(OUTCOME_NAMES),
            *(f"static const double {name} = {value!r};" for name, value in constants),
            c_table("A", np.vstack([pair.A, pair.B])),  # the end of the step as a last stage
            c_table("C", np.append(pair.C, 1.0)),
            c_table("E", pair.errors[0]),
            c_function("rates", "V t, const V *x, const V *p, V *k, V *e_out", results, names),
        ]
    )
