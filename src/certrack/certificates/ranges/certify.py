"""The certificates of a system whose constants have ranges."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from certrack.certificates.assumptions import assumptions
from certrack.certificates.certificate import (
    Certificate,
    NoCertificate,
    missing,
    within_floats,
)
from certrack.certificates.exact import float_down, float_up, from_text
from certrack.certificates.ranges.attainable import attained_at
from certrack.certificates.ranges.cells import corners_of
from certrack.certificates.ranges.costs import ConstantCost, costs
from certrack.certificates.ranges.proofs import CellProof, RangeProver
from certrack.certificates.ranges.search import RangeBounds, bound_ranges
from certrack.certificates.ranges.strength import RangeStrength, critical_ranges
from certrack.core.progress import Progress, silent
from certrack.systems.system import System

#: Why there is none for a system without ranges.
NO_RANGES = "no constant has a range: the nominal certificates are all there is"


@dataclass(frozen=True)
class RangeCertificates:
    """What was proven for a box of constants.

    Attributes
    ----------
    vertices : Certificate
        One quadratic function for the whole box; the constants may vary in time.
    peak : Certificate
        Peak gains for the whole box; the constants may vary in time.
    cells : Certificate
        The box cut into cells; the constants stand still.
    proof : cells with their proofs
        Of the smallest bound; empty if there is none.
    attainable : float or None
        What the linear loop reaches at the worst corner: an estimate from below, not a proof.
    vertex_proof : CellProof or None
        By one quadratic function for the whole box: what a tube can be made of.
    constants : tuple of ConstantCost
        What the range of each constant costs, if that was asked for.
    strength : RangeStrength or None
        How far all ranges may grow together, if that was asked for.
    """

    vertices: Certificate
    peak: Certificate
    cells: Certificate
    proof: tuple[CellProof, ...]
    attainable: float | None
    vertex_proof: CellProof | None = None
    constants: tuple[ConstantCost, ...] = ()
    strength: RangeStrength | None = None

    @property
    def best(self) -> Certificate:
        """The smallest bound."""
        return min((self.cells, self.vertices, self.peak), key=lambda c: c.bound)


def certify_ranges(
    system: System,
    effort: str = "default",
    progress: Progress = silent,
    *,
    details: bool = False,
) -> RangeCertificates:
    """Certify a system for all values of its constants in their ranges.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        ``fast`` makes no cells.
    progress : callable
        Gets the number of cells, None and the bound so far.
    details : bool
        Whether it is also asked what each constant costs, and how far the ranges may grow.

    Returns
    -------
    RangeCertificates
    """
    varies = system.plant.uncertainty.constants_vary
    try:
        with within_floats():
            prover = range_prover(system)
            options = {"cells": not varies, "effort": effort, "progress": progress}
            prover, bounds = smaller_bounds(prover, options)
            attainable = attainable_error(prover)
        result = _certificates(system, bounds, attainable, varies, effort)
        return _detailed(result, prover, options, bounds) if details else result
    except NoCertificate as refusal:
        return _nothing(str(refusal))


def range_prover(system: System) -> RangeProver:
    """What proves bounds for the ranges of a system.

    Raises
    ------
    NoCertificate
        If no certificate covers such a system.
    """
    try:
        prover = RangeProver(system)
    except NoCertificate:
        prover = RangeProver(system, sectors=True)  # for a term that is not bounded
        if not prover.loop.moving:
            raise
    if system.plant.uncertainty.constants_vary and not prover.by_peak_gains:
        raise NoCertificate(
            "constants_vary = true has no certificate with the adaptive law, whose V "
            "contains g_n; use the robust law, or let the constants stand still"
        )
    return prover


def smaller_bounds(prover: RangeProver, options: dict[str, Any]) -> tuple[RangeProver, RangeBounds]:
    """What is proven with bounded terms as inputs or within their sectors: the smaller bound."""
    bounds = bound_ranges(prover, **options)
    if not prover.loop.brackets:
        return prover, bounds
    within = RangeProver(prover.loop.system, sectors=True)
    if not within.loop.moving:
        return prover, bounds
    other = bound_ranges(within, **options)
    return (within, other) if other.bound < bounds.bound else (prover, bounds)


def _detailed(
    result: RangeCertificates, prover: RangeProver, options: dict[str, Any], bounds: RangeBounds
) -> RangeCertificates:
    """With what each constant costs, and how far the ranges may grow."""
    constants = costs(prover, lambda box: bound_ranges(prover, box=box, **options), bounds)
    strength = critical_ranges(
        prover,
        cells=options["cells"],
        known=bool(bounds.best),
        progress=options["progress"],
    )
    return replace(result, constants=constants, strength=strength)


def without_ranges() -> RangeCertificates:
    """What is said of a system whose constants have none."""
    return _nothing(NO_RANGES)


def _nothing(reason: str) -> RangeCertificates:
    vertices, peak, cells = (missing(kind, reason) for kind in ("vertices", "peak", "cells"))
    return RangeCertificates(vertices, peak, cells, (), None)


def _certificates(
    system: System, bounds: RangeBounds, attainable: float | None, varies: bool, effort: str
) -> RangeCertificates:
    options = {
        "vertices": () if bounds.vertices is None else (bounds.vertices,),
        "peak": () if bounds.peak is None else (bounds.peak,),
        "cells": bounds.cells,
    }
    reasons = {
        "vertices": "no quadratic function was found for the whole box; other gains may have one "
        "(certrack tune), or narrow plant.ranges",
        "peak": "the gain through the ranges is not below 1 on the whole box",
        "cells": "constants_vary = true: cells are for constants that stand still"
        if varies
        else ("cells take more time: --effort default" if effort == "fast" else "no cells found"),
    }
    by_kind = {
        kind: _certificate(kind, system, proofs) if proofs else missing(kind, reasons[kind])
        for kind, proofs in options.items()
    }
    order = ("cells", "vertices", "peak")
    best = min(order, key=lambda kind: by_kind[kind].bound)
    kinds = by_kind["vertices"], by_kind["peak"], by_kind["cells"]
    return RangeCertificates(*kinds, options[best], attainable, bounds.vertices)


def _certificate(kind: str, system: System, proofs: tuple[CellProof, ...]) -> Certificate:
    bound = from_text(cover_bound(proofs))
    rates = [from_text(proof.points[0].alpha) for proof in proofs if proof.points]
    alpha = min(rates) if len(rates) == len(proofs) else None
    return Certificate(
        kind,
        float_up(bound),
        math.nan if alpha is None else float_down(alpha),
        math.nan if alpha is None else float_up(bound**2 * alpha / 2),
        True,
        assumptions=tuple(assumptions(system)),
    )


def cover_bound(proofs: tuple[CellProof, ...]) -> str:
    """The largest of the cells' bounds, as its text."""
    return max((proof.bound for proof in proofs), key=from_text)


def attainable_error(prover: RangeProver) -> float | None:
    """The largest error that linear programs over references find at the corners of the box.

    None for a loop that is not linear, or is unstable at a corner.
    """
    loop = prover.loop
    if not prover.by_peak_gains or loop.brackets or loop.moving:
        return None
    Y = loop.system.reference.bounds(loop.coordinates.q + 1).values
    largest = 0.0
    for corner in corners_of(prover.box):
        attained = attained_at(loop, corner, Y)
        if attained is None:
            return None
        largest = max(largest, attained.error)
    return largest
