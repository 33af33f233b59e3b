"""Proofs for ranges of constants: cells that fill the box, with the numbers of each cell.

A cell is proven by one quadratic function (the stages of its points) or by peak gains, which need
no numbers: whoever checks computes them again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import sympy

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import Proof, failed_condition, from_text
from certrack.certificates.formulation import adaptation_of
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.ranges.cells import Cell
from certrack.certificates.ranges.coefficients import Coefficients
from certrack.certificates.ranges.estimates import estimated_peak_gains
from certrack.certificates.ranges.loop import RangedLoop, ranged_loop
from certrack.certificates.ranges.peak import peak_bound
from certrack.certificates.ranges.rational import MAX_HULL_POINTS, RationalVector
from certrack.certificates.ranges.vertices import (
    ProblemMaker,
    VertexProgram,
    VertexSolution,
    prove_vertices,
)
from certrack.certificates.scope import refuse_formulas
from certrack.certificates.semidefinite import best_solution
from certrack.certificates.strength import SLOW_RATE
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: Cells of a proof in a file.
MAX_PROOF_CELLS = 1024

#: A bound by peak gains is written larger by this part, and with this many digits: the quadrature
#: of another machine may differ in the last bits.
PEAK_SLACK, PEAK_DIGITS = 1e-6, 12


@dataclass(frozen=True)
class CellProof:
    """Proof for one cell.

    Attributes
    ----------
    cell : pairs of texts
        Ends of each range, as fractions such as ``"7/20"``.
    bound : str
        Decimal.
    points : Proof for each point of the cell's hull
        Empty for a proof by peak gains; one, at the cell's centre, where the hull has more than
        MAX_HULL_POINTS points.
    """

    cell: tuple[tuple[str, str], ...]
    bound: str
    points: tuple[Proof, ...] = ()


class RangeProver:
    """Proves and checks bounds for cells of a system's constants."""

    def __init__(self, system: System, *, sectors: bool = False) -> None:
        refuse_formulas(system.plant.uncertainty)
        self.loop: RangedLoop = ranged_loop(system, sectors=sectors)
        self.coefficients = Coefficients(self.loop)
        self._problems = ProblemMaker(self.loop)
        self._adaptation = adaptation_of(system, rational)

    @property
    def box(self) -> Cell:
        """All that the constants may be."""
        return self.loop.box

    @property
    def by_peak_gains(self) -> bool:
        """Whether peak gains can prove anything: not with estimates in the loop."""
        return self._adaptation is None

    def vertices(self, cell: Cell) -> CellProof | None:
        """A proof by one quadratic function, or None if none is found."""
        try:
            problems = self.problems(cell)
        except NoCertificate:
            return None
        solution = best_solution(VertexProgram([p.in_floats() for p in problems]))
        proofs = None if solution is None else prove_vertices(problems, solution)
        if proofs is None:
            return None
        return CellProof(texts(cell), proofs[0].bound, proofs)

    def holds(self, cell: Cell) -> bool:
        """Whether a cell has a proof at all, by a quadratic function or by peak gains."""
        if self.by_peak_gains and self.peak(cell) is not None:
            return True
        try:
            problems = self.problems(cell)
        except NoCertificate:
            return False
        solution = _slow_solution(problems)
        return solution is not None and prove_vertices(problems, solution) is not None

    def promises(self, cell: Cell) -> bool:
        """Whether `holds` is to be expected, by floats alone: no proof of anything."""
        if self.by_peak_gains:
            try:
                peak_bound(self.loop, self.coefficients, cell, estimated_peak_gains)
                return True
            except NoCertificate:
                pass
        try:
            return _slow_solution(self.problems(cell)) is not None
        except NoCertificate:
            return False

    def peak(self, cell: Cell) -> CellProof | None:
        """A proof by peak gains, or None if there is none."""
        try:
            return self.peak_proof(cell)
        except NoCertificate:
            return None

    def peak_proof(self, cell: Cell) -> CellProof:
        """A proof by peak gains.

        Raises
        ------
        NoCertificate
            If there is none, with the reason.
        """
        bound = peak_bound(self.loop, self.coefficients, cell).bound
        return CellProof(texts(cell), rounded_up(bound * (1 + PEAK_SLACK), PEAK_DIGITS))

    def check(self, proof: CellProof) -> str:
        """Empty if the proof of a cell holds, else what fails."""
        cell = numbers(proof.cell)
        try:
            if not proof.points:
                if not self.by_peak_gains:
                    return "peak gains prove nothing with estimates in the loop"
                with within_floats():
                    bound = peak_bound(self.loop, self.coefficients, cell).bound
                holds = rational(Fraction(bound)) <= from_text(proof.bound)
                return "" if holds else "the bound is smaller than the peak gains give"
            problems = self.problems(cell)
        except NoCertificate as refusal:
            return str(refusal)
        if len(problems) != len(proof.points):
            return "a cell has not one stage for each point of its hull, or one at its centre"
        first = proof.points[0]
        for problem, stage in zip(problems, proof.points, strict=True):
            if (stage.P, stage.alpha, stage.bound) != (first.P, first.alpha, proof.bound):
                return "the points of a cell do not share P, alpha and the bound"
            if reason := failed_condition(problem, stage):
                return reason
        return ""

    def problems(self, cell: Cell) -> list[ErrorProblem]:
        """The problems that prove a cell: at each point of its hull, or one at its centre.

        Which of the two follows from the ranges alone, so that who checks a proof knows it.
        """
        leakage = self._leakage(cell)
        if self.loop.entries.count > MAX_HULL_POINTS:
            return [self._problems.at_centre(self.coefficients, cell, leakage)]
        return self._problems.at_points(cell, leakage)

    def _leakage(self, cell: Cell) -> Adaptation | None:
        """The leakage with g_n and theta within what the constants of a cell make of them."""
        law = self._adaptation
        if law is None:
            return None
        gain, theta = self.loop.estimated
        if gain is not None:
            low, high = (end[0] for end in self._estimated([gain]).ends(cell))
            if not low * high > 0:
                raise NoCertificate("the input gain may vanish in plant.ranges; narrow them")
            law = replace(law, gains=tuple(dict.fromkeys((abs(low), abs(high)))))
        if theta:
            law = replace(
                law, theta_box=tuple(zip(*self._estimated(theta).ends(cell), strict=True))
            )
        return law

    def _estimated(self, formulas: Sequence[sympy.Expr]) -> RationalVector:
        return RationalVector.of(formulas, self.loop.symbols)


