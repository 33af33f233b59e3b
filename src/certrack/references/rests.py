"""Where a reference rests and where it moves: its moves from rest to rest."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from certrack.references.base import Reference

#: Points of a stretch between two breaks at which the speed is looked at, as parts of it.
LOOKED_AT = np.array([0.1, 0.35, 0.6, 0.9])


class MoveTimes(NamedTuple):
    """A move from rest to rest, in s and in the unit of the output.

    It begins, arrives, and rests until the next one begins or the time that is looked at ends.
    """

    begin: float
    arrival: float
    until: float
    origin: float
    target: float


def moves_of(reference: Reference, end: float) -> tuple[MoveTimes, ...]:
    """The moves that arrive before a time; a reference that never rests has none.

    A rest is a stretch between two breaks on which y_d does not change. What begins at t = 0, even
    with a speed, is a move, too.

    Parameters
    ----------
    reference : Reference
    end : float, s
    """
    if not end > 0:
        return ()
    edges = [0.0, *np.asarray(reference.breaks(0.0, end), dtype=float).tolist(), end]
    if len(edges) == 2:
        return ()
    begins, widths = np.array(edges[:-1]), np.diff(edges)
    times = begins[:, None] + widths[:, None] * LOOKED_AT
    speeds = reference.values(times.ravel(), 1)[1].reshape(times.shape)
    resting = (speeds == 0.0).all(axis=1).tolist()
    moves: list[MoveTimes] = []
    begin: float | None = None if resting[0] else 0.0
    for i, (before, after) in enumerate(pairwise(resting), 1):
        if before and not after:
            begin = edges[i]
        elif after and not before and begin is not None:
            j = next((k for k in range(i, len(resting)) if not resting[k]), len(resting))
            ends = np.array([begin, (edges[i] + edges[i + 1]) / 2])
            origin, target = reference.values(ends, 0)[0].tolist()
            moves.append(MoveTimes(begin, edges[i], edges[j], origin, target))
    return tuple(moves)
