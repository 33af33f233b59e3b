"""The certificate of the loop of a system as it is implemented."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.certificate import Certificate, NoCertificate, within_floats
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.cover import Proven, failed_cells, prove_cells
from certrack.certificates.implemented.drive import nominal_drive, open_names
from certrack.certificates.implemented.from_starts import (
    ANY_START,
    BOX,
    NO_START,
    Findings,
    Peaks,
    failed_starts,
    from_starts,
)
from certrack.certificates.implemented.input_limits import is_limited
from certrack.certificates.implemented.margins import PeriodMargins, period_margins
from certrack.certificates.implemented.polytope import Polytope
from certrack.certificates.implemented.proof import (
    ImplementedProof,
    delays,
    failed_implemented,
    prove_implemented,
)
from certrack.certificates.implemented.ranged import RangedPlant, refuse_in_cells
from certrack.certificates.implemented.rates_used import rated_terms, rates_unused
from certrack.certificates.implemented.region import without_polytopes
from certrack.certificates.implemented.regional import is_regional
from certrack.certificates.implemented.start_set import X0
from certrack.certificates.premise import Premise
from certrack.certificates.ranges.cells import Cell
from certrack.certificates.region import claim_text, is_only_in_region
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: What limits of the input mean for the bound: there are none; they are proven never to be met from
#: the starts that it is for; they may be met.
NO_LIMITS, INACTIVE, MAY_ACT = "none", "inactive", "may act"

KIND = "implemented"


@dataclass(frozen=True, repr=False)
class ImplementedCertificate(Certificate):
    """limsup |e_1(t)| <= bound for the sampled loop, between its samples too.

    Attributes
    ----------
    peak_input : float
        limsup |u| is at most this.
    states : n floats
        limsup |x_i| are at most these.
    saturation : str
        ``"none"``: the file has no limits. ``"inactive"``: from `starts` the limits are proven
        never to be met. ``"may act"``: from x0 they may, and nothing is verified; the bound is for
        runs in which they are not met from some time on.
    starts : str
        Which starts the bound is proven for: ``"any"``; ``"box"``, that of the ensemble with x0;
        ``"x0"``, with those in `polytope`; ``"polytope"``, but not x0; ``"none"``.
    start : n floats
        x0; none if the simulated plant has states of its own.
    peaks : Peaks or None
    polytope : Polytope or None
        Starts from which the limits are proven never to be met.
    parts : mapping of str to float
        What the bound is made of.
    cells : int
        So many cells of the ranges of constants it is proven for, over all delays; none where
        nothing has a range.
    margins : PeriodMargins or None
        The slowest and the fastest period that is proven too, if that was asked for.
    slow : tuple of str
        The uncertain terms, such as ``"w_2"``, whose rates make the bound smaller.
    rates_unused : str
        Why rates that the file states do not.
    """

    peak_input: float = math.inf
    states: tuple[float, ...] = ()
    saturation: str = NO_LIMITS
    starts: str = ANY_START
    start: tuple[float, ...] = ()
    peaks: Peaks | None = None
    polytope: Polytope | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    cells: int = 0
    margins: PeriodMargins | None = None
    slow: tuple[str, ...] = ()
    rates_unused: str = ""

    def admits(self, x0: Sequence[float] | np.ndarray) -> np.ndarray | bool:
        """Whether the bound is proven for runs from these starts.

        Parameters
        ----------
        x0 : (n,) or (..., n) array

        Returns
        -------
        bool, or array of bool of shape (...)
        """
        x0 = np.asarray(x0, dtype=float)
        if x0.shape[-1:] != (len(self.states),):
            wanted = f"must have {len(self.states)} numbers per start"
            raise InputError("x0", wanted, list(x0.shape))
        admitted = np.full(x0.shape[:-1], self.exists and self.starts == ANY_START)
        if self.polytope is not None:
            admitted = self.polytope.contains(x0)
        if self.starts in (X0, BOX) and self.start:
            admitted = admitted | (x0 == np.array(self.start)).all(axis=-1)
        return admitted if x0.ndim > 1 else bool(admitted)


def missing_implemented(reason: str) -> ImplementedCertificate:
    """The certificate that says there is none."""
    return ImplementedCertificate(KIND, math.inf, reason=reason, starts=NO_START)


def certify_implemented(
    system: System,
    *,
    from_start: bool = False,
    margins: bool = False,
    effort: str = "default",
    progress: Progress = silent,
) -> tuple[ImplementedCertificate, tuple[ImplementedProof, ...]]:
    """Certify the loop of a system with an implementation, for each of its delays.

    Parameters
    ----------
    system : System
    from_start : bool
        Find the peaks from x0 even if the input has no limits.
    margins : bool
        Search the slowest and the fastest period, too; not with jitter or claims on a region.
    effort : {"fast", "default", "high"}
        How many cells ranges of constants are cut into; ``fast`` makes one.
    progress : callable
        Gets the number of cells, None and the bound so far, where constants have ranges.

    Returns
    -------
    certificate : ImplementedCertificate
        With limits of the input, verified only where they are proven never to be met from x0.
    proofs : one ImplementedProof per delay, and for each cell of the ranges
        Empty where nothing is verified.

    Examples
    --------
    >>> import certrack
    >>> from certrack.certificates.implemented.certify import certify_implemented
    >>> system = certrack.load("dual-motor-lean")
    >>> drive = certrack.Implementation(period=0.003, delay=0.5)
    >>> certificate, proofs = certify_implemented(system.replace(implementation=drive))
    >>> certificate
    Certificate(implemented: limsup |e_1| <= 0.001279, verified)
    """
    limited = is_limited(system)
    partly = limited or is_regional(system)
    try:
        with within_floats():
            proven, tried = _proven(system, effort, progress)
            proofs = tuple(proof for proof, _ in proven)
            if reason := limits_met(system, proofs):
                raise NoCertificate(reason)
            evidence = Findings(proofs)
            if partly or (from_start and not jitters(system)):
                evidence = from_starts(system, proofs)
            searched = margins and not (is_regional(system) or jitters(system))
            periods = period_margins(system, proofs, limits_met, tried) if searched else None
    except NoCertificate as refusal:
        return missing_implemented(str(refusal)), ()
    worst = max(range(len(proofs)), key=lambda i: from_text(proofs[i].bound))
    offset = nominal_drive(system).offset
    peak = max(abs(offset) + from_text(proof.input) for proof in proofs)
    states = zip(*(proof.states[: system.plant.n] for proof in proofs), strict=True)
    verified = not limited or not evidence.reason
    return ImplementedCertificate(
        KIND,
        float_up(from_text(proofs[worst].bound)),
        verified=verified,
        reason=evidence.reason if limited else "",
        assumptions=tuple(assumptions(system)),
        peak_input=float_up(peak),
        states=tuple(float_up(max(map(from_text, values))) for values in states),
        saturation=NO_LIMITS if not limited else INACTIVE if verified else MAY_ACT,
        starts=evidence.starts if partly else ANY_START,
        start=() if system.truth.states else system.settings.x0,
        peaks=evidence.peaks,
        polytope=evidence.polytope,
        parts=proven[worst][1],
        cells=sum(bool(proof.cell) for proof in proofs),
        margins=periods,
        slow=rated_terms(system) if proofs[worst].slow else (),
        rates_unused=rates_unused(system, proofs[worst]),
    ), evidence.proofs if verified else ()


def jitters(system: System) -> bool:
    """Whether samples and inputs may be off their times: then nothing is said of a start."""
    return system.implementation is not None and system.implementation.jitter > 0


def from_x0_only(
    certificate: ImplementedCertificate, proofs: Sequence[ImplementedProof]
) -> tuple[ImplementedCertificate, tuple[ImplementedProof, ...]]:
    """A certificate and its proofs where the bounds of w hold in the region of x0 only."""
    return replace(certificate, starts=X0, polytope=None), without_polytopes(proofs)


def _proven(
    system: System, effort: str, progress: Progress
) -> tuple[list[Proven], dict[str, dict[Cell, float]]]:
    """Proofs for every delay and cell, what their bounds are made of, and the bounds of all cells
    that were looked at, by delay.
    """
    wanted = delays(system) or (None,)
    if system.implementation is None or not open_names(system):
        return [prove_implemented(system, delay) for delay in wanted], {}
    plant, proven, tried = RangedPlant(system), [], {}
    refuse_in_cells(system, plant.box)
    for delay in wanted:
        in_cells, tried[str(delay)] = prove_cells(system, plant, delay, effort, progress)
        proven += in_cells
    return proven, tried


def limits_met(system: System, proofs: Sequence[ImplementedProof]) -> str:
    """Empty if the limits of the input are not met where the bounds hold, else why they may be."""
    drive = system.implementation
    if drive is None:
        return ""
    offset = nominal_drive(system).offset
    size = max(from_text(proof.input) for proof in proofs)
    if drive.saturation is not None:
        low, high = map(rational, drive.saturation)
        if not (low <= offset - size and offset + size <= high):
            peak = rounded_up(float_up(abs(offset) + size), 4)
            return (
                f"the input may stay at its limits: it is certified to be within {peak}, "
                f"implementation.saturation is [{float(low):g}, {float(high):g}]; measure what is "
                "differenced, filter it more, or sample less often"
            )
    if drive.rate_limit is not None:
        step = max(from_text(proof.step) for proof in proofs)
        most = rational(drive.rate_limit) * rational(drive.period)
        if not step <= most:
            return (
                "the input may stay at its rate limit: its steps are certified to be within "
                f"{rounded_up(float_up(step), 4)}, rate_limit times period is {float(most):.4g}"
            )
    return ""


def largest_bound(proofs: Sequence[ImplementedProof]) -> str:
    """The largest of the bounds, as its text."""
    return max((proof.bound for proof in proofs), key=from_text)


def claim_of(system: System, bound: str, rests_on: Sequence[Premise] = ()) -> str:
    """What a certificate file claims; of the file's own start where it is not of all."""
    partly = is_limited(system) or is_regional(system) or is_only_in_region(rests_on)
    return claim_text(bound, partly)


def failed_cover(system: System, proofs: Sequence[ImplementedProof]) -> str:
    """Empty if the proofs hold, for each delay of the system and all ranges; else what fails."""
    try:
        plant = RangedPlant(system) if open_names(system) else None
    except NoCertificate as refusal:
        return str(refusal)
    wanted = delays(system)
    groups = [list(group) for _, group in groupby(proofs, lambda proof: proof.delay)]
    if len(groups) != len(wanted) or not wanted:
        return "there must be one proof for each delay of [implementation]"
    for group, delay in zip(groups, wanted, strict=True):
        if reason := failed_cells(group, plant):
            return reason
        for proof in group:
            if reason := failed_implemented(system, proof, delay, plant):
                return reason
            if reason := failed_starts(system, proof, delay, plant):
                return reason
    return limits_met(system, proofs)
