"""What is found of runs from starts: peaks from x0, and starts that no limit is met from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of, nominal_drive
from certrack.certificates.implemented.enclosed import widened
from certrack.certificates.implemented.input_limits import is_limited
from certrack.certificates.implemented.polytope import Polytope, common
from certrack.certificates.implemented.proof import ImplementedProof, cells_of, start_prover
from certrack.certificates.implemented.ranged import RangedPlant
from certrack.certificates.implemented.regional import is_regional
from certrack.certificates.implemented.start_proof import limit_met, polytope_of
from certrack.certificates.implemented.start_set import (
    ANY_PHASE,
    FILE_PHASE,
    POLYTOPE,
    X0,
    phase_of,
    start_set_of,
)
from certrack.certificates.ranges.proofs import numbers
from certrack.core import checks
from certrack.systems.system import System

#: Starts that a bound may be for, besides "x0" and "polytope": all, the box of the ensemble with
#: x0, none.
ANY_START, BOX, NO_START = "any", "box", "none"


@dataclass(frozen=True)
class Peaks:
    """Bounds for all t >= 0 from x(0) = simulation.x0, if no limit of the input acts.

    Attributes
    ----------
    error : float
        Of |e_1|.
    states : n floats
        Of |x_i|.
    input : float
        Of |u|.
    input_step : float
        Of |u_k - u_{k-1}|, from the input before the first sample on.
    """

    error: float
    states: tuple[float, ...]
    input: float
    input_step: float


@dataclass(frozen=True)
class StartBounds:
    """What holds for all time from some starts, if no limit of the input acts; rounded up.

    Attributes
    ----------
    period : float, s
    values : (K, n + 3) array
        Of |e_1| and the states from t_k to t_{k+1}, of |u_k|, and of |u_k - u_{k-1}|; u is without
        the constant of the law.
    last : (n + 3,) array
        The same for all t >= K period.
    offset : float
        The constant of the law, as a magnitude.
    """

    period: float
    values: np.ndarray
    last: np.ndarray
    offset: float

    @property
    def peaks(self) -> Peaks:
        """The largest of all of them."""
        error, *states, size, step = np.maximum(self.values.max(axis=0), self.last).tolist()
        return Peaks(error, tuple(states), float(widened(np.array(size + self.offset))), step)


def bounds_from_start(
    system: System,
    box: Sequence[tuple[float, float]] | None = None,
    *,
    any_reference: bool = False,
    delay: Any | None = None,
) -> StartBounds:
    """Bounds for all time from the system's own start, or from a box of starts.

    Parameters
    ----------
    system : System
        With an implementation; limits of its input are not looked at.
    box : n pairs (low, high), optional
    any_reference : bool
        Whether the reference may begin anywhere within its bounds, and not only as the file's.
    delay : rational, optional
        Periods; the first of the file if left out.

    Returns
    -------
    StartBounds

    Raises
    ------
    NoCertificate
        If there are none.

    Examples
    --------
    >>> import certrack
    >>> from certrack.certificates.implemented.from_starts import bounds_from_start
    >>> drive = certrack.Implementation(period=0.01, delay=0.5)
    >>> system = certrack.load("dual-motor-lean").replace(implementation=drive)
    >>> bool(13 < bounds_from_start(system).peaks.input < 14)
    True
    """
    region: tuple[tuple[str, str], ...] = ()
    if box is not None:
        pairs = checks.sequence("box", box, system.plant.n, "one pair (low, high) per state")
        ends = (checks.ordered_pair(f"box[{i}]", pair) for i, pair in enumerate(pairs))
        region = tuple((repr(low), repr(high)) for low, high in ends)
    with within_floats(), flint.ctx.workprec(DRIVE_BITS):
        drive = drive_of(system, delay)
        prover = start_prover(system, delay, cells_of(drive))
        known = not any_reference and phase_of(system, drive, X0) == FILE_PHASE
        starts = start_set_of(system, drive, FILE_PHASE if known else ANY_PHASE, region)
        _, evidence = prover.search(starts, lambda _: True)
    offset = float_up(abs(drive.offset))
    return StartBounds(float(drive.T), evidence.run.bounds, evidence.after, offset)


@dataclass(frozen=True)
class Findings:
    """What was found of runs from starts.

    Attributes
    ----------
    proofs : one ImplementedProof per delay
        With the proofs of starts.
    peaks : Peaks or None
    polytope : Polytope or None
    reason : str
        Why the limits may be met from x0; empty if they are not.
    """

    proofs: tuple[ImplementedProof, ...]
    peaks: Peaks | None = None
    polytope: Polytope | None = None
    reason: str = ""

    @property
    def starts(self) -> str:
        """See :class:`ImplementedCertificate`."""
        if self.reason:
            return NO_START if self.polytope is None else POLYTOPE
        return BOX if self.polytope is not None and self.polytope.is_region else X0


def from_starts(system: System, proofs: Sequence[ImplementedProof]) -> Findings:
    """Proofs from x0, and of the starts from which no limit is met."""
    plant = RangedPlant(system) if proofs[0].cell else None
    findings: list[Findings] = []
    for proof in proofs:
        begin = _begin_near(findings[-1]) if proof.cell and findings else {}
        finding = _starts_of_delay(system, proof, plant, begin)
        if begin and (finding.reason or finding.polytope is None):  # fewer periods may have one
            finding = _starts_of_delay(system, proof, plant, {})
        findings.append(finding)
    reason = next((entry.reason for entry in findings if entry.reason), "")
    polytopes = [entry.polytope for entry in findings if entry.polytope is not None]
    polytope = common(polytopes) if len(polytopes) == len(findings) else None
    if polytope is not None and polytope.largest_box() is None:
        polytope = None
    return Findings(
        tuple(entry.proofs[0] for entry in findings),
        peaks_of(system, [entry.proofs[0] for entry in findings]),
        polytope,
        reason,
    )


def _begin_near(neighbour: Findings) -> dict[str, int]:
    """The doublings that the starts of another cell need: those of this one hardly need fewer."""
    return {start.of: start.doublings for start in neighbour.proofs[0].starts}


def _starts_of_delay(
    system: System,
    proof: ImplementedProof,
    plant: RangedPlant | None,
    begin: Mapping[str, int],
) -> Findings:
    limited, polytope, reason = is_limited(system), None, ""
    starts = list(proof.starts)
    with flint.ctx.workprec(DRIVE_BITS):
        prover = start_prover(
            system, rational(Fraction(proof.delay)), proof.parts, numbers(proof.cell), plant, begin
        )
        try:
            starts = starts or [prover.prove(X0)]
            if limited and (limit := limit_met(system, prover.drive, starts[0])):
                reason = f"the limits of the input may act: {limit}"
        except NoCertificate as refusal:
            reason = f"the limits of the input may act: {refusal}" if limited else ""
        if limited or is_regional(system):
            try:
                known = [start for start in starts if start.of == POLYTOPE]
                region = known[0] if known else prover.prove(POLYTOPE)
                polytope = polytope_of(prover, region)
                starts += [] if known else [region]
            except NoCertificate:
                polytope = None
    return Findings((replace(proof, starts=tuple(starts)),), None, polytope, reason)


def peaks_of(system: System, proofs: Sequence[ImplementedProof]) -> Peaks | None:
    """The peaks from x0 over all delays and cells; None if one of them has none."""
    from_x0 = [start for proof in proofs for start in proof.starts if start.of == X0]
    if len(from_x0) != len(proofs):
        return None
    offset, n = abs(nominal_drive(system).offset), system.plant.n
    rows = [(*start.peaks[: n + 1], *start.peaks[-2:]) for start in from_x0]  # without channels
    error, *states, size, step = (max(map(from_text, column)) for column in zip(*rows, strict=True))
    return Peaks(
        float_up(error), tuple(map(float_up, states)), float_up(size + offset), float_up(step)
    )


def failed_starts(
    system: System, proof: ImplementedProof, delay: Any, plant: RangedPlant | None = None
) -> str:
    """Empty if what is said of starts holds, and no limit is met from x0; else what fails."""
    limited, regional = is_limited(system), is_regional(system)
    kinds = [start.of for start in proof.starts]
    if len(set(kinds)) < len(kinds) or not set(kinds) <= {X0, POLYTOPE}:
        return "there must be at most one proof from x0 and one of a polytope"
    if (limited or regional) and X0 not in kinds:
        what = "the input has limits" if limited else "the bound is not for every start"
        return f"{what}, and nothing is said of the start"
    if POLYTOPE in kinds and not (limited or regional):
        return "a polytope of starts is for an input with limits"
    if kinds and system.implementation is not None and system.implementation.jitter:
        return "with jitter nothing is proven of starts"
    try:
        with within_floats(), flint.ctx.workprec(DRIVE_BITS):
            prover = start_prover(system, delay, proof.parts, numbers(proof.cell), plant)
            for start in proof.starts:
                if start.of == POLYTOPE:
                    polytope_of(prover, start)
                    continue
                prover.evidence(start)
                if limited and (reason := limit_met(system, prover.drive, start)):
                    return f"the limits of the input may act: {reason}"
    except NoCertificate as refusal:
        return str(refusal)
    return ""
