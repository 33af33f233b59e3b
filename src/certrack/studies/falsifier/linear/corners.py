"""The constants at which a linear loop is worst: corners of the ranges, or something inside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from certrack.certificates.ranges.attainable import attained_at
from certrack.certificates.ranges.cells import corners_of
from certrack.certificates.ranges.loop import RangedLoop


def worst_corners(
    loop: RangedLoop,
    bounds: tuple[float, ...],
    count: int,
    size: Callable[[tuple[Any, ...]], float | None] | None = None,
) -> list[tuple[Any, ...]]:
    """The points of the box at which linear programs find the largest errors, the worst first.

    They are corners, the nominal point, and the worst of these with a constant in the middle of its
    range.

    Parameters
    ----------
    loop : RangedLoop
    bounds : Y_0 ... Y_{q+1}
    count : int
        So many at most.
    size : callable, optional
        How large an output becomes at a point, None where the loop is unstable; the error if left
        out.
    """
    size = size or (lambda point: _attained_error(loop, bounds, point))
    points = [tuple(loop.nominal)]
    if not loop.box:
        return points
    points += corners_of(loop.box)
    errors = _sizes(size, points)
    if not errors:
        return []
    worst = max(errors, key=lambda pair: pair[0])[1]
    middles = [
        (*worst[:i], (low + high) / 2, *worst[i + 1 :]) for i, (low, high) in enumerate(loop.box)
    ]
    errors += _sizes(size, middles)
    errors.sort(key=lambda pair: -pair[0])
    return [point for _, point in errors[:count]]


def _attained_error(
    loop: RangedLoop, bounds: tuple[float, ...], point: tuple[Any, ...]
) -> float | None:
    attained = attained_at(loop, point, bounds)
    return None if attained is None else attained.error


def _sizes(
    size: Callable[[tuple[Any, ...]], float | None], points: list[tuple[Any, ...]]
) -> list[tuple[float, tuple[Any, ...]]]:
    """The sizes at points where the loop is stable."""
    attempts = ((size(point), point) for point in points)
    return [(value, point) for value, point in attempts if value is not None]
