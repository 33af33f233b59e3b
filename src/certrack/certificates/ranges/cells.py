"""Branch and bound for constants that stand still: the box is cut into cells, each certified.

The bound is the largest of the cells' bounds, for the constants are in one of the cells
for ever. The worst cell is cut across its relatively widest constant, as often as it pays.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from certrack.certificates.ranges.rational import Interval

#: A cell: an interval for each constant.
Cell = tuple[Interval, ...]

#: Corners that are looked at: those of six ranges.
MAX_CORNERS = 64


def corners_of(box: Cell) -> Iterator[tuple[Any, ...]]:
    """The corners of a box, no point twice, and not more than :data:`MAX_CORNERS`."""
    return itertools.islice(itertools.product(*map(dict.fromkeys, box)), MAX_CORNERS)


def divided(
    box: Cell,
    bound: Callable[[Cell], float],
    most: int,
    worthwhile: float,
    report: Callable[[list[Cell]], None],
    enough: float = 0.0,
    moving: int = 0,
    begin: Sequence[Cell] = (),
) -> list[Cell]:
    """Cells that fill a box.

    Parameters
    ----------
    box : Cell
    bound : callable
        Bound for a cell; inf where there is none.
    most : int
        Number of cells at most.
    worthwhile : float
        The search ends when at least twice as many cells have lowered the bound by less than this
        part.
    report : callable
        Gets the cells so far.
    enough : float
        The search ends where no cell has a larger bound.
    moving : int
        So many intervals, the last ones, are not cut: what they hold varies in time.
    begin : sequence of Cell, optional
        Cells that fill the box, to begin with; the box itself if left out.
    """
    sizes = [high - low for low, high in box]
    cells = list(begin) or [box]
    history = [math.inf] * (len(cells) - 1) + [max(map(bound, cells))]  # of so many cells
    while len(cells) < most and history[-1] > enough:
        before = history[len(history) // 2 - 1]
        if len(history) > 2 and math.isfinite(before) and history[-1] > (1 - worthwhile) * before:
            break
        worst = max(range(len(cells)), key=lambda i: bound(cells[i]))
        cells[worst : worst + 1] = halved(cells[worst], sizes, moving)
        history.append(max(map(bound, cells)))
        report(cells)
    return cells


def coarsest(box: Cell, bounds: Mapping[Cell, float], enough: float, moving: int = 0) -> list[Cell]:
    """The largest cells of a search whose bound was small enough, or that it did not cut.

    Parameters
    ----------
    box, enough, moving
        Of :func:`divided`.
    bounds : mapping
        Of every cell that was looked at.

    Returns
    -------
    list of Cell
        They fill the box.
    """
    sizes = [high - low for low, high in box]
    chosen, left = [], [box]
    while left:
        cell = left.pop()
        parts = halved(cell, sizes, moving)
        if bounds.get(cell, math.inf) <= enough or any(part not in bounds for part in parts):
            chosen.append(cell)
        else:
            left.extend(parts)
    return chosen


def halved(cell: Cell, sizes: Sequence[Any], moving: int = 0) -> tuple[Cell, Cell]:
    """The cell cut in the middle of its widest constant, relative to `sizes`."""
    constants = range(len(cell) - moving)
    widest = max(constants, key=lambda i: (cell[i][1] - cell[i][0]) / (sizes[i] or 1))
    low, high = cell[widest]
    middle = (low + high) / 2
    below, above = list(cell), list(cell)
    below[widest], above[widest] = (low, middle), (middle, high)
    return tuple(below), tuple(above)
