"""The constants at which a linear loop is worst: corners of the ranges, or something inside."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from certrack.certificates.ranges.attainable import worst_reference
from certrack.certificates.ranges.loop import RangedLoop, error_form

#: Corners that are looked at: those of six ranges.
MAX_ATTACKED_CORNERS = 64


def worst_corners(loop: RangedLoop, bounds: tuple[float, ...], count: int) -> list[tuple[Any, ...]]:
    """The points of the box at which linear programs find the largest errors, the worst first.

    They are corners, the nominal point, and the worst of these with a constant in the middle of its
    range.

    Parameters
    ----------
    loop : RangedLoop
    bounds : Y_0 ... Y_{q+1}
    count : int
        So many at most.
    """
    points = [tuple(loop.nominal)]
    if not loop.box:
        return points
    points += itertools.islice(itertools.product(*loop.box), MAX_ATTACKED_CORNERS)
    errors = _errors(loop, bounds, points)
    if not errors:
        return []
    worst = max(errors, key=lambda pair: pair[0])[1]
    middles = [
        (*worst[:i], (low + high) / 2, *worst[i + 1 :]) for i, (low, high) in enumerate(loop.box)
    ]
    errors += _errors(loop, bounds, middles)
    errors.sort(key=lambda pair: -pair[0])
    return [point for _, point in errors[:count]]


def _errors(
    loop: RangedLoop, bounds: tuple[float, ...], points: list[tuple[Any, ...]]
) -> list[tuple[float, tuple[Any, ...]]]:
    """The attained errors at points where the loop is stable."""
    u, A = loop.system.plant.uncertainty, loop.coordinates.A.astype(float)
    inputs = [A[:, k] * u.tau[k] * u.beta[k] for k in range(loop.n) if u.tau[k] * u.beta[k]]
    columns = np.array(inputs, dtype=float).reshape(len(inputs), loop.n).T
    errors = []
    for point in points:
        form = error_form(loop, loop.entries.at(point))
        M, W, offset = (part.astype(float) for part in (form.M, form.W, form.offset))
        attained = worst_reference(M, W, columns, offset, bounds)
        if attained is not None:
            errors.append((attained.error, point))
    return errors
