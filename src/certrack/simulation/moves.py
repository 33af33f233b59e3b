"""What each move of a run is judged by: overshoot, settling, following error, error at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from certrack.references.rests import MoveTimes
from certrack.simulation.metrics import SETTLING_SHARE, last_outside, supremum

#: What tables show of a move, and what it is called there.
MOVE_LABELS = {
    "begin": "begins [s]",
    "arrival": "arrives [s]",
    "origin": "from",
    "target": "to",
    "following_error": "following error",
    "overshoot": "overshoot",
    "settling_time": "settled after [s]",
    "rest_error": "error at rest",
}


@dataclass(frozen=True)
class MoveMetrics:
    """Performance of one move from rest to rest.

    Attributes
    ----------
    begin, arrival, until : float, s
        When the reference begins to move, comes to rest, and begins to move again.
    origin, target : float
        Where it begins and ends, unit of the output.
    following_error : float
        Largest |e_1| while the reference moves.
    overshoot : float
        How far the output passes the target in the sense of the move, from its begin until the
        next; NaN where the move ends where it began.
    settling_time : float, s
        Time after the arrival at which |e_1| exceeds the band for the last time; NaN if it does
        when the rest ends.
    rest_error : float
        Largest |e_1| in the second half of the rest.
    band : float
        What settling refers to: that of the file, else 5 % of the move.
    """

    begin: float
    arrival: float
    until: float
    origin: float
    target: float
    following_error: float
    overshoot: float
    settling_time: float
    rest_error: float
    band: float

    def as_dict(self) -> dict[str, float | None]:
        """For JSON: a number that does not exist is None."""
        return {k: v if math.isfinite(v) else None for k, v in asdict(self).items()}


def measure_moves(
    moves: Sequence[MoveTimes],
    t: np.ndarray,
    y: np.ndarray,
    y_d: np.ndarray,
    band: float | None,
    per_step: int | None = None,
) -> tuple[MoveMetrics, ...]:
    """Metrics of every move from samples that resolve the solution, breaks among their times.

    Parameters
    ----------
    moves : sequence of MoveTimes
    t, y, y_d : (N,) arrays
        Times, output, reference.
    band : float, optional
        Of settling; 5 % of each move if left out.
    per_step : int, optional
        Samples per integration step; signals may jump between steps.
    """
    return tuple(_measure(move, t, y, y_d, band, per_step) for move in moves)


def _measure(
    move: MoveTimes,
    t: np.ndarray,
    y: np.ndarray,
    y_d: np.ndarray,
    band: float | None,
    per_step: int | None,
) -> MoveMetrics:
    size = move.target - move.origin
    width = band if band is not None else SETTLING_SHARE * abs(size) or SETTLING_SHARE
    blur = 1e-12 * max(1.0, move.until)

    def window(begin: float, end: float) -> slice:
        first, last = np.searchsorted(t, [begin - blur, end + blur])
        return slice(int(first), int(last))

    def largest(signal: np.ndarray, where: slice) -> float:
        offset = where.start % per_step if per_step else 0
        return supremum(t[where], signal[where], per_step, offset)

    e, dwell = y - y_d, window(move.arrival, move.until)
    beyond = np.maximum(0.0, math.copysign(1.0, size) * (y - move.target))
    settled = last_outside(t[dwell], np.abs(e[dwell]), width)
    return MoveMetrics(
        *move,
        following_error=largest(e, window(move.begin, move.arrival)),
        overshoot=largest(beyond, window(move.begin, move.until)) if size else math.nan,
        settling_time=settled - move.arrival if settled else 0.0,
        rest_error=largest(e, window((move.arrival + move.until) / 2, move.until)),
        band=width,
    )
