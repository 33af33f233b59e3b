"""The certificate of the adaptive law as a drive runs it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import flint

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.balls import ball_precision
from certrack.certificates.bootstrap.certify import first_proof
from certrack.certificates.certificate import Certificate, NoCertificate, within_floats
from certrack.certificates.exact import Proof, float_up, from_text
from certrack.certificates.sampled_adaptive.proof import SampledAdaptiveLoop, SampledAdaptiveProof
from certrack.certificates.sampled_adaptive.search import prove_sampled_adaptive
from certrack.certificates.start import errors_at_start, reference_at_start, states_at_start
from certrack.core.progress import Progress, silent
from certrack.systems.system import System

SAMPLED_KIND = "sampled"


@dataclass(frozen=True, repr=False)
class SampledAdaptiveCertificate(Certificate):
    """limsup |e_1(t)| <= bound for the adaptive law as implemented, from the starts that it states.

    Attributes
    ----------
    starts : n floats
        |e_i(0)| are at most these.
    estimates : pairs of floats
        delta_hat(0), theta_hat(0) are within these.
    from_file : bool
        Whether the file's own start is proven to be one of them.
    """

    starts: tuple[float, ...] = ()
    estimates: tuple[tuple[float, float], ...] = ()
    from_file: bool = False


def missing_sampled(reason: str) -> SampledAdaptiveCertificate:
    """The certificate that says there is none."""
    return SampledAdaptiveCertificate(SAMPLED_KIND, math.inf, reason=reason)


def certify_sampled_adaptive(
    system: System,
    effort: str = "default",
    first: Proof | None = None,
    progress: Progress = silent,
) -> tuple[SampledAdaptiveCertificate, SampledAdaptiveProof | None]:
    """Certify the adaptive law of a system as `[implementation]` runs it.

    limsup |e_1(t)| <= bound, between the samples too, for every start in the stated boxes of the
    errors and of the estimates, and everything else that the assumptions admit. The limits of the
    input and of the estimates are proven never to act from there.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        ``fast`` leaves it out.
    first : Proof, optional
        A proven bound on e_n of the continuous law; it is sought if left out.
    progress : callable
        Gets the bound so far, as its last argument.

    Returns
    -------
    certificate : SampledAdaptiveCertificate
    proof : SampledAdaptiveProof or None

    Examples
    --------
    >>> import certrack
    >>> from certrack.certificates.sampled_adaptive.certify import certify_sampled_adaptive
    >>> system = certrack.load("dual-motor-lean")
    >>> certify_sampled_adaptive(system)[0].exists  # its law is the robust one
    False
    """
    try:
        with within_floats():
            if effort == "fast":
                raise NoCertificate("takes more time: --effort default")
            sampled = SampledAdaptiveLoop(system)
            proof = prove_sampled_adaptive(sampled, first or first_proof(sampled.problem), progress)
            bound = float_up(from_text(proof.bound))
            inside = starts_inside(system, proof)
    except NoCertificate as refusal:
        return missing_sampled(str(refusal)), None
    invariant = proof.invariant
    return SampledAdaptiveCertificate(
        SAMPLED_KIND,
        bound,
        verified=True,
        assumptions=tuple(assumptions(system)),
        starts=tuple(float(v) for v in invariant.starts),
        estimates=tuple((float(low), float(high)) for low, high in invariant.priors),
        from_file=inside,
    ), proof


def starts_inside(system: System, proof: SampledAdaptiveProof) -> bool:
    """Whether the file's own start is proven to be one of those that a proof states."""
    invariant = proof.invariant
    pairs = zip(system.estimates, invariant.priors, strict=True)
    if any(not from_text(low) <= rational(z) <= from_text(high) for z, (low, high) in pairs):
        return False
    with ball_precision():
        x, known = states_at_start(system)
        Y, proven = reference_at_start(system, system.controller.coordinates.q)
        if not (known and proven):
            return False
        (errors,) = errors_at_start(system, [(x, Y)])
        return all(
            bool(abs(e) <= flint.arb(from_text(most)))
            for e, most in zip(errors, invariant.starts, strict=True)
        )


def words_of_starts(proof: SampledAdaptiveProof) -> str:
    """The starts of a proof in words."""
    invariant = proof.invariant
    parts = [f"|e_{i + 1}(0)| <= {size}" for i, size in enumerate(invariant.starts)]
    names = ["delta_hat(0)", *(f"theta_hat_{i + 1}(0)" for i in range(len(invariant.priors) - 1))]
    pairs = zip(names, invariant.priors, strict=True)
    parts += [f"{name} in [{low}, {high}]" for name, (low, high) in pairs]
    return ", ".join(parts)


def sampled_claim(proof: SampledAdaptiveProof) -> str:
    """What a certificate file claims."""
    return f"limsup |e_1(t)| <= {proof.bound} from {words_of_starts(proof)}"
