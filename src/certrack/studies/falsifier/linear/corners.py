"""The constants at which a linear loop is worst: corners of the ranges, or something inside."""

from __future__ import annotations

from typing import Any

from certrack.certificates.ranges.attainable import attained_at
from certrack.certificates.ranges.cells import corners_of
from certrack.certificates.ranges.loop import RangedLoop


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
    points += corners_of(loop.box)
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
    attempts = ((attained_at(loop, point, bounds), point) for point in points)
    return [(attained.error, point) for attained, point in attempts if attained is not None]
