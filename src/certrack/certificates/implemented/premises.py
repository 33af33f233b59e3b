"""What a certificate of the implemented loop rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up
from certrack.certificates.implemented.drive import nominal_drive
from certrack.certificates.implemented.input_limits import is_limited
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.rate_premise import rate_premises
from certrack.certificates.implemented.region import region_of_runs
from certrack.certificates.implemented.regional import is_regional
from certrack.certificates.premise import ASSUMED, CHECKED, PROVEN, Premise
from certrack.certificates.premises_of_truth import CONTINUOUS_LAW, premises
from certrack.certificates.region import in_region, while_within
from certrack.core.rounding import rounded_up
from certrack.laws.observer import DOB
from certrack.model.implementation import Implementation
from certrack.references import SymbolicReference
from certrack.references.base import Reference, lipschitz_bound
from certrack.references.soft_start import long_run
from certrack.systems.system import System

#: Names, in the order of the list; they stand in the place of the continuous law's.
SAMPLED_LOOP, SAMPLED_REFERENCE, TIMING, LIMITS, REGION = (
    "sampled loop",
    "sampled reference",
    "timing and arithmetic",
    "input limits",
    "region of states",
)


def premises_as_implemented(
    system: System, proofs: Sequence[ImplementedProof] = ()
) -> tuple[Premise, ...]:
    """What the implemented certificate of `system` rests on; see :func:`premises`.

    Parameters
    ----------
    system : System
        With an implementation.
    proofs : of the implemented loop
        Where they have bounds from x0, the bounds of w need to hold within these only.

    Returns
    -------
    tuple of Premise
    """
    drive = system.implementation
    assert drive is not None
    rests_on = in_region(system, premises(system), region_of_runs(proofs))
    others = [premise for premise in rests_on if premise.name != CONTINUOUS_LAW]
    added = [
        Premise(SAMPLED_LOOP, PROVEN, _covered(system, drive)),
        _sampled_reference(system),
        Premise(
            TIMING,
            ASSUMED,
            f"{_timing(drive)}; the controller computes exactly, and encoders and converter round "
            "to the nearest step",
            remedy="keep a margin for 32-bit rounding"
            if drive.jitter
            else "keep a margin for jitter and for 32-bit rounding",
        ),
    ]
    added += rate_premises(system, proofs)
    if is_regional(system):
        added += _region(system, proofs)
    if is_limited(system):
        added.append(
            Premise(
                LIMITS,
                PROVEN,
                "from simulation.x0, for references that begin as the file's, the input never "
                "meets its limits; from elsewhere it may, unless the start is in the proven "
                "polytope",
            )
        )
    return (*others, *added)


def _timing(drive: Implementation) -> str:
    """When samples and inputs come."""
    if not drive.jitter:
        return "samples come exactly every period and their inputs exactly after the delay"
    return (
        f"samples come within {drive.jitter:g} periods of every period's begin, and their inputs "
        "within as much of the delay after it; the reference goes by the controller's clock"
    )


def _region(system: System, proofs: Sequence[ImplementedProof]) -> list[Premise]:
    """Where the states stay, if what is proven is not of every start."""
    region = region_of_runs(proofs)
    if region is None:
        return []
    detail = (
        "the bounds of the uncertain terms grow faster than the states, which are proven to keep "
        f"{while_within(system, region)} from simulation.x0, for references that begin as the "
        "file's; from elsewhere they may not, unless the start is in the proven box"
    )
    return [Premise(REGION, PROVEN, detail)]


def _covered(system: System, drive: Implementation) -> str:
    listed = " or ".join(f"{value:g}" for value in drive.delays)
    parts = [f"sampled every {drive.period:g} s, its input acts {listed} periods later and is held"]
    errors = [
        f"{rounded_up(float_up(mu), 4)} for {name}"
        for name, mu in zip(system.plant.states, nominal_drive(system).mu, strict=True)
        if mu and name not in drive.velocity
    ]
    parts += [f"sensors within {', '.join(errors)}"] if errors else ["exact sensors"]
    observer = system.law.observer
    if drive.velocity and (observer is None or observer.kind == DOB):
        parts.append(f"{', '.join(drive.velocity)} by filtered differences")
    if observer is not None:
        bound = observer.bound_to(system.plant, drive)
        estimated = [] if bound.kind == DOB else list(system.plant.states)
        estimated += [f"what acts on {name}" for name in bound.rows]
        parts.append(f"{', '.join(estimated)} by the observer, which is part of the loop")
    if system.law.sampled_feedforward:
        parts.append("the reference fed forward as the sampled loop needs it")
    if drive.input_quantum:
        parts.append(f"the input in steps of {drive.input_quantum:g}")
    return "; ".join(parts)


def _sampled_reference(system: System) -> Premise:
    """The Lipschitz constant of the last derivative that the law uses."""
    order = system.controller.coordinates.q + 1
    try:
        drive = nominal_drive(system)
    except NoCertificate as refusal:
        return Premise(SAMPLED_REFERENCE, ASSUMED, f"y_d^({order})", remedy=str(refusal))
    if drive.lipschitz is None:
        return Premise(
            SAMPLED_REFERENCE,
            PROVEN,
            f"y_d^({order}) may jump at any time: what is sampled of it and what the plant has to "
            "follow are counted apart",
            remedy="a reference with one more derivative has a smaller bound",
        )
    text = f"y_d^({order}) changes by at most {rounded_up(float_up(drive.lipschitz), 6)} per s"
    if drive.jumps is not None:
        size, spacing = drive.jumps
        text += (
            f" and jumps by at most {rounded_up(float_up(size), 6)}, at least {float(spacing):.6g} "
            "s apart"
        )
    return Premise(SAMPLED_REFERENCE, lipschitz_status(system.reference, order), text)


def lipschitz_status(reference: Reference, order: int) -> str:
    """What is known of the Lipschitz constant of y_d^(order)."""
    if not type(reference).__module__.startswith("certrack."):
        return ASSUMED
    reference = long_run(reference)  # what a soft start adds is exact
    declared = getattr(reference, "declared", None)
    if (
        declared is None
        or order + 1 >= len(declared)
        or not isinstance(reference, SymbolicReference)
    ):
        return PROVEN
    proven = lipschitz_bound(replace(reference, declared=None, bound=None), order)
    if proven is not None and proven <= declared[order + 1]:
        return PROVEN
    return CHECKED if order + 1 <= reference.order else ASSUMED
