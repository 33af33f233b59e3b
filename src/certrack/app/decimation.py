"""Curves with as many points as a screen can show, and no peak lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Samples per column of pixels up to which a curve is sent as it is.
RAW_PER_PIXEL = 2

#: Both points of a column with one sample are apart by this part of the run.
COLUMN_GAP = 1e-9


def decimate(
    t: np.ndarray, rows: Sequence[np.ndarray], pixels: int
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The least and the largest value in every column of pixels, in the order of occurrence.

    All rows have the same times, so that a plot needs one abscissa.

    Parameters
    ----------
    t : (N,) array, rising
    rows : sequence of (N,) arrays
    pixels : int

    Returns
    -------
    times and rows
        As they are where there are at most two samples a pixel.
    """
    if len(t) <= RAW_PER_PIXEL * pixels:
        return t, [np.asarray(row) for row in rows]
    columns = np.linspace(t[0], t[-1], pixels + 1)[:-1]
    starts = np.unique(np.minimum(np.searchsorted(t, columns), len(t) - 1))
    last = np.append(starts[1:], len(t)) - 1
    times = np.empty(2 * len(starts))
    times[0::2], times[1::2] = t[starts], t[last]
    times[1::2] += np.where(last == starts, COLUMN_GAP * (t[-1] - t[0]), 0.0)
    return times, [_extremes(np.asarray(row, dtype=float), starts) for row in rows]


def _extremes(row: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Both extremes of each column; the one that comes first stands first."""
    low, high = np.minimum.reduceat(row, starts), np.maximum.reduceat(row, starts)
    counts = np.diff(np.append(starts, len(row)))
    place = np.arange(len(row))
    lowest, highest = (
        np.maximum.reduceat(np.where(row == np.repeat(extreme, counts), place, -1), starts)
        for extreme in (low, high)
    )
    values = np.empty(2 * len(starts))
    values[0::2] = np.where(lowest <= highest, low, high)
    values[1::2] = np.where(lowest <= highest, high, low)
    return values
