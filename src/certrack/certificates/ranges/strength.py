"""The critical strength of ranges: how far all of them may grow together before no proof is left.

All distances of the ends from the nominal values are scaled alike, and a nominal value outside of
its range is an end of it. What is returned was proven there, and so holds at every smaller scale:
those boxes lie inside.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.ranges.boxes import forbidden, scaled
from certrack.certificates.ranges.cells import Cell, corners_of, halved
from certrack.certificates.ranges.edges import largest_scale
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

    def find(scale: Any) -> bool | str:
        progress(next(tried), None, None)
        box = scaled(prover.loop, scale)
        reason = forbidden(prover.loop, box)
        if reason:
            return reason
        try:
            with within_floats():
                return provable(prover, box, cells=cells) or NO_PROOF
        except NoCertificate as refusal:
            return str(refusal)

    same = known and scaled(prover.loop, rational(1)) == tuple(prover.loop.box)
    edge = largest_scale(find, known=True if same else None, accuracy=STRENGTH_ACCURACY)
    return RangeStrength(math.inf if edge.unlimited else float(edge.scale), edge.reason)


def provable(prover: RangeProver, box: Cell, *, cells: bool) -> bool:
    """Whether a box has a proof of some bound, by itself or, if allowed, cut into cells."""
    if not stable_at_corners(prover, box):
        return False
    if prover.holds(box):
        return True
    moving = prover.loop.moving
    sizes, waiting, count = [high - low for low, high in box], [box], 1
    while cells and waiting:
        if count >= PROVABLE_CELLS:
            return False
        count += 1
        waiting += [half for half in halved(waiting.pop(), sizes, moving) if not prover.holds(half)]
    return not waiting


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
