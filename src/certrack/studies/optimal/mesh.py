"""Where the elements of a transcription end: at every break, and dense where the input moves."""

from __future__ import annotations

import numpy as np

from certrack.core.arrays import Array

#: Part of the elements that is spread evenly; the others are where the input moves.
EVEN_SHARE = 0.4

#: Points at which a run's input is looked at.
MESH_SAMPLES = 4001


def mesh(times: Array, inputs: Array, elements: int, breaks: Array) -> Array:
    """Ends of elements from 0 to the last of the times.

    Parameters
    ----------
    times, inputs : (N,) arrays
        An input over the horizon: its variation is spread evenly over the elements, but for
        :data:`EVEN_SHARE` of them, over which the time is.
    elements : int
        About so many elements.
    breaks : (K,) array, s
        Each is an end, too.

    Returns
    -------
    (E + 1,) array, s
    """
    horizon = float(times[-1])
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(inputs)))])
    share = moved / moved[-1] if moved[-1] > 0 else times / horizon
    spent = EVEN_SHARE * times / horizon + (1 - EVEN_SHARE) * share
    ends = np.interp(np.linspace(0.0, 1.0, elements + 1), spent, times)
    ends[0], ends[-1] = 0.0, horizon
    near = np.abs(ends[1:-1, None] - breaks[None, :]).min(axis=1, initial=np.inf)
    smallest = horizon / elements / 10
    return np.unique(np.concatenate([[0.0, horizon], ends[1:-1][near > smallest], breaks]))
