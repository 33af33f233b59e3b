"""The corners of the ranges, the worst ones first."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from certrack.certificates.ranges.attainable import worst_reference
from certrack.certificates.ranges.loop import RangedLoop, error_form

#: Corners that are looked at: those of six ranges.
MAX_ATTACKED_CORNERS = 64


def worst_corners(loop: RangedLoop, bounds: tuple[float, ...], count: int) -> list[tuple[Any, ...]]:
    """The corners, and the nominal point, at which linear programs find the largest errors.

    Parameters
    ----------
    loop : RangedLoop
    bounds : Y_0 ... Y_{q+1}
    count : int
        So many at most.
    """
    u, A = loop.system.plant.uncertainty, loop.coordinates.A.astype(float)
    inputs = [A[:, k] * u.tau[k] * u.beta[k] for k in range(loop.n) if u.tau[k] * u.beta[k]]
    columns = np.array(inputs, dtype=float).reshape(len(inputs), loop.n).T
    entries = []
    points = list(_points(loop))
    if len(points) == 1:
        return points
    for point in points:
        form = error_form(loop, loop.entries.at(point))
        M, W, offset = (part.astype(float) for part in (form.M, form.W, form.offset))
        attained = worst_reference(M, W, columns, offset, bounds)
        if attained is not None:
            entries.append((attained.error, point))
    entries.sort(key=lambda pair: -pair[0])
    return [point for _, point in entries[:count]]


def _points(loop: RangedLoop) -> Iterator[tuple[Any, ...]]:
    yield tuple(loop.nominal)
    if loop.box:
        yield from itertools.islice(itertools.product(*loop.box), MAX_ATTACKED_CORNERS)
