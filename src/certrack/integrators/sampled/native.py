"""Members under a sampled controller in the lanes of vector registers (``native.c``)."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import TIME
from certrack.core.hoisting import hoisted, hoisted_numbers
from certrack.core.lowering import NumpyFunction, numpy_callable
from certrack.core.memo import remembered
from certrack.core.select import STEP_BEGIN, STEP_LENGTH
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.native import compiled_library, numbers_of
from certrack.integrators.many.native_source import (
    OUTCOME_NAMES,
    c_enum,
    c_function,
    c_table,
    with_elementary,
)
from certrack.integrators.sampled import step_control
from certrack.integrators.sampled.maps import PAIR
from certrack.integrators.sampled.plans import LimitedPlans, PlanStruct
from certrack.integrators.sampled.run import SampledProblem
from certrack.laws.baselines.mpc import MOVES
from certrack.loops.controller import planning_base, resolved
from certrack.loops.plant import INPUT
from certrack.loops.sampled import AREA, SIDES, SQUARE, SampledLoop

#: Numbers that native.c shares with step_control.py; errors are squared there.
SHARED_CONSTANTS = {
    "ESCAPING": ESCAPING,
    "PER_ORDER": 1.0 / PAIR.order,
    "NOT_A_NUMBER": step_control.NOT_A_NUMBER**2,
} | {
    name: getattr(step_control, name)
    for name in (
        *("ERROR_SHARE", "SHORTEST_STEP", "END_ROUNDING"),
        *("SAFETY", "MIN_FACTOR", "MAX_FACTOR", "FIRST_MAX_FACTOR"),
    )
}


class _SampledTask(ctypes.Structure):
    """``Task`` of native.c."""

    _fields_ = [
        ("count", ctypes.c_int64),
        *(
            (name, ctypes.c_void_p)
            for name in ("starts", "controllers", "totals", "parameters", "keys")
        ),
        ("events", ctypes.c_int64),
        *(
            (name, ctypes.c_void_p)
            for name in ("times", "clock", "kinds", "marks", "segments", "shared")
        ),
        ("depth", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("noise", "noise_bound", "quantum", "errors")),
        *(
            (name, ctypes.c_double)
            for name in (
                *("input_quantum", "input_low", "input_high"),
                *("initial_input", "tolerance", "max_state"),
            )
        ),
        *((name, ctypes.c_void_p) for name in ("values", "end_totals", "ends", "outcomes")),
        ("plan", PlanStruct),
    ]


@dataclass(frozen=True)
class SampledResult:
    """Shown values and totals of members.

    Attributes
    ----------
    values : (marks, R, N) array
        Shown values; NaN after the end of a member.
    totals : (T + 1, N) array
        The last row is the variation of the input.
    ends : (N,) array, s
        Last event reached within the admitted states.
    outcomes : (N,) array of MemberOutcome
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
        Formulas of time, states, parameters and input; kept at the times of interest.
    numbers : mapping
        Values of further parameters, which all members share: other values compile nothing.
    plans : LimitedPlans, optional
        Of a law that plans: those of all members.

    Raises
    ------
    MethodUnavailable
        If there is no compiler that can do it.
    """

    def __init__(
        self,
        loop: SampledLoop,
        shown: Sequence[sympy.Expr],
        numbers: Mapping[sympy.Symbol, float] | None = None,
        plans: LimitedPlans | None = None,
    ) -> None:
        self._plans = plans
        self._shown, self._totals = len(shown), len(loop.totals)
        self._sensors = len(loop.controller.measured)
        names, values = tuple(numbers or ()), list((numbers or {}).values())
        header, evaluate = _loop_form(loop, tuple(shown), names, plans is not None)
        self._library = compiled_library("sampled/native.c", header)
        self._numbers = numbers_of(evaluate, values)

    def integrate(self, problem: SampledProblem, shared: Array) -> SampledResult:
        """Integrate to the end; releases the interpreter lock.

        Parameters
        ----------
        problem : SampledProblem
            Its outputs and pieces are not used.
        shared : (segments, H) array
            Values of the piece symbols from the begin of the run, and from every break on.
        """
        implementation, line, count = problem.implementation, problem.timeline, problem.x.shape[1]
        marks = int(line.marks.max()) + 1
        values = np.full((marks, self._shown, count), np.nan)
        totals, ends = np.full((self._totals + 1, count), np.nan), np.zeros(count)
        outcomes = np.zeros(count, dtype=np.uint8)
        sensors = [
            np.array(row or (default,) * self._sensors)
            for row, default in (
                (implementation.noise, 0.0),
                (implementation.noise_bound, math.inf),
                (implementation.measurement_quantum, 0.0),
            )
        ]
        errors = implementation.sensor_errors(line.times[line.samples])
        errors = None if errors is None else np.ascontiguousarray(errors.T)
        numbers = self._numbers
        of_members = np.repeat(numbers[:, None], count, axis=1)
        parameters = np.vstack([problem.parameters.reshape(-1, count), of_members])
        starts = (problem.x, problem.states, problem.totals, parameters)
        shared = np.hstack([shared, np.broadcast_to(numbers, (len(shared), len(numbers)))])
        arrays = [
            *(np.ascontiguousarray(a, dtype=float) for a in starts),
            np.ascontiguousarray(problem.keys),
            np.ascontiguousarray(line.times),
            np.ascontiguousarray(line.clock),
            (line.samples + 2 * line.acts).astype(np.uint8),
            line.marks.astype(np.int32),
            np.cumsum(line.breaks).astype(np.int32),
            np.ascontiguousarray(shared, dtype=float),
            *sensors,
        ]
        pointers = [array.ctypes.data for array in arrays]
        task = _SampledTask(
            count,
            *pointers[:5],
            len(line.times),
            *pointers[5:11],
            int(implementation.run_delay + 2 * implementation.jitter) + 2,
            *pointers[11:],
            None if errors is None else errors.ctypes.data,
            *implementation.converter,
            implementation.initial_input,
            problem.tolerance,
            problem.max_state,
            *(array.ctypes.data for array in (values, totals, ends, outcomes)),
        )
        if self._plans is not None:
            task.plan = self._plans.struct()
        if self._library.integrate(ctypes.byref(task)):
            raise MemoryError
        return SampledResult(values, totals, ends, outcomes)


@remembered
def _loop_form(
    loop: SampledLoop,
    shown: tuple[sympy.Expr, ...],
    names: tuple[sympy.Symbol, ...],
    plans: bool,
) -> tuple[str, NumpyFunction]:
    """The generated part of native.c, and the numbers that it wants, from those of the caller."""
    changed, numbers = hoisted_numbers([*loop.formulas, *shown], set(names))
    fewest = loop.with_formulas(changed[: len(loop.formulas)])
    plan = planning_base(fewest.controller) if plans else ()
    header = sampled_header(fewest, changed[len(loop.formulas) :], tuple(numbers.values()), plan)
    return header, numpy_callable([names], list(numbers))


def sampled_header(
    loop: SampledLoop,
    shown: Sequence[sympy.Expr],
    numbers: Sequence[sympy.Symbol] = (),
    plan: Sequence[sympy.Expr] = (),
) -> str:
    """The generated part of native.c, as :class:`SampledNative` has its parameters.

    Numbers come after the parameters of a member, and again after those of a segment: there they
    are scalars, for what depends on time alone. What a plan rests on comes from ``plan_base``.
    """
    plant, controller = loop.plant, loop.controller
    parameters, shared = loop.parameters, loop.pieces
    command, update = resolved(controller)
    common, known = {TIME, *shared}, set(numbers)
    n, law_rows = len(plant.rates), len(update)
    moving, moving_common = hoisted([*plant.rates, loop.e_1, loop.slope, *shown], common, known)
    law, law_common = hoisted([*update, command], common, known)
    names: dict[sympy.Symbol, str] = {TIME: "t", STEP_BEGIN: "t", STEP_LENGTH: "h", INPUT: "u"}
    names |= {SQUARE: "sums[0]", AREA: "sums[1]"}
    for letter, symbols in (
        ("c", [*moving_common.values()]),
        ("c", [*law_common.values()]),
        ("p", (*parameters, *numbers)),
        ("s", shared),
        ("x", plant.states),
        ("e", SIDES),
        ("y", [name for name, _ in loop.totals]),
    ):
        names |= {symbol: f"{letter}[{i}]" for i, symbol in enumerate(symbols)}
    in_time = names | {symbol: f"s[{len(shared) + i}]" for i, symbol in enumerate(numbers)}
    sensed = names | {symbol: f"m[{i}]" for i, symbol in enumerate(controller.measured)}
    sensed |= {symbol: f"k[{i}]" for i, symbol in enumerate(controller.states)}
    sizes = {
        "STATES": n,
        "CONTROLLER": len(controller.states),
        "MEASURED": len(controller.measured),
        "PARAMETERS": len(parameters) + len(numbers),
        "SHARED": len(shared) + len(numbers),
        "COMMON": len(moving_common),
        "LAW_COMMON": len(law_common),
        "TOTALS": len(loop.totals),
        "SHOWN": len(shown),
        "MAX_INTERVAL_STEPS": step_control.MAX_INTERVAL_STEPS,
    }

    def function(
        name: str,
        arguments: str,
        *results: tuple[str, Sequence[sympy.Expr]],
        known: dict[sympy.Symbol, str] = names,
    ) -> str:
        targets = [(f"{to}[{i}]", f) for to, formulas in results for i, f in enumerate(formulas)]
        return c_function(name, arguments, targets, known)

    of_time = "V t, const double *s, V *out"
    planned = []
    if plan:
        known_at = "V t, const double *s, const V *m, const V *p, const V *k, V *out"
        planned = [
            "#define PLANNED",
            c_enum({"PLAN_MOVES": MOVES}),
            function("plan_base", known_at, ("out", plan), known=sensed),
        ]
    return with_elementary(
        [
            c_enum(sizes),
            c_enum(OUTCOME_NAMES),
            *(
                f"static const double {name} = {value!r};"
                for name, value in SHARED_CONSTANTS.items()
            ),
            c_table("A", np.vstack([PAIR.A, PAIR.B])),  # the end of the step as a last stage
            c_table("B", PAIR.B),
            c_table("C", np.append(PAIR.C, 1.0)),
            c_table("E", PAIR.errors[0]),
            function("common", of_time, ("out", list(moving_common)), known=in_time),
            function("law_common", of_time, ("out", list(law_common)), known=in_time),
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
            *planned,
        ]
    )
