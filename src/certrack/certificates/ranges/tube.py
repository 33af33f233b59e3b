"""The tube of a system with ranges, from one quadratic function for the whole box.

With the P that all points of the hull share, V' <= -alpha V + Delta for constants anywhere in the
box, still or moving, so the tube is that of one stage: the law and the error coordinates, and with
them V(0), depend on the nominal constants alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from certrack.certificates.ranges.proofs import CellProof, numbers, prover_of
from certrack.certificates.tube import Tube, single_stage, starts_of
from certrack.systems.system import System


def range_tube(
    system: System, proof: CellProof, box: Sequence[tuple[float, float]] | None = None
) -> Tube:
    """Bound on |e_1(t)| for every t and all constants in their ranges.

    Parameters
    ----------
    system : System
        The one the proof is for; its reference at t = 0 and its initial estimates count.
    proof : CellProof
        For all ranges of the system, by one quadratic function.
    box : n intervals, optional
        Set of initial plant states; the system's x0 if left out.

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners.
    NoCertificate
        If each start of the box has a reference of its own (a soft start).
    """
    prover = prover_of(system, len(proof.cell))
    starts, verified = starts_of(system, box)
    tubes = [
        Tube(*single_stage(system, problem, stage, starts))
        for problem, stage in zip(prover.problems(numbers(proof.cell)), proof.points, strict=True)
    ]
    start = max(part.start for part in tubes)
    floor = max(part.floor for part in tubes)
    return replace(tubes[0], start=start, floor=floor, verified=verified)
