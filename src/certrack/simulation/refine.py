"""Extremes and crossings of a run's signals, refined on its dense output.

Samples say where an extreme or a crossing lies, to a part of an integration step. There the dense
output is looked at on finer and finer grids, for all of them at once; the last step of an extreme
is Newton's on the slopes of the last grid. So metrics are as accurate as the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

#: Grids, one inside the other, and their points.
ROUNDS = 3
POINTS = np.linspace(0.0, 1.0, 9)

#: Larger samples are of a run that escapes: their squares overflow, and no peak is refined there.
MAX_REFINED = 1e100

#: Signals of a run at times: an array with a row per signal.
Dense = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Candidates:
    """Intervals on which a signal may have an extreme above its samples.

    Attributes
    ----------
    begins, ends : (C,) arrays, s
    signs : (C,) array
        1 for a maximum, -1 for a minimum.
    sampled : (C,) array
        Largest sample of sign * signal there.
    estimates : (C,) array
        The extreme of sign * signal by a parabola.
    """

    begins: np.ndarray
    ends: np.ndarray
    signs: np.ndarray
    sampled: np.ndarray
    estimates: np.ndarray

    def only(self, which: np.ndarray) -> Candidates:
        """Some of them."""
        return Candidates(
            self.begins[which],
            self.ends[which],
            self.signs[which],
            self.sampled[which],
            self.estimates[which],
        )


def candidates(t: np.ndarray, f: np.ndarray, per_step: int) -> Candidates:
    """Where samples of a signal, `per_step` on every integration step, suggest an extreme.

    Inside of a step: at a sample that exceeds its neighbours; before the second and after the last
    but one also where the parabola through three samples has its vertex.
    """
    if per_step < 3 or len(t) % per_step:
        nothing = np.empty(0)
        return Candidates(nothing, nothing, nothing, nothing, nothing)
    ts, fs = t.reshape(-1, per_step), f.reshape(-1, per_step)
    with np.errstate(all="ignore"):
        rises = fs[:, 1:] - fs[:, :-1]  # samples of a step are equidistant
        turns = rises[:, :-1] * rises[:, 1:] <= 0
        for edge, inner in ((0, 1), (-1, -2)):  # the vertex lies between the last two samples
            sums = rises[:, edge] + rises[:, inner]
            bends = 2 * (rises[:, inner] - rises[:, edge])
            turns[:, edge] |= (sums * bends > 0) & (np.abs(sums) <= np.abs(bends))
        step, k = np.nonzero(turns)
        f0, f1, f2 = (fs[step, k + j] for j in range(3))
        bend = f0 - 2 * f1 + f2
        sharp = (bend != 0) & (np.abs(f1) < MAX_REFINED)
        step, k, f0, f1, f2, bend = (part[sharp] for part in (step, k, f0, f1, f2, bend))
        signs = np.where(bend < 0, 1.0, -1.0)
        top = signs * (f1 - (f2 - f0) ** 2 / (8 * bend))
    sampled = np.maximum(np.maximum(signs * f0, signs * f1), signs * f2)
    return Candidates(ts[step, k], ts[step, k + 2], signs, sampled, top)


@dataclass(frozen=True)
class Crossings:
    """Intervals on which sign * signal falls from above a level to it.

    Attributes
    ----------
    begins, ends : (C,) arrays, s
    signs : (C,) array
    level : float
    """

    begins: np.ndarray
    ends: np.ndarray
    signs: np.ndarray
    level: float = 0.0


def refine(
    dense: Dense,
    extremes: Sequence[tuple[int, Candidates]],
    crossings: Sequence[tuple[int, Crossings]],
    *,
    smooth: bool,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Refine all searches together, so that the dense output is asked only a few times.

    Parameters
    ----------
    dense : callable
    extremes : pairs of the number of a signal and where it may have extremes
    crossings : pairs of the number of a signal and where it crosses
    smooth : bool
        Whether no kink lies inside a step, so that Newton's step may be taken.

    Returns
    -------
    extremes : list of (C,) arrays
        Largest sign * signal on each interval.
    crossings : list of (C,) arrays, s
        The last times at which it is above the level.
    """
    searches: list[tuple[int, Candidates | Crossings]] = [*extremes, *crossings]
    sizes = [len(where.begins) for _, where in searches]
    peaks, total = sum(sizes[: len(extremes)]), sum(sizes)
    if not total:
        nothing = [np.empty(0) for _ in searches]
        return nothing[: len(extremes)], nothing[len(extremes) :]
    rows = np.repeat([row for row, _ in searches], sizes)
    begins = np.concatenate([where.begins for _, where in searches])
    ends = np.concatenate([where.ends for _, where in searches])
    signs = np.concatenate([where.signs for _, where in searches])
    levels = np.repeat([0.0] * len(extremes) + [where.level for _, where in crossings], sizes)
    every, best = np.arange(total), np.full(total, -np.inf)
    grid = values = np.empty((total, len(POINTS)))
    for _ in range(ROUNDS):
        grid = begins[:, None] + (ends - begins)[:, None] * POINTS
        table = dense(grid.ravel()).reshape(-1, *grid.shape)
        values = signs[:, None] * table[rows, every] - levels[:, None]
        best = np.maximum(best, values.max(axis=1))
        top = _inner(values.argmax(axis=1))
        last = len(POINTS) - 2 - (values > 0)[:, -2::-1].argmax(axis=1)
        is_peak = every < peaks
        begins = grid[every, np.where(is_peak, top - 1, last)]
        ends = grid[every, np.where(is_peak, top + 1, last + 1)]
    if smooth:
        best = np.maximum(best, _vertices(values))
    above, below = values[every, last], values[every, last + 1]
    with np.errstate(all="ignore"):
        share = np.where((above > 0) & (below <= 0), above / (above - below), 1.0)
    results = np.where(is_peak, best, begins + (ends - begins) * share)
    parts = np.split(results, np.cumsum(sizes)[:-1])
    return parts[: len(extremes)], parts[len(extremes) :]


def _inner(k: np.ndarray) -> np.ndarray:
    """The nearest points of a grid that have neighbours on both sides (np.clip is slower)."""
    return np.minimum(np.maximum(k, 1), len(POINTS) - 2)


def _vertices(values: np.ndarray) -> np.ndarray:
    """Newton's step from the largest of equidistant values, by their slopes; else -inf."""
    inner = _inner(values.argmax(axis=1))
    f0, f1, f2 = (values[np.arange(len(values)), inner + k] for k in (-1, 0, 1))
    with np.errstate(all="ignore"):
        bend = f0 - 2 * f1 + f2
        shift = (f0 - f2) / (2 * bend)
        valid = (bend < 0) & (np.abs(shift) <= 1)
        return np.where(valid, f1 + (f2 - f0) * shift / 4, -np.inf)