def _slow_solution(problems: Sequence[ErrorProblem]) -> VertexSolution | None:
    """What the solver finds for a small alpha, which asks least of the loop."""
    program = VertexProgram([problem.in_floats() for problem in problems])
    return program.solve(SLOW_RATE * program.fastest) if program.fastest > 0 else None


def texts(cell: Cell) -> tuple[tuple[str, str], ...]:
    """The ends of a cell as fractions."""
    return tuple((str(low), str(high)) for low, high in cell)


def numbers(cell: Sequence[tuple[str, str]]) -> Cell:
    """Exact ends of a cell from their texts."""

    def exact(text: str) -> Any:
        top, _, bottom = text.partition("/")
        return from_text(top) / from_text(bottom or "1")

    return tuple((exact(low), exact(high)) for low, high in cell)


def prover_of(system: System, intervals: int) -> RangeProver:
    """The prover whose cells have so many intervals: those of more also have slopes in them.

    Raises
    ------
    NoCertificate
        If no certificate covers such a system.
    """
    try:
        prover = RangeProver(system)
        if len(prover.box) >= intervals:
            return prover
    except NoCertificate:
        pass  # a term that is not bounded, but may lie within a sector
    return RangeProver(system, sectors=True)


def check_cells(system: System, proofs: Sequence[CellProof], bound: str) -> str:
    """Empty if every cell is proven, they fill the ranges, and none exceeds the bound."""
    if len(proofs) > MAX_PROOF_CELLS:
        return f"there are more than {MAX_PROOF_CELLS} cells"
    prover = prover_of(system, max((len(proof.cell) for proof in proofs), default=0))
    if system.plant.uncertainty.constants_vary:
        if len(proofs) != 1:
            return "constants that vary in time need one cell: they do not stay in one of many"
        if not prover.by_peak_gains:
            return "constants that vary in time have no certificate with the adaptive law"
    cells = [numbers(proof.cell) for proof in proofs]
    if any(len(cell) != len(prover.box) for cell in cells):
        return "a cell has not one interval for each range"
    if not cells_fill(cells, prover.box):
        return "the cells do not cover the ranges"
    count = len(prover.box) - prover.loop.moving
    if not all(_contains(cell[count:], prover.box[count:]) for cell in cells):
        return "a cell cuts the slope of a nonlinear term, which varies in time"
    for proof in proofs:
        if from_text(proof.bound) > from_text(bound):
            return "the bound is smaller than that of a cell"
        if reason := prover.check(proof):
            return reason
    return ""


def cells_fill(cells: Sequence[Cell], box: Cell) -> bool:
    """Whether every point of the box is in one of the cells."""
    if any(_contains(cell, box) for cell in cells):
        return True
    touching = [
        cell
        for cell in cells
        if all(c < b and a < d for (a, b), (c, d) in zip(box, cell, strict=True))
    ]
    for cell in touching[:1]:
        for i, ((a, b), ends) in enumerate(zip(box, cell, strict=True)):
            for end in ends:
                if a < end < b:
                    parts = ((a, end), (end, b))
                    return all(
                        cells_fill(touching, (*box[:i], part, *box[i + 1 :])) for part in parts
                    )
    return False


def _contains(cell: Cell, box: Cell) -> bool:
    return all(c <= a and b <= d for (a, b), (c, d) in zip(box, cell, strict=True))
