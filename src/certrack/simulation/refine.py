"""Extremes and crossings of a run's signals, refined on its dense output.

Samples say where an extreme or a crossing lies, to a part of an integration step. There the dense
output is looked at on finer and finer grids, for all of them at once; the last step of an extreme
is Newton's on the slopes of the last grid. So metrics are as accurate as the run.
"""

from __future__ import annotations

from collections.abc import Callable
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
    h = np.diff(ts, axis=1)
    with np.errstate(all="ignore"):
        slopes = np.diff(fs, axis=1) / h
        left, right, h0, h1 = slopes[:, :-1], slopes[:, 1:], h[:, :-1], h[:, 1:]
        bend = (right - left) / (h0 + h1)
        slope = (left * h1 + right * h0) / (h0 + h1)
        shift = -slope / (2 * bend)
        sharp = (np.abs(bend) > 0) & (np.abs(fs[:, 1:-1]) < MAX_REFINED)
        top = fs[:, 1:-1] + slope * shift / 2
        turns = (left * right <= 0) & (left != right)
        turns[:, 0] |= ((shift < 0) & (shift >= -h0))[:, 0]
        turns[:, -1] |= ((shift > 0) & (shift <= h1))[:, -1]
    step, k = np.nonzero(turns & sharp)
    signs = np.where(bend[step, k] < 0, 1.0, -1.0)
    sampled = np.max(signs * np.array([fs[step, k + j] for j in range(3)]), axis=0, initial=-np.inf)
    return Candidates(ts[step, k], ts[step, k + 2], signs, sampled, signs * top[step, k])


@dataclass(frozen=True)
class Found:
    """Where and how large, for each search.

    Attributes
    ----------
    times, values : (C,) arrays
        Values of the signal at extremes; of no meaning at crossings.
    """

    times: np.ndarray
    values: np.ndarray


def refine_extremes(
    dense: Dense, row: int, where: Candidates, smooth: bool
) -> Found:
    """The extreme on each interval.

    Parameters
    ----------
    dense : callable
    row : int
        Number of the signal.
    where : Candidates
    smooth : bool
        Whether Newton's step may be taken: no kink lies inside.
    """
    begins, ends, signs = where.begins, where.ends, where.signs
    if not len(begins):
        return Found(begins, begins)
    best_time, best = begins, np.full(len(begins), -np.inf)
    grid = values = np.empty((len(begins), len(POINTS)))
    every = np.arange(len(begins))
    for _ in range(ROUNDS):
        grid = begins[:, None] + (ends - begins)[:, None] * POINTS
        values = signs[:, None] * dense(grid.ravel())[row].reshape(grid.shape)
        top = np.argmax(values, axis=1)
        better = values[every, top] > best
        best = np.where(better, values[every, top], best)
        best_time = np.where(better, grid[every, top], best_time)
        inner = np.clip(top, 1, len(POINTS) - 2)
        begins, ends = grid[every, inner - 1], grid[every, inner + 1]
    if smooth:
        inner = np.clip(np.argmax(values, axis=1), 1, len(POINTS) - 2)
        f = values[every[:, None], inner[:, None] + np.array([-1, 0, 1])]
        h = grid[:, 1] - grid[:, 0]
        with np.errstate(all="ignore"):
            bend = f[:, 0] - 2 * f[:, 1] + f[:, 2]
            shift = (f[:, 0] - f[:, 2]) / (2 * bend)
            vertex = f[:, 1] + (f[:, 2] - f[:, 0]) * shift / 4
            valid = (bend < 0) & (np.abs(shift) <= 1) & (vertex > best)
        best = np.where(valid, vertex, best)
        best_time = np.where(valid, grid[every, inner] + h * shift, best_time)
    return Found(best_time, signs * best)


def refine_crossings(
    dense: Dense,
    row: int,
    begins: np.ndarray,
    ends: np.ndarray,
    signs: np.ndarray,
    level: float = 0.0,
) -> np.ndarray:
    """Where sign * signal, above the level at the begin of an interval, falls to it for good."""
    if not len(begins):
        return begins
    every = np.arange(len(begins))
    for _ in range(ROUNDS + 1):
        grid = begins[:, None] + (ends - begins)[:, None] * POINTS
        values = signs[:, None] * dense(grid.ravel())[row].reshape(grid.shape) - level
        last = len(POINTS) - 2 - np.argmax((values > 0)[:, -2::-1], axis=1)
        begins, ends = grid[every, last], grid[every, last + 1]
        above, below = values[every, last], values[every, last + 1]
    with np.errstate(all="ignore"):
        share = above / (above - below)
    share = np.where((above > 0) & (below <= 0), share, 1.0)
    times: np.ndarray = begins + (ends - begins) * share
    return times
