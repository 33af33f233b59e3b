"""Branch and bound for constants that stand still: the box is cut into cells, each certified.

The bound of a partition is the largest of its cells' bounds, for the constants are in one of the
cells for ever. The worst cell is cut across its relatively widest constant, as often as it pays.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from certrack.certificates.ranges.rational import Interval

#: A cell: an interval for each constant.
Cell = tuple[Interval, ...]


@dataclass(frozen=True)
class Partition:
    """Cells that cover a box, and the bound of each."""

    cells: tuple[Cell, ...]
    bounds: tuple[float, ...]

    @property
    def bound(self) -> float:
        """The largest of the cells' bounds."""
        return max(self.bounds)


def halved(cell: Cell, sizes: Sequence[Any]) -> tuple[Cell, Cell]:
    """The cell cut in the middle of its widest constant, relative to `sizes`."""
    widest = max(range(len(cell)), key=lambda i: (cell[i][1] - cell[i][0]) / sizes[i])
    low, high = cell[widest]
    middle = (low + high) / 2
    below, above = list(cell), list(cell)
    below[widest], above[widest] = (low, middle), (middle, high)
    return tuple(below), tuple(above)


def partition(
    box: Cell, bound: Callable[[Cell], float], most: int, gain: float, report: Callable[[int], None]
) -> Partition:
    """Cut `box` until `most` cells are reached or twice as many cells gain less than `gain`.

    Parameters
    ----------
    box : Cell
    bound : callable
        Bound for a cell; inf where there is none.
    most : int
    gain : float
        Relative.
    report : callable
        Gets the number of cells so far.
    """
    sizes = [high - low for low, high in box]
    heap: list[tuple[float, int, Cell]] = [(-bound(box), 0, box)]
    history = [-heap[0][0]]
    while len(heap) < most and heap[0][0] != 0:
        half = history[len(history) // 2]
        if len(history) > 3 and math.isfinite(half) and history[-1] > (1 - gain) * half:
            break
        _, number, worst = heapq.heappop(heap)
        for part in halved(worst, sizes):
            number = len(history) * 2 + len(heap)
            heapq.heappush(heap, (-bound(part), number, part))
        history.append(-heap[0][0])
        report(len(heap))
    return Partition(tuple(cell for _, _, cell in heap), tuple(-value for value, _, _ in heap))
