"""What an integrator of one run is: its duties, what it takes, what it returns.

:class:`Integrator` is the extension point: a class with its one method can be used wherever
:class:`~certrack.simulation.simulator.Simulator` uses the Taylor method or SciPy's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from itertools import pairwise
from typing import Protocol

import numpy as np

from certrack.core.errors import CertrackError
from certrack.core.progress import Progress, silent
from certrack.integrators.switching import ModeRecord
from certrack.loops.schedule import Pieces

#: A state larger than this where the solution ceases to exist is escaping, not leaving a domain.
ESCAPING = 1e3

#: Memory for the steps of a run and what is made of them: with the compiled code, which takes
#: 0.1 GB, it is half a gigabyte. The order of the Taylor method at usual tolerances.
MAX_RECORD_BYTES, USUAL_ORDER = 4e8, 15

#: Into so many parts a step is cut where extremes are looked for. A run of more steps than
#: MAX_FINE_STEPS is cut into COARSE_PARTS each, so that it fits into memory.
PARTS, MAX_FINE_STEPS, COARSE_PARTS = 8, 20_000, 4

#: Numbers that metrics keep of every sample, besides the states.
NUMBERS_PER_SAMPLE = 25


class MethodUnavailable(CertrackError):
    """This machine lacks what a method needs: a C compiler that can do it, or heyoka."""


class Outcome(Enum):
    """How a run ended; the value is what to tell the user, remedy included."""

    finished = "The run reached its end."
    escaped = (
        "A plant state passed simulation.max_state: finite escape or divergence. Raise c or the "
        "adaptation gain, start closer to the reference, or check the sign of the input gain."
    )
    undefined = (
        "The right-hand side is not finite here: a formula leaves its domain (log, sqrt, a "
        "division). Check the formulas near this state."
    )
    step_limit = (
        "The step limit was reached: the loop is too stiff for this method. Try the implicit "
        "integrator, lower c, or replace a steep tanh() by sign()."
    )
    kink_missed = (
        "The switching of abs, sign, min or max could not be followed: the loop slides along a "
        "kink. Replace sign(x) by tanh(x/0.01)."
    )
    chattering = (
        "Switches by sign() follow one another without end here, at more than two surfaces that "
        "interact or by contact of higher order: this sliding is not simulated. Replace sign(x) by "
        "tanh(x/0.01)."
    )
    controller_diverged = (
        "The controller diverges, not the plant: the command or an estimate outgrows every "
        "useful number. Lower Gamma, gain_rate or the leakage, start the estimates closer "
        "(simulation.estimates), check h and phi at the measured states; if sampled, shorten "
        "implementation.period or bound the estimates by implementation.projection."
    )


class MemberOutcome(IntEnum):
    """How one of many members ended, as compiled C says it (there in capitals)."""

    finished = 0
    escaped = 1
    #: The method cannot finish it; :class:`Outcome` of its own run says why.
    run_alone = 2


@dataclass(frozen=True)
class Problem:
    """Initial value problem of a compiled closed loop.

    Attributes
    ----------
    start : (S,) array
        Initial plant and controller states and integrals.
    parameters : (P,) array
        Without those of the reference's piece.
    schedule : Pieces
        Break points, and the values of the piece's symbols from each on.
    duration : float, s
    tolerance : float
    plant_order : int
        The first `plant_order` states are those of the plant.
    fastest_pole : float, 1/s
        The fastest pole of the designed error system.
    max_state : float
    progress : callable
        Gets the time reached, the duration and None, from time to time.
    """

    start: np.ndarray
    parameters: np.ndarray
    schedule: Pieces
    duration: float
    tolerance: float
    plant_order: int
    fastest_pole: float
    max_state: float
    progress: Progress = silent

    @property
    def max_steps(self) -> int:
        """As many steps as the memory for coefficients, samples and metrics allows."""
        samples = COARSE_PARTS + 1
        numbers = (USUAL_ORDER + samples) * len(self.start) + samples * NUMBERS_PER_SAMPLE
        return int(MAX_RECORD_BYTES / (8 * numbers))

    @property
    def segments(self) -> list[tuple[float, float]]:
        """Intervals between break points."""
        inner = self.schedule.breaks(0.0, self.duration)
        times = [0.0, *map(float, inner), self.duration]
        return list(pairwise(times))


@dataclass(frozen=True)
class Trajectory:
    """A solution with dense output.

    Attributes
    ----------
    times : (K+1,) array, s
        Ends of the steps that the integrator took.
    interpolate : callable
        States (S, N) at N times.
    outcome : Outcome
    method : str
    parts : int
        Into so many parts a step is cut where extremes are looked for.
    modes : ModeRecord, optional
        On which sides of its switching surfaces the run was, and where it slid along them.
    """

    times: np.ndarray
    interpolate: Callable[[np.ndarray], np.ndarray]
    outcome: Outcome
    method: str
    parts: int = PARTS
    modes: ModeRecord | None = None

    @property
    def end(self) -> float:
        """Last time reached, s."""
        return float(self.times[-1])


def parts_of(steps: int) -> int:
    """Into how many parts each of so many steps is cut."""
    return PARTS if steps <= MAX_FINE_STEPS else COARSE_PARTS


class Integrator(Protocol):
    """An integrator of one run, compiled for a closed loop.

    The constructor takes a :class:`~certrack.loops.continuous.ClosedLoop` (its states, rates and
    parameters as SymPy formulas; the last `pieces` parameters change at breaks) and whatever
    options the method has, and does all that does not depend on numbers. The author's duties:

    1. :meth:`integrate` solves x' = rates(t, x, parameters) from ``problem.start`` at t = 0 to
       ``problem.duration``, for any numbers, without compiling again.
    2. No step crosses an end of ``problem.segments``: there the reference's pieces and the switches
       of time change. On each segment the parameters are those of the problem, followed by
       ``problem.schedule.piece_values(begin)``.
    3. The local error is about ``problem.tolerance``, relative and absolute; the last
       ``len(INTEGRALS)`` states are integrals, scaled by ``INTEGRAL_SCALE``.
    4. Where the rates have kinks of the state (abs, sign, min, max), the accuracy holds or the
       outcome says that it does not: ``kink_missed`` or ``step_limit``. It is never lost silently.
    5. It stops at the first of these, and says which in ``Trajectory.outcome``: the end of the run
       (``finished``); one of the first ``problem.plant_order`` states beyond ``problem.max_state``,
       or beyond :data:`ESCAPING` where the solution ceases to exist (``escaped``); rates that are
       not finite (``undefined``); too many steps (``step_limit``). It neither raises nor prints.
    6. ``Trajectory.times`` are the begin and the end of every step up to the last accepted one;
       ``Trajectory.interpolate`` is as accurate as the steps are, at any of its times in any order,
       and stays so when :meth:`integrate` is called again: it refers to no state of the integrator.
    7. The same problem gives the same bits, whatever was integrated before.

    ``tests/test_integrators.py`` holds the Taylor method and SciPy's to them.
    """

    def integrate(self, problem: Problem) -> Trajectory:
        """Solve a problem."""


#: Samples at the ends of a step lie this fraction of it inside: u may jump where a step ends.
INSIDE = 1e-9


def fractions(parts: int) -> np.ndarray:
    """Where on a step the samples lie: `parts` equal parts, so parts + 1 samples."""
    return np.clip(np.arange(parts + 1) / parts, INSIDE, 1 - INSIDE)


def subdivide(times: np.ndarray, parts: int) -> np.ndarray:
    """Every step sampled at its :func:`fractions`; begin and end of the run are hit exactly."""
    if len(times) < 2:
        return times.copy()
    samples = times[:-1, None] + np.diff(times)[:, None] * fractions(parts)
    samples[0, 0], samples[-1, -1] = times[0], times[-1]
    return samples.ravel()
