"""The search for the best bound over the ranges of the constants.

Constants that may vary in time: one quadratic function, or the peak gains, for the whole box.
Constants that stand still: cells, by peak gains first, for they take a tenth of the time; where the
estimates of the adaptive law are in the loop, or where it helps, by quadratic functions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from certrack.certificates.exact import float_up, from_text
from certrack.certificates.ranges.cells import Cell, divided
from certrack.certificates.ranges.proofs import CellProof, RangeProver
from certrack.core.progress import Progress, silent

#: Cells at most, by peak gains and by quadratic functions; and the part by which twice as many
#: cells must lower the bound to be worth their time.
MOST_CELLS, MOST_VERTEX_CELLS, WORTHWHILE = 64, 16, 0.02

#: Worst cells of a partition by peak gains that are tried once more by a quadratic function.
RETRIED = 8


@dataclass(frozen=True)
class RangeBounds:
    """What was proven for the ranges of a system's constants.

    Attributes
    ----------
    vertices, peak : CellProof or None
        For the whole box, by one quadratic function and by peak gains: the constants may vary.
    cells : tuple of CellProof
        Of constants that stand still; empty if none were made.
    """

    vertices: CellProof | None
    peak: CellProof | None
    cells: tuple[CellProof, ...] = ()

    @property
    def best(self) -> tuple[CellProof, ...]:
        """The proofs of the smallest bound; empty if there is none."""
        single = [(proof,) for proof in (self.vertices, self.peak) if proof is not None]
        return min([p for p in (self.cells, *single) if p], key=largest, default=())

    @property
    def bound(self) -> float:
        """The smallest bound, as a float that is near it; inf if there is none."""
        return largest(self.best) if self.best else math.inf

    @property
    def certified(self) -> float:
        """The smallest bound, rounded up; inf if there is none."""
        return max((float_up(from_text(proof.bound)) for proof in self.best), default=math.inf)


def bound_ranges(
    prover: RangeProver,
    *,
    cells: bool,
    effort: str = "default",
    progress: Progress = silent,
    box: Cell | None = None,
    enough: float = 0.0,
) -> RangeBounds:
    """Prove the best bounds.

    Parameters
    ----------
    prover : RangeProver
    cells : bool
        Whether the constants stand still.
    effort : {"fast", "default", "high"}
        ``fast`` makes no cells, ``high`` four times as many.
    progress : callable
        Gets the number of cells, None and the bound so far.
    box : Cell, optional
        What the constants may be; the file's ranges if left out.
    enough : float
        A bound that is small enough: the search ends with the first that is not above it.
    """
    box = prover.box if box is None else box
    peak = prover.peak(box) if prover.by_peak_gains else None
    if peak is not None and float(peak.bound) <= enough:
        return RangeBounds(None, peak)
    vertices = prover.vertices(box)
    moving = prover.loop.moving
    is_point = all(low == high for low, high in box[: len(box) - moving])
    if not cells or effort == "fast" or is_point or RangeBounds(vertices, peak).bound <= enough:
        return RangeBounds(vertices, peak)
    many = 4 if effort == "high" else 1
    search = _Cells(prover, box, vertices, peak, enough, progress)
    proofs = search.by_peak_gains(MOST_CELLS * many) if prover.by_peak_gains else ()
    return RangeBounds(vertices, peak, proofs or search.by_vertices(MOST_VERTEX_CELLS * many))


def largest(proofs: tuple[CellProof, ...]) -> float:
    """The largest bound of cells, as a float that is near it."""
    return max(float(proof.bound) for proof in proofs)


class _Cells:
    """Proven cells that fill a box."""

    def __init__(
        self,
        prover: RangeProver,
        box: Cell,
        vertices: CellProof | None,
        peak: CellProof | None,
        enough: float,
        progress: Progress,
    ) -> None:
        self._prover, self._progress = prover, progress
        self._box, self._enough = box, enough
        self._known = {"vertices": vertices, "peak": peak}

    def by_peak_gains(self, most: int) -> tuple[CellProof, ...]:
        """Cells by peak gains; the worst of them by the better of the two."""
        proofs = self._filled("peak", most)
        if self._enough and sum(float(p.bound) > self._enough for p in proofs.values()) > RETRIED:
            return tuple(proofs.values())
        for _ in range(RETRIED if proofs else 0):
            worst = max(proofs, key=lambda cell: float(proofs[cell].bound))
            if float(proofs[worst].bound) <= self._enough:
                break
            other = self._prover.vertices(worst)
            if other is None or float(other.bound) >= float(proofs[worst].bound):
                break
            proofs[worst] = other
        return tuple(proofs.values())

    def by_vertices(self, most: int) -> tuple[CellProof, ...]:
        """Cells by quadratic functions."""
        return tuple(self._filled("vertices", most).values())

    def _filled(self, method: str, most: int) -> dict[Cell, CellProof]:
        """Proven cells; empty where one of them has no proof."""
        proofs: dict[Cell, CellProof | None] = {self._box: self._known[method]}
        prove: Callable[[Cell], CellProof | None] = getattr(self._prover, method)

        def bound(cell: Cell) -> float:
            if cell not in proofs:
                proofs[cell] = prove(cell)
            proof = proofs[cell]
            return math.inf if proof is None else float(proof.bound)

        report = partial(self._report, bound)
        cells = divided(
            self._box, bound, most, WORTHWHILE, report, self._enough, self._prover.loop.moving
        )
        proven = {cell: proof for cell in cells if (proof := proofs[cell]) is not None}
        return proven if len(proven) == len(cells) else {}

    def _report(self, bound: Callable[[Cell], float], cells: list[Cell]) -> None:
        largest_bound = max(map(bound, cells))
        self._progress(len(cells), None, largest_bound if math.isfinite(largest_bound) else None)
