"""Members in the lanes of vector registers: C written for the system, compiled where it runs.

By far the fastest method, where there is a C compiler with GCC's vector extensions (gcc, clang);
``native.c`` beside this file holds the method, ``vector_math.h`` the arithmetic,
``native_source.py`` writes the system for them; this module compiles and calls them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
import sympy

from certrack.core.compilers import (
    CompilerError,
    c_compilers,
    find_c_compiler,
    function_of,
    load_library,
)
from certrack.core.lowering import NumpyFunction, numpy_callable
from certrack.core.memo import remembered
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.many.implicit_source import implicit_steps
from certrack.integrators.many.native_source import system_header

VECTOR_FLAGS = (
    "-std=gnu11 -O3 -march=native -fno-math-errno -fno-trapping-math -fno-signed-zeros "
    "-fschedule-insns -shared -fPIC"
).split()
WIDE = ["-mprefer-vector-width=512"]

#: The error estimate of DOP853 exceeds its error by far: this many times the tolerance is allowed.
#: At the end of a run the error of the states then stays below the tolerance (a test measures it);
#: on the way it may be twice as large, as that of any integrator whose tolerance is one of steps.
#: The estimate of implicit steps is taken as it is.
ESTIMATE_EXCESS = 10.0

#: Vector functions of the C library, from the most to none: older ones lack some or all.
VECTOR_MATH = (
    ["-DVECTOR_MATH", "-DMORE_VECTOR_MATH", "-lmvec", "-lm"],
    ["-DVECTOR_MATH", "-lmvec", "-lm"],
    ["-lm"],
)


#: What the C files include, by their paths below ``integrators``.
INCLUDED_FILES = (
    "vector_math.h",
    "scalar_math.h",
    "many/explicit_step.h",
    "many/implicit_step.h",
    "sampled/plan.h",
)


def vector_compiler() -> str | None:
    """Path of the first C compiler that knows the flags, or None."""
    return next(filter(_knows_flags, c_compilers()), None)


@lru_cache
def _knows_flags(path: str) -> bool:
    try:
        _compile(path, "int main(void) { return 0; }\n", [])
    except CompilerError:
        return False
    return True


def _compile(path: str, source: str, more: Sequence[str]) -> ctypes.CDLL:
    return load_library({"native.c": source}, VECTOR_FLAGS, libraries=more, compiler=path)


def packaged(name: str, system: str) -> str:
    """A C file of the integrators, whole, with the generated header of a system.

    Parameters
    ----------
    name : str
        Path below ``integrators``, such as ``many/native.c``.
    system : str
        What takes the place of ``system.h``.
    """

    def text(name: str) -> str:
        return files("certrack.integrators").joinpath(*name.split("/")).read_text("utf-8")

    source = text(name).replace('#include "system.h"\n', system)
    for header in INCLUDED_FILES:
        source = source.replace(f'#include "{header.rpartition("/")[2]}"\n', text(header))
    return source


def compiled_library(name: str, system: str) -> ctypes.CDLL:
    """A C file of the integrators, compiled with the generated header of a system.

    Parameters
    ----------
    name : str
        Path below ``integrators``, such as ``many/native.c``.
    system : str
        What takes the place of ``system.h``.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it.
    """
    text = packaged(name, system)
    reason: CompilerError | None = None
    try:
        path = vector_compiler() or find_c_compiler()
    except CompilerError as problem:
        raise MethodUnavailable(str(problem)) from None
    for more in ([*wide, *math] for wide in (WIDE, []) for math in VECTOR_MATH):
        try:
            library = _compile(path, text, more)
            function_of(library, "integrate")
            return library
        except CompilerError as problem:
            reason = problem  # of the fewest flags in the end
    raise MethodUnavailable(str(reason))


class _NativeTask(ctypes.Structure):
    """``Task`` of native.c."""

    _fields_ = [
        ("count", ctypes.c_int64),
        ("starts", ctypes.c_void_p),
        ("parameters", ctypes.c_void_p),
        ("segments", ctypes.c_int64),
        ("edges", ctypes.c_void_p),
        ("shared", ctypes.c_void_p),
        ("points", ctypes.c_int64),
        ("grid", ctypes.c_void_p),
        ("centre", ctypes.c_void_p),
        ("per_unit", ctypes.c_void_p),
        ("tolerance", ctypes.c_double),
        ("max_state", ctypes.c_double),
        ("max_steps", ctypes.c_int64),
        ("begin", ctypes.c_int64),
        ("end", ctypes.c_int64),
        ("bins_per_side", ctypes.c_int64),
        ("bits", ctypes.c_int64),
        ("counts", ctypes.c_void_p),
        ("own_counts", ctypes.c_void_p),
        ("totals", ctypes.c_void_p),
        ("finals", ctypes.c_void_p),
        ("ends", ctypes.c_void_p),
        ("outcomes", ctypes.c_void_p),
        ("next_member", ctypes.c_void_p),
        ("steps", ctypes.c_int64),
        ("node_spacing", ctypes.c_double),
        ("grid_common", ctypes.c_void_p),
        ("bins", ctypes.c_void_p),
        ("filled", ctypes.c_void_p),
        ("members_counted", ctypes.c_int64),
    ]


@dataclass(frozen=True)
class SharedGrid:
    """The times that all members share, and what depends on them alone.

    Attributes
    ----------
    edges : (K+1,) array, s
        Segments; between them rates and signals may jump.
    shared : (K, H) array
        Values of the shared symbols on every segment.
    times : (T,) array, s
        Where the shown values are counted; begins with the first edge.
    centre, unit : (R, T) and (R,) arrays
        The shown values are reduced by them: (value - centre)/unit.
    """

    edges: np.ndarray
    shared: np.ndarray
    times: np.ndarray
    centre: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True)
class StepControl:
    """When steps are accurate enough, and when a member has escaped or is given up.

    Attributes
    ----------
    tolerance : float
    max_state : float
        A watched state beyond it has escaped.
    max_steps : int
        A group that needs more is given up.
    """

    tolerance: float
    max_state: float
    max_steps: int


@dataclass(frozen=True)
class BinCounts:
    """Which members are counted in which bins.

    Attributes
    ----------
    part : slice
        The members.
    bins_per_side, bits : int
        Bins of one side of zero, leading bits of a bin (see ``statistics.py``).
    counts : (T, R, 2 bins_per_side + 1) array of int32
        They are added to it; several threads may count in one array.
    """

    part: slice
    bins_per_side: int
    bits: int
    counts: np.ndarray


@dataclass(frozen=True)
class NativeResult:
    """Integrals, memories and last states of members.

    Attributes
    ----------
    totals : (integrals + memories, N) array
    finals : (S, N) array
        States at the end of a member.
    ends : (N,) array, s
    outcomes : (N,) array of MemberOutcome
        Run alone are members whose group took too many steps, or none that moves the time.
    steps : int
        Steps of all groups together, those that failed among them.
    """

    totals: np.ndarray
    finals: np.ndarray
    ends: np.ndarray
    outcomes: np.ndarray
    steps: int


@remembered
def _flow_form(
    flow: AugmentedFlow, shown: tuple[sympy.Expr, ...], implicit: bool
) -> tuple[str, NumpyFunction]:
    """The generated part of native.c, and the numbers that it wants, from those of the flow."""
    fewest, numbers = flow.with_fewest_numbers()
    evaluate = numpy_callable([flow.numbers], list(numbers))
    if not implicit:
        return system_header(fewest, shown), evaluate
    return system_header(fewest.linearised(), shown, implicit_steps()), evaluate


def numbers_of(evaluate: NumpyFunction, values: Sequence[float]) -> np.ndarray:
    """The numbers that a compiled flow wants; one that overflows is infinite, as in the lanes."""
    with np.errstate(all="ignore"):
        return np.array(evaluate(np.array(values, dtype=float)), dtype=float)


class Native:
    """A compiled :class:`AugmentedFlow`; may be used by several threads at once.

    Parameters
    ----------
    flow : AugmentedFlow
    shown : formulas
        Formulas of the states and of the signals' symbols at the end of a step.
    numbers : (K,) array
        Values of the flow's numbers.
    implicit : bool
        Whether steps are linearly implicit, for a stiff system, and not explicit.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it.
    """

    def __init__(
        self,
        flow: AugmentedFlow,
        shown: Sequence[sympy.Expr],
        numbers: Sequence[float] = (),
        *,
        implicit: bool = False,
    ) -> None:
        self._totals = len(flow.integrands) + len(flow.memories)
        header, evaluate = _flow_form(flow, tuple(shown), implicit)
        self._excess = 1.0 if implicit else ESTIMATE_EXCESS
        self._library = compiled_library("many/native.c", header)
        self._numbers = numbers_of(evaluate, numbers)
        self._spare_counts: list[np.ndarray] = []

    def integrate(
        self,
        starts: np.ndarray,
        parameters: np.ndarray,
        grid: SharedGrid,
        control: StepControl,
        tally: BinCounts,
        threads: int = 1,
    ) -> NativeResult:
        """Integrate members; several threads take them in turns.

        Parameters
        ----------
        starts : (S, N) array
        parameters : (P, N) array
        grid : SharedGrid
        control : StepControl
        tally : BinCounts
            Its counts are added to.
        threads : int

        Raises
        ------
        MemoryError
        """
        size, count = starts.shape
        totals, ends = np.full((self._totals, count), np.nan), np.zeros(count)
        finals, outcomes = np.full((size, count), np.nan), np.zeros(count, dtype=np.uint8)
        inputs = [np.ascontiguousarray(a, dtype=float) for a in (starts, parameters)]
        numbers = np.broadcast_to(self._numbers, (len(grid.shared), len(self._numbers)))
        inputs += [
            np.ascontiguousarray(a, dtype=float)
            for a in (grid.edges, np.hstack([grid.shared, numbers]), grid.times, grid.centre)
        ]
        inputs.append(1.0 / np.asarray(grid.unit, dtype=float))
        pointers = [array.ctypes.data for array in inputs]
        next_member = np.zeros(1, dtype=np.int64)

        def integrate(own_counts: np.ndarray) -> int:
            """One thread; releases the interpreter lock."""
            task = _NativeTask(
                count,
                *pointers[:2],
                len(grid.edges) - 1,
                *pointers[2:4],
                len(grid.times),
                *pointers[4:],
                self._excess * control.tolerance,
                control.max_state,
                control.max_steps,
                tally.part.start,
                tally.part.stop,
                tally.bins_per_side,
                tally.bits,
                *(a.ctypes.data for a in (tally.counts, own_counts)),
                *(a.ctypes.data for a in (totals, finals, ends, outcomes)),
                next_member.ctypes.data,
            )
            if self._library.integrate(ctypes.byref(task)):
                raise MemoryError
            self._spare_counts.append(own_counts)
            return int(task.steps)

        tables = [self._zeros(tally.counts.shape) for _ in range(threads)]
        with ThreadPoolExecutor(threads) as pool:
            steps = sum(pool.map(integrate, tables))
        return NativeResult(totals, finals, ends, outcomes, steps)

    def reserve(self, threads: int, shape: tuple[int, ...]) -> None:
        """Tables that threads count in: new memory costs as much as counting."""
        self._spare_counts += [np.full(shape, 0, dtype=np.uint16) for _ in range(threads)]

    def _zeros(self, shape: tuple[int, ...]) -> np.ndarray:
        """A table of zeros, used before if possible."""
        while self._spare_counts:
            counts = self._spare_counts.pop()
            if counts.shape == shape:
                return counts
        return np.zeros(shape, dtype=np.uint16)
