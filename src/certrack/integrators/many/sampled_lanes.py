"""Members under a sampled controller in the lanes of vector registers (``sampled.c``)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy
from scipy.integrate import RK45

from certrack.core.expressions import TIME
from certrack.core.lowering import BEGIN, STEP, hoisted
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.lanes import braces, c_function, with_elementary
from certrack.integrators.many.native import compiled_library
from certrack.integrators.many.sampled import MOST_STEPS, SHARE, SHORTEST, Course
from certrack.loops.plant import INPUT
from certrack.loops.sampled import AREA, SIDES, SQUARE, SampledLoop, resolved

Array = np.ndarray


class _Task(ctypes.Structure):
    """As in sampled.c."""

    _fields_ = [
        ("count", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("starts", "kept", "totals", "parameters", "keys")),
        ("events", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("times", "kinds", "marks", "segments", "shared")),
        ("depth", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("noise", "quantum")),
        *(
            (name, ctypes.c_double)
            for name in (
                *("input_quantum", "input_low", "input_high"),
                *("initial_input", "tolerance", "limit"),
            )
        ),
        *((name, ctypes.c_void_p) for name in ("values", "found", "ends", "outcomes")),
    ]


@dataclass(frozen=True)
class Passed:
    """What came of some members.

    Attributes
    ----------
    values : (marks, R, N) array
        Shown values; NaN after the end of a member.
    totals : (T + 1, N) array
        The last row is the variation of the input.
    ends : (N,) array, s
        Last event reached within the admitted states.
    outcomes : (N,) array
        0 finished, 1 escaped, 2 stuck.
    """

    values: Array
    totals: Array
    ends: Array
    outcomes: Array


class SampledNative:
    """A compiled :class:`SampledLoop`; may be used by several threads at once.

    Parameters
    ----------
    loop : SampledLoop
        With numbers for what does not vary.
    shown : formulas
        Of time, states, parameters and input; kept at the times of interest.

    Raises
    ------
    Unavailable
        If there is no compiler that can do it.
    """

    def __init__(self, loop: SampledLoop, shown: Sequence[sympy.Expr]) -> None:
        self._shown, self._totals = len(shown), len(loop.totals)
        self._sensors = len(loop.controller.measured)
        self._library = compiled_library("sampled.c", _header(loop, shown))

    def integrate(self, course: Course, shared: Array) -> Passed:
        """Carry out a course; releases the interpreter lock.

        Parameters
        ----------
        course : Course
            Its outputs and pieces are not asked.
        shared : (segments, H) array
            Values of the piece symbols from the begin of the run, and from every break on.
        """
        implementation, line, count = course.implementation, course.timeline, course.x.shape[1]
        marks = int(line.marks.max()) + 1
        values = np.full((marks, self._shown, count), np.nan)
        found, ends = np.full((self._totals + 1, count), np.nan), np.zeros(count)
        outcomes = np.zeros(count, dtype=np.uint8)
        none = (0.0,) * self._sensors
        sensors = [
            np.array(row or none)
            for row in (implementation.noise, implementation.measurement_quantum)
        ]
        starts = (course.x, course.states, course.totals, course.parameters)
        arrays = [
            *(np.ascontiguousarray(a, dtype=float) for a in starts),
            np.ascontiguousarray(course.keys),
            np.ascontiguousarray(line.times),
            (line.samples + 2 * line.acts).astype(np.uint8),
            line.marks.astype(np.int32),
            np.cumsum(line.breaks).astype(np.int32),
            np.ascontiguousarray(shared, dtype=float),
            *sensors,
        ]
        pointers = [array.ctypes.data for array in arrays]
        task = _Task(
            count,
            *pointers[:5],
            len(line.times),
            *pointers[5:10],
            int(implementation.delay) + 2,
            *pointers[10:],
            *implementation.converter,
            implementation.initial_input,
            course.tolerance,
            course.max_state,
            *(array.ctypes.data for array in (values, found, ends, outcomes)),
        )
        if self._library.integrate(ctypes.byref(task)):
            raise MemoryError
        return Passed(values, found, ends, outcomes)


def _header(loop: SampledLoop, shown: Sequence[sympy.Expr]) -> str:
    """The generated part of sampled.c."""
    plant, controller = loop.plant, loop.controller
    parameters, shared = loop.parameters, loop.pieces
    command, update = resolved(controller)
    common = {TIME, *shared}
    n, law_rows = len(plant.rates), len(update)
    moving, found = hoisted([*plant.rates, loop.e_1, loop.slope, *shown], common)
    law, law_found = hoisted([*update, command], common)
    names: dict[sympy.Symbol, str] = {TIME: "t", BEGIN: "t", STEP: "h", INPUT: "u"}
    names |= {SQUARE: "sums[0]", AREA: "sums[1]"}
    for letter, symbols in (
        ("c", [*found.values()]),
        ("c", [*law_found.values()]),
        ("p", parameters),
        ("s", shared),
        ("x", plant.states),
        ("e", SIDES),
        ("y", [name for name, _ in loop.totals]),
    ):
        names |= {symbol: f"{letter}[{i}]" for i, symbol in enumerate(symbols)}
    sensed = names | {symbol: f"m[{i}]" for i, symbol in enumerate(controller.measured)}
    sensed |= {symbol: f"k[{i}]" for i, symbol in enumerate(controller.states)}
    sizes = {
        "STATES": n,
        "KEPT": len(controller.states),
        "MEASURED": len(controller.measured),
        "PARAMETERS": len(parameters),
        "SHARED": len(shared),
        "COMMON": len(found),
        "LAW_COMMON": len(law_found),
        "TOTALS": len(loop.totals),
        "SHOWN": len(shown),
        "MOST_STEPS": MOST_STEPS,
    }

    def function(
        name: str,
        arguments: str,
        *results: tuple[str, Sequence[sympy.Expr]],
        known: dict[sympy.Symbol, str] = names,
    ) -> str:
        targets = [(f"{to}[{i}]", f) for to, formulas in results for i, f in enumerate(formulas)]
        return c_function(name, arguments, targets, known)

    tables = {
        "A": np.vstack([np.pad(RK45.A, ((0, 0), (0, 1))), RK45.B]),
        "B": RK45.B,
        "C": np.append(RK45.C, 1.0),
        "E": RK45.E,
    }
    plain = "V t, const double *s, V *out"
    return with_elementary(
        [
            "enum { " + ", ".join(f"{name} = {size}" for name, size in sizes.items()) + " };",
            f"static const double ESCAPING = {ESCAPING!r}, SHARE = {SHARE!r}, "
            f"SHORTEST = {SHORTEST!r};",
            *(
                f"static const double {name}{''.join(f'[{k}]' for k in table.shape)} = "
                f"{braces(table.tolist())};"
                for name, table in tables.items()
            ),
            function("common", plain, ("out", list(found))),
            function("law_common", plain, ("out", list(law_found))),
            function(
                "rates",
                "const V *c, const V *x, V u, const V *p, V *k, V *e_out",
                ("k", moving[:n]),
                ("e_out", moving[n : n + 2]),
            ),
            function("measure", "const V *x, const V *p, V *out", ("out", plant.outputs)),
            function(
                "law",
                "const V *c, const V *m, const V *p, V *k, V *out",
                ("k", law[:law_rows]),
                ("out", law[law_rows:]),
                known=sensed,
            ),
            function(
                "total",
                "V t, V h, const double *s, const V *e, const V *sums, V u, const V *p, V *y",
                ("y", [formula for _, formula in loop.totals]),
            ),
            function(
                "shown",
                "const V *c, const V *x, const V *p, V u, V *out",
                ("out", moving[n + 2 :]),
            ),
        ]
    )
