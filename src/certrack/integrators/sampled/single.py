"""One run of a sampled loop in compiled C (``single.c``), with a record of all its steps.

It is :class:`~certrack.integrators.sampled.run.SampledRun` of one member, at the cost of its
arithmetic: the same formulas, method, errors and noise, so that both agree to rounding. What it
does not do - a run that escapes or cannot go on, a plant that slides - is left to that one.
"""

from __future__ import annotations

import ctypes

import numpy as np

from certrack.core.arrays import Array
from certrack.core.compilers import CompilerError, function_of, load_library
from certrack.core.memo import remembered
from certrack.core.progress import Progress, silent
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.native import packaged
from certrack.integrators.sampled.native import sampled_header
from certrack.integrators.sampled.plans import LimitedPlans, PlanStruct
from certrack.integrators.sampled.run import SampledProblem, sensor_noise
from certrack.integrators.sampled.solution import StepTable
from certrack.integrators.sampled.step_control import MAX_INTERVAL_STEPS
from certrack.loops.controller import planning_base
from certrack.loops.sampled import SampledLoop
from certrack.model.noise import normal

#: No fast arithmetic and nothing of this processor: a run has the same bits wherever the C library
#: is the same. Most of the time goes into its elementary functions, so higher levels gain nothing.
SCALAR_FLAGS = "-std=gnu11 -O1 -ffp-contract=off -fno-math-errno -shared -fPIC".split()

#: Runs of fewer events are not worth a compilation: it takes as long as `run.py` for so many.
WORTH_COMPILING = 4_000

#: Events between two reports of the progress, and between two looks at the keyboard.
EVENTS_PER_CALL = 20_000

#: The rows of the record behind those of states and totals: the input, and the sides of e_1.
INPUT_AND_SIDES = 5


class _Run(ctypes.Structure):
    """``Run`` of single.c."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("x", "k", "y", "parameters")),
        ("events", ctypes.c_int64),
        *(
            (name, ctypes.c_void_p)
            for name in ("times", "clock", "kinds", "segments", "shared", "waiting")
        ),
        ("depth", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("errors", "quantum")),
        *(
            (name, ctypes.c_double)
            for name in ("input_quantum", "input_low", "input_high", "tolerance", "max_state")
        ),
        ("record", ctypes.c_void_p),
        ("room", ctypes.c_int64),
        ("estimates", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("estimated", "most_samples")),
        ("u", ctypes.c_double),
        *((name, ctypes.c_int64) for name in ("event", "samples", "commands", "steps")),
        ("plan", PlanStruct),
    ]


@remembered
def _source(loop: SampledLoop, plans: bool) -> str:
    """The whole program."""
    plan = planning_base(loop.controller) if plans else ()
    return packaged("sampled/single.c", sampled_header(loop, (), plan=plan))


class SampledSingle:
    """A compiled :class:`SampledLoop` for one member; may be used by several threads at once.

    Parameters
    ----------
    loop : SampledLoop
        Of a plant that does not switch.
    plans : bool
        Whether its law plans the input within limits.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it.
    """

    def __init__(self, loop: SampledLoop, plans: bool = False) -> None:
        self._sensors, self._estimates = len(loop.controller.measured), loop.controller.estimates
        try:
            library = load_library({"single.c": _source(loop, plans)}, SCALAR_FLAGS)
            self._integrate = function_of(library, "integrate")
        except CompilerError as problem:
            raise MethodUnavailable(str(problem)) from None

    def record(
        self,
        problem: SampledProblem,
        shared: Array,
        plans: LimitedPlans | None = None,
        progress: Progress = silent,
    ) -> StepTable | None:
        """All steps to the end of a problem of one member; None where `run.py` has to do it.

        Parameters
        ----------
        problem : SampledProblem
            Its outputs and pieces are not used.
        shared : (segments, H) array
            Values of the piece symbols from the begin of the run, and from every break on.
        plans : LimitedPlans, optional
            Of a law that plans, with contiguous arrays.
        progress : callable
            Gets the time reached, the duration and None.
        """
        implementation, line = problem.implementation, problem.timeline
        n, events, samples = len(problem.x), len(line.times), int(line.samples.sum())
        starts = (problem.x, problem.states, problem.totals)
        x, k, y = (np.array(start[:, 0], dtype=float) for start in starts)
        depth = int(implementation.run_delay + 2 * implementation.jitter) + 2
        errors = sensor_noise(
            implementation,
            lambda: normal(problem.keys, 0, samples * self._sensors).reshape(-1, self._sensors).T,
            implementation.sensor_errors(line.times[line.samples]),
        )
        estimates = np.empty((len(self._estimates), samples + 1))
        # a first column for the begin of the run
        table = np.empty((1 + n + len(y) + INPUT_AND_SIDES, 1 + events + MAX_INTERVAL_STEPS))
        table[: 1 + n + len(y), 0] = [0.0, *x, *y]
        arrays = [
            *(x, k, y, np.ascontiguousarray(problem.parameters[:, 0])),
            *(line.times, line.clock, (line.samples + 2 * line.acts).astype(np.uint8)),
            np.cumsum(line.breaks).astype(np.int32),
            np.ascontiguousarray(shared, dtype=float),
            np.empty(depth),
            None if errors is None else np.ascontiguousarray(errors.T),
            np.array(implementation.measurement_quantum or (0.0,) * self._sensors),
        ]
        pointers = [None if array is None else array.ctypes.data for array in arrays]
        run = _Run(
            *pointers[:4],
            events,
            *pointers[4:10],
            depth,
            *pointers[10:],
            *implementation.converter,
            problem.tolerance,
            problem.max_state,
            u=implementation.initial_input,
            estimates=estimates.ctypes.data,
            estimated=len(estimates),
            most_samples=samples + 1,
        )
        if plans is not None:
            run.plan = plans.struct()
        end = float(line.times[-1])
        while run.event < events:
            if table.shape[1] - 1 - run.steps <= MAX_INTERVAL_STEPS:
                table = np.pad(table, ((0, 0), (0, table.shape[1])))
            run.record, run.room = table.ctypes.data + table.itemsize, table.shape[1]
            if self._integrate(ctypes.byref(run), min(run.event + EVENTS_PER_CALL, events)):
                return None
            progress(float(line.times[min(run.event, events - 1)]), end, None)
        estimates[:, -1] = k[: len(estimates)]
        table = table[:, : run.steps + 1]
        return StepTable(
            ends=table[0],
            columns=table[1 : 1 + n + len(y)],
            inputs=table[-INPUT_AND_SIDES, 1:],
            sides=table[1 - INPUT_AND_SIDES :, 1:],
            samples=np.append(line.times[line.samples], end),
            estimates=estimates,
        )
