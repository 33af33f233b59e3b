"""What every integrator takes and returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from certrack.references import Reference

#: A state larger than this where the solution ceases to exist is escaping, not leaving a domain.
ESCAPING = 1e3


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
        "The step limit was reached: the loop is too stiff for this method, or sign() makes it "
        "slide. Try the implicit integrator, lower c, or replace sign(x) by tanh(x/0.01)."
    )
    kink_missed = (
        "The switching of abs, sign, min or max could not be followed: the loop slides along a "
        "kink. Replace sign(x) by tanh(x/0.01)."
    )


@dataclass(frozen=True)
class Problem:
    """Initial value problem of a compiled closed loop.

    Attributes
    ----------
    start : (S,) array
        Initial plant and controller states and integrals.
    parameters : (P,) array
        Without those of the reference's piece.
    reference : Reference
        Gives break points and pieces.
    duration : float, s
    tolerance : float
    plant_order : int
        The first `plant_order` states are those of the plant.
    fastest_pole : float, 1/s
        Of the designed error system.
    max_state : float
    """

    start: np.ndarray
    parameters: np.ndarray
    reference: Reference
    duration: float
    tolerance: float
    plant_order: int
    fastest_pole: float
    max_state: float

    @property
    def max_steps(self) -> int:
        """As many steps as half a gigabyte of Taylor coefficients allows."""
        return int(5e8 / (8 * 15 * len(self.start)))

    @property
    def segments(self) -> list[tuple[float, float]]:
        """Intervals between break points of the reference."""
        inner = self.reference.breaks(0.0, self.duration)
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
    """

    times: np.ndarray
    interpolate: Callable[[np.ndarray], np.ndarray]
    outcome: Outcome
    method: str
    parts: int = 8

    @property
    def end(self) -> float:
        """Last time reached, s."""
        return float(self.times[-1])


#: Samples at the ends of a step lie this fraction of it inside: u may jump where a step ends.
INSIDE = 1e-9


def fractions(parts: int) -> np.ndarray:
    """Where on a step the samples lie: `parts` equal parts, so parts + 1 samples."""
    return np.clip(np.arange(parts + 1) / parts, INSIDE, 1 - INSIDE)


def subdivide(times: np.ndarray, parts: int) -> np.ndarray:
    """Every step sampled at its :func:`fractions`; begin and end of the run are hit exactly."""
    if len(times) < 2:
        return times.copy()
    found = times[:-1, None] + np.diff(times)[:, None] * fractions(parts)
    found[0, 0], found[-1, -1] = times[0], times[-1]
    return found.ravel()
