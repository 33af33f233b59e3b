"""Which rates of uncertain terms make the bound of the implemented loop smaller, or why none do."""

from __future__ import annotations

from certrack.certificates.implemented.drive import estimates_disturbances
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.systems.system import System


def rated_terms(system: System) -> tuple[str, ...]:
    """Names of the terms that act and have a rate."""
    u = system.plant.uncertainty
    known = (k for k, tau in enumerate(u.tau) if tau and u.acts(k) and u.slowness(k) is not None)
    return tuple(f"w_{k + 1}" for k in known)


def rates_unused(system: System, proof: ImplementedProof) -> str:
    """Why a proof does not use the rates that the file states; empty where it does, or none are."""
    drive = system.implementation
    if proof.slow or not rated_terms(system):
        return ""
    if not estimates_disturbances(system):
        return (
            "nothing estimates what acts, and then the worst is constant: add law.observer of "
            "kind eso or dob, or law.integral"
        )
    if drive is not None and drive.jitter:
        return "they are not used together with implementation.jitter"
    if proof.cell:
        return "they are not used together with plant.ranges"
    return "what acts may still be as bad as without them"
