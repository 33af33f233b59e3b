"""Cells of the ranges of constants for the sampled loop: found, and checked to fill the ranges.

Constants that stand still are in one of the cells for ever, so the largest of the cells' bounds
holds; the worst cell is cut as long as that pays. Constants that vary in time need one cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import flint

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.drive import DRIVE_BITS
from certrack.certificates.implemented.period import Period, one_period
from certrack.certificates.implemented.proof import (
    ImplementedProof,
    cells_of,
    periods_needed,
    prove_implemented,
)
from certrack.certificates.implemented.ranged import RangedPlant
from certrack.certificates.ranges.boxes import names, scaled
from certrack.certificates.ranges.cells import Cell, corners_of, divided
from certrack.certificates.ranges.proofs import MAX_PROOF_CELLS, cells_fill, numbers
from certrack.certificates.ranges.search import WORTHWHILE
from certrack.core.progress import Progress, silent
from certrack.core.rounding import rounded_range
from certrack.systems.system import System

#: Cells for one delay at most, by effort.
MOST_SAMPLED_CELLS = {"fast": 1, "default": 48, "high": 192}

#: What all tables of the cells for one delay may hold, by effort: about a minute, or four.
MOST_WORK = {"fast": 2e9, "default": 2e9, "high": 8e9}

#: Parts of the ranges' widths that are tried in one cell, to tell which would have a bound.
NARROWER = (0.5, 0.2, 0.05)

#: A proof and what its bound is made of.
Proven = tuple[ImplementedProof, dict[str, float]]


def prove_cells(
    system: System,
    plant: RangedPlant,
    delay: Any,
    effort: str = "default",
    progress: Progress = silent,
) -> tuple[list[Proven], dict[Cell, float]]:
    """Proofs for cells that fill the ranges of a system, for one delay.

    Parameters
    ----------
    system : System
    plant : RangedPlant
    delay : rational, periods
    effort : {"fast", "default", "high"}
        How many cells there may be.
    progress : callable
        Gets the number of cells, None and the bound so far.

    Returns
    -------
    proofs : list of Proven
    bounds : dict
        Of every cell that was looked at; inf where it has none.

    Raises
    ------
    NoCertificate
        If a cell has none, with its name.
    """
    search = _CellSearch(system, plant, delay)
    cells = search.divided(effort, progress)
    failed = next((cell for cell in cells if search.bound(cell) == math.inf), None)
    if failed is not None:
        raise NoCertificate(_no_bound_for(system, plant, delay, cells, failed, effort))
    return search.proofs(cells), {cell: search.bound(cell) for cell in search.tried}


def prove_few_cells(
    system: System, plant: RangedPlant, delay: Any, enough: float, begin: Sequence[Cell] = ()
) -> list[Proven]:
    """Proofs for cells that fill the ranges, no more of them than a bound needs.

    Parameters
    ----------
    system, plant, delay
        Of :func:`prove_cells`.
    enough : float
        The bound: the search ends where no cell has a larger one.
    begin : sequence of Cell
        Cells that fill the ranges, to begin with; they may be cut further.

    Raises
    ------
    NoCertificate
        If a cell has none.
    """
    search = _CellSearch(system, plant, delay)
    cells = search.divided("default", silent, enough, begin)
    if max(map(search.bound, cells)) == math.inf:
        raise NoCertificate("a cell of the ranges has no bound")
    return search.proofs(cells)


class _CellSearch:
    """Proofs of cells, each tried once."""

    def __init__(self, system: System, plant: RangedPlant, delay: Any) -> None:
        self._system, self._plant, self._delay = system, plant, delay
        self.tried: dict[Cell, Proven | None] = {}

    def bound(self, cell: Cell) -> float:
        """The bound of a cell; inf where it has none."""
        if cell not in self.tried:
            try:
                self.tried[cell] = prove_implemented(self._system, self._delay, cell, self._plant)
            except NoCertificate:
                self.tried[cell] = None
        known = self.tried[cell]
        return math.inf if known is None else _size(known)

    def divided(
        self, effort: str, progress: Progress, enough: float = 0.0, begin: Sequence[Cell] = ()
    ) -> list[Cell]:
        """Cells that fill the ranges."""
        plant = self._plant
        most = 1 if plant.varies else cells_allowed(plant, self._delay, effort)
        report = partial(_report, self.bound, progress)
        cells = divided(plant.box, self.bound, most, WORTHWHILE, report, enough, begin=begin)
        return sorted(cells)

    def proofs(self, cells: Sequence[Cell]) -> list[Proven]:
        """Those of cells that all have one."""
        return [proven for cell in cells if (proven := self.tried[cell]) is not None]


def cells_allowed(plant: RangedPlant, delay: Any, effort: str) -> int:
    """So many cells that their proofs take about the time that an effort may."""
    drive = plant.drive(plant.box, delay)
    with flint.ctx.workprec(DRIVE_BITS):
        try:
            work = _work_of(one_period(drive, cells_of(drive)))
        except NoCertificate:  # not stable in the middle of all ranges
            return MOST_SAMPLED_CELLS[effort]
    return max(1, min(MOST_SAMPLED_CELLS[effort], int(MOST_WORK[effort] / work)))


def _work_of(period: Period) -> float:
    """About how many numbers the tables of a proof go through.

    Raises
    ------
    NoCertificate
        If the loop is unstable, or too slow.
    """
    drive, cells = period.drive, len(period.cells)
    rows = 3 * cells * (drive.sized + 2) + period.size
    columns = (cells + 1) * (period.W.ncols() + 1) + 2 * (drive.q + 1) * cells * (drive.q + 3)
    return float(2 ** periods_needed(period) * rows * (columns + 2 * period.size))


def _size(proven: Proven) -> float:
    return float(float_up(from_text(proven[0].bound)))


def _report(bound: Callable[[Cell], float], progress: Progress, cells: list[Cell]) -> None:
    largest = max(map(bound, cells))
    progress(len(cells), None, largest if math.isfinite(largest) else None)


def _no_bound_for(
    system: System, plant: RangedPlant, delay: Any, cells: Sequence[Cell], failed: Cell, effort: str
) -> str:
    """Why there is no bound for all of the ranges: what it takes is tried, not guessed."""

    def reason_of(cell: Cell) -> str:
        try:
            prove_implemented(system, delay, cell, plant)
        except NoCertificate as refusal:
            return str(refusal)
        return ""

    if reason := reason_of(scaled(plant.loop, rational(0))):
        return f"no bound even where the constants of plant.ranges are the nominal ones: {reason}"
    if lost := _lost_corner(plant, delay):
        return f"plant.ranges are too wide: {lost}; narrow them, or choose other gains"
    ends = ", ".join(
        f"{name} in {rounded_range(float(low), float(high))}"
        for name, (low, high) in zip(names(plant.loop), failed, strict=True)
    )
    share = next((s for s in NARROWER if not reason_of(scaled(plant.loop, rational(s)))), None)
    narrower = "narrow plant.ranges" + (
        "" if share is None else f" (proven in one cell: with {100 * share:.0f} % of their widths)"
    )
    if plant.varies:
        return (
            f"plant.ranges are too wide for constants that vary in all of them ({ends}), and known "
            f"constants have a bound; {narrower}, or state that they stand still (constants_vary)"
        )
    if effort == "fast":
        return (
            "plant.ranges are too wide for one proof of all of them, and known constants have a "
            f"bound; take --effort default, which cuts the ranges into cells, or {narrower}"
        )
    higher = ", or take --effort high (more cells)" if effort == "default" else ""
    return (
        f"plant.ranges are too wide: none for {ends}, the worst of {len(cells)} cells, and known "
        f"constants have a bound; {narrower}{higher}, or raise c"
    )


def _lost_corner(plant: RangedPlant, delay: Any) -> str:
    """The corner of the ranges where the sampled loop is unstable, or nearly, and so no cell helps;
    empty if none was found.
    """
    for corner in corners_of(plant.box):
        drive = plant.drive(tuple((value, value) for value in corner), delay)
        with flint.ctx.workprec(DRIVE_BITS):
            try:
                periods_needed(one_period(drive, cells_of(drive)))
            except NoCertificate as refusal:
                pairs = zip(names(plant.loop), corner, strict=False)
                where = ", ".join(f"{name} = {float(value):.6g}" for name, value in pairs)
                return f"at {where} {refusal}"
    return ""


def failed_cells(proofs: Sequence[ImplementedProof], plant: RangedPlant | None) -> str:
    """Empty if the cells of the proofs for one delay fill the ranges, else what is wrong."""
    if plant is None:
        single = len(proofs) == 1 and not proofs[0].cell
        return "" if single else "there must be one proof for each delay of [implementation]"
    if len(proofs) > MAX_PROOF_CELLS:
        return f"there are more than {MAX_PROOF_CELLS} cells"
    if plant.varies and len(proofs) != 1:
        return "constants that vary in time need one cell: they do not stay in one of many"
    cells = [numbers(proof.cell) for proof in proofs]
    if any(len(cell) != len(plant.box) for cell in cells):
        return "a cell has not one interval for each range"
    return "" if cells_fill(cells, plant.box) else "the cells do not cover the ranges"
