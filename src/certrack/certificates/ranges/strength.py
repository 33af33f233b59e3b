"""The critical strength of ranges: how far all of them may grow together before no proof is left.

All distances of the ends from the nominal values are scaled alike, and a nominal value outside of
its range is an end of it. The scale is looked for in floats. What is returned was proven there, and
so holds at every smaller scale: those boxes lie inside.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.ranges.boxes import forbidden, moved, scaled
from certrack.certificates.ranges.cells import Cell, corners_of, halved
from certrack.certificates.ranges.edges import Edge, largest_scale
from certrack.certificates.ranges.loop import error_form
from certrack.certificates.ranges.proofs import RangeProver
from certrack.core.progress import Progress, silent

#: Cells into which a box is cut to find any proof.
PROVABLE_CELLS = 16

#: Relative accuracy of the scale.
STRENGTH_ACCURACY = 0.01

#: Why nothing was found, where nothing forbids the ranges.
NO_PROOF = "no certificate was found"


@dataclass(frozen=True)
class RangeStrength:
    """The largest common scale of all half widths with a certificate.

    Attributes
    ----------
    scale : float
        0 where there is none at any scale; inf where there still is one at 1e9.
    reason : str
        What ends it: that no certificate was found, or the key whose range would cross zero.
    """

    scale: float
    reason: str


def critical_ranges(
    prover: RangeProver, *, cells: bool, known: bool, progress: Progress = silent
) -> RangeStrength:
    """Largest common scale of the half widths with a proof.

    Parameters
    ----------
    prover : RangeProver
    cells : bool
        Whether the constants stand still, so that their ranges may be cut into cells.
    known : bool
        Whether there is a proof at scale 1.
    progress : callable
        Gets how many scales were tried, None and None.
    """
    tried = itertools.count()
    known = known and scaled(prover.loop, rational(1)) == tuple(prover.loop.box)
    search = _Search(prover, cells)

    def find(holds: Callable[[Cell], bool], scale: Any) -> tuple[Cell, ...] | str:
        progress(next(tried), None, None)
        try:
            with within_floats():
                return search.parts(holds, scale)
        except NoCertificate as refusal:
            return str(refusal)

    all_ranges: tuple[Cell, ...] | None = (tuple(prover.loop.box),) if known else None
    edge = largest_scale(
        partial(find, prover.promises), known=all_ranges, accuracy=STRENGTH_ACCURACY
    )
    if edge.result not in (None, all_ranges) and not all_hold(prover, edge.result or ()):
        edge = largest_scale(  # floats promised too much, which they do near the edge
            partial(find, prover.holds),
            begin=float(edge.scale),
            accuracy=STRENGTH_ACCURACY,
            fall=1 + 2 * STRENGTH_ACCURACY,
        )
        if known and float(edge.scale) < 1:
            edge = Edge("1", all_ranges, edge.reason)
    return RangeStrength(math.inf if edge.unlimited else float(edge.scale), edge.reason)


def all_hold(prover: RangeProver, boxes: Sequence[Cell]) -> bool:
    """Whether every box has a proof of some bound."""
    try:
        with within_floats():
            return all(map(prover.holds, boxes))
    except NoCertificate:
        return False


class _Search:
    """Cells that fill the scaled boxes; each search begins with those of the last that held.

    Parameters
    ----------
    prover : RangeProver
    cells : bool
        Whether a box may be cut.
    """

    def __init__(self, prover: RangeProver, cells: bool) -> None:
        self._prover, self._cells = prover, cells
        self._scale = rational(1)
        self._held: tuple[Cell, ...] = (scaled(prover.loop, self._scale),)

    def parts(self, holds: Callable[[Cell], bool], scale: Any) -> tuple[Cell, ...]:
        """Cells that all hold and fill the box of a scale.

        Raises
        ------
        NoCertificate
            If none are found, or nothing of the design's form has such ranges.
        """
        loop = self._prover.loop
        box = scaled(loop, scale)
        if reason := forbidden(loop, box):
            raise NoCertificate(reason)
        if not stable_at_corners(self._prover, box):
            raise NoCertificate(NO_PROOF)
        sizes, holding = [high - low for low, high in box], []
        waiting = [moved(loop, cell, scale / self._scale) for cell in self._held]
        while waiting:
            part = waiting.pop()
            if holds(part):
                holding.append(part)
            elif self._cells and len(holding) + len(waiting) + 1 < PROVABLE_CELLS:
                waiting += halved(part, sizes, loop.moving)
            else:
                raise NoCertificate(NO_PROOF)
        self._scale, self._held = scale, tuple(holding)
        return self._held


def stable_at_corners(prover: RangeProver, box: Cell) -> bool:
    """Whether the linear loop is stable where it can be looked at cheaply: no proof of anything."""
    loop = prover.loop
    if not prover.by_peak_gains:
        return True
    for corner in corners_of(box):
        M = error_form(loop, loop.entries.at(corner)).M.astype(float)
        if not np.linalg.eigvals(M).real.max() < 0:
            return False
    return True
