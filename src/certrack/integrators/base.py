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
    max_steps : int
    """

    start: np.ndarray
    parameters: np.ndarray
    reference: Reference
    duration: float
    tolerance: float
    plant_order: int
    fastest_pole: float
    max_state: float
    max_steps: int = 100_000

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
    """

    times: np.ndarray
    interpolate: Callable[[np.ndarray], np.ndarray]
    outcome: Outcome
    method: str

    @property
    def end(self) -> float:
        """Last time reached, s."""
        return float(self.times[-1])


def subdivide(times: np.ndarray, parts: int) -> np.ndarray:
    """Every step cut into equal parts; the ends of the steps are hit exactly."""
    found = np.empty(parts * (len(times) - 1) + 1)
    found[-1] = times[-1]
    steps = found[:-1].reshape(-1, parts)
    np.multiply(np.diff(times)[:, None], np.arange(parts) / parts, out=steps)
    steps += times[:-1, None]
    return found
