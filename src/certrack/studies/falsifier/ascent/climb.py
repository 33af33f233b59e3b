"""Inputs of a controlled loop made worse, turn by turn.

The adjoint gives the slopes of e_1 at the end. What is admissible is convex: shares within 1, a
reference within its bounds, constants in their ranges. So each turn goes a part of the way to the
inputs that the slopes like best, which are signs, a linear program, and corners (the method of
Frank and Wolfe); the part is halved where the error did not grow, and doubled where it did. Of a
linear loop the first turn goes all the way to the worst there is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certrack.certificates.worst_profile import worst_profile
from certrack.core.arrays import Array
from certrack.studies.falsifier.ascent.loop import ControlledLoop, Inputs

#: Pieces by which a reference can come to rest after the end.
STOPPING_PIECES = 24

#: The way is given up where a part of it as small as this makes nothing worse.
LEAST_PART = 1e-3

#: A member rests when a turn gains less than this part of its error.
LEAST_GAIN = 1e-5


def climb(
    loop: ControlledLoop,
    inputs: Inputs,
    senses: Array,
    turns: int,
    tell: Callable[[Array], None] = lambda _: None,
) -> tuple[Inputs, Array]:
    """The inputs after some turns, and e_1 times the sense of each member.

    Parameters
    ----------
    loop : ControlledLoop
    inputs : Inputs
        To begin with; what is admissible stays so.
    senses : (N,) array
        1 or -1: which side of the error is to grow.
    turns : int
    tell : callable
        Gets the errors after each turn.
    """
    errors, slopes = loop.slopes(inputs)
    errors = _comparable(senses * errors)
    part = np.ones(inputs.count)
    goals = _best(loop, slopes, senses, inputs, np.ones(inputs.count, dtype=bool))
    for _ in range(turns):
        tried = inputs.towards(goals, part)
        found, there = loop.slopes(tried)
        found = _comparable(senses * found)
        better = found > errors + LEAST_GAIN * np.abs(errors)
        inputs = tried.where(better, inputs)
        errors = np.where(better, found, errors)
        part = np.where(better, np.minimum(1.0, 2 * part), part / 2)
        part = np.where(part < LEAST_PART, 0.0, part)
        tell(errors)
        if not part.any():
            break
        moved = better & (part > 0)
        goals = _best(loop, there, senses, goals, moved)
    return inputs, errors


def _comparable(errors: Array) -> Array:
    """Errors of runs that escaped are the least: they have no slopes."""
    return np.where(np.isfinite(errors), errors, -np.inf)


def _best(loop: ControlledLoop, slopes: Inputs, senses: Array, before: Inputs, wanted: Array) -> Inputs:
    """The admissible inputs that slopes like best, of the members wanted."""
    shares = np.sign(senses * slopes.shares)
    for j, held in enumerate(loop.held):
        if held:
            shares[:, j] = np.sign(senses * slopes.shares[:, j].sum(axis=0))
    middle, radius = loop.ranges.mean(axis=1), np.diff(loop.ranges, axis=1)[:, 0] / 2
    truths = middle[:, None] + radius[:, None] * np.sign(senses * slopes.truths)
    begin, pieces = before.begin.copy(), before.pieces.copy()
    for i in np.flatnonzero(wanted):
        gains = np.concatenate([slopes.begin[:, i], slopes.pieces[:, i]])
        program = worst_profile(senses[i] * gains, loop.bounds, loop.piece_widths, STOPPING_PIECES)
        if program is not None:
            begin[:, i] = program.start
            pieces[:, i] = program.pieces[: len(pieces)]
    return Inputs(shares, begin, pieces, truths).where(wanted, before)
