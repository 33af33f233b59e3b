"""The certificate of the loop of a system as it is implemented."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.certificate import Certificate, NoCertificate, within_floats
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.drive import drive_of
from certrack.certificates.implemented.limits import (
    ANY_START,
    MAY_ACT,
    NO_LIMITS,
    is_limited,
)
from certrack.certificates.implemented.proof import (
    ImplementedProof,
    delays,
    failed_implemented,
    prove_implemented,
)
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

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
    saturation : {"none", "inactive", "may act"}
        Whether the file limits the input, and then whether it is proven that this never acts from
        the `starts`. Where it may act, the bound is for runs in which it does not from some time
        on; where the bounds hold it does not.
    starts : {"any", "x0", "box"} or None
        From which starts the bound is proven without that.
    parts : mapping of str to float
        What the bound is made of.
    """

    peak_input: float = math.inf
    states: tuple[float, ...] = ()
    saturation: str = NO_LIMITS
    starts: str | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


def missing_implemented(reason: str) -> ImplementedCertificate:
    """The certificate that says there is none."""
    return ImplementedCertificate(KIND, math.inf, reason=reason)


def certify_implemented(
    system: System,
) -> tuple[ImplementedCertificate, tuple[ImplementedProof, ...]]:
    """Certify the loop of a system with an implementation, for each of its delays.

    Parameters
    ----------
    system : System

    Returns
    -------
    certificate : ImplementedCertificate
        Limits of the input may act; `input_limits` of :mod:`limits` says whether they do.
    proofs : one ImplementedProof per delay
        Empty where there is no certificate.

    Examples
    --------
    >>> import certrack
    >>> from certrack.certificates.implemented.certify import certify_implemented
    >>> system = certrack.load("dual-motor-lean")
    >>> drive = certrack.Implementation(period=0.003, delay=0.5)
    >>> found, proofs = certify_implemented(system.replace(implementation=drive))
    >>> found
    Certificate(implemented: limsup |e_1| <= 0.001279, verified)
    """
    try:
        with within_floats():
            proven = [prove_implemented(system, delay) for delay in delays(system) or (None,)]
            proofs = tuple(proof for proof, _ in proven)
            if reason := limits_met(system, proofs):
                raise NoCertificate(reason)
    except NoCertificate as refusal:
        return missing_implemented(str(refusal)), ()
    worst = max(range(len(proofs)), key=lambda i: from_text(proofs[i].bound))
    offset = drive_of(system).offset
    peak = max(abs(offset) + from_text(proof.input) for proof in proofs)
    states = zip(*(proof.states for proof in proofs), strict=True)
    return ImplementedCertificate(
        KIND,
        float_up(from_text(proofs[worst].bound)),
        verified=True,
        assumptions=tuple(assumptions(system)),
        peak_input=float_up(peak),
        states=tuple(float_up(max(map(from_text, values))) for values in states),
        saturation=MAY_ACT if is_limited(system) else NO_LIMITS,
        starts=None if is_limited(system) else ANY_START,
        parts=proven[worst][1],
    ), proofs


def limits_met(system: System, proofs: Sequence[ImplementedProof]) -> str:
    """Empty if the limits of the input are not met where the bounds hold, else why they may be."""
    drive = system.implementation
    if drive is None:
        return ""
    offset = drive_of(system).offset
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


def failed_cover(system: System, proofs: Sequence[ImplementedProof]) -> str:
    """Empty if the proofs hold, one for each delay of the system; else what fails."""
    wanted = delays(system)
    if len(proofs) != len(wanted) or not wanted:
        return "there must be one proof for each delay of [implementation]"
    for proof, delay in zip(proofs, wanted, strict=True):
        if reason := failed_implemented(system, proof, delay):
            return reason
    return limits_met(system, proofs)
