"""What a certificate of the adaptive law as implemented rests on."""

from __future__ import annotations

from certrack.certificates.exact import float_up
from certrack.certificates.implemented.premises import (
    SAMPLED_LOOP,
    SAMPLED_REFERENCE,
    TIMING,
    lipschitz_status,
)
from certrack.certificates.premise import ASSUMED, PROVEN, Premise
from certrack.certificates.premises_of_truth import CONTINUOUS_LAW, premises
from certrack.certificates.sampled_adaptive.certify import starts_inside, words_of_starts
from certrack.certificates.sampled_adaptive.held import held_law
from certrack.certificates.sampled_adaptive.proof import SampledAdaptiveProof
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: Names, in the order of the list, beside those of every implemented loop.
STARTS, SATURATION = "starts", "input limits and projection"


def premises_of_sampled_adaptive(
    system: System, proof: SampledAdaptiveProof
) -> tuple[Premise, ...]:
    """What the bound of a proof rests on, and whether the file's own truth keeps it.

    Parameters
    ----------
    system : System
        With an implementation that the proof covers.
    proof : SampledAdaptiveProof

    Returns
    -------
    tuple of Premise

    Raises
    ------
    NoCertificate
        If the implementation is not covered.
    """
    held, drive = held_law(system), system.implementation
    assert drive is not None
    others = [premise for premise in premises(system) if premise.name != CONTINUOUS_LAW]
    inside = starts_inside(system, proof)
    order = system.controller.coordinates.q + 1
    update = "exact for their leak" if held.exact_leak else "Euler's"
    listed = " or ".join(f"{value:g}" for value in drive.delays)
    errors = [
        f"{rounded_up(float_up(mu), 4)} for {name}"
        for name, mu in zip(system.plant.states, held.mu, strict=True)
        if mu
    ]
    sensors = f"sensors within {', '.join(errors)}" if errors else "exact sensors"
    steps = f"; the input in steps of {drive.input_quantum:g}" if drive.input_quantum else ""
    limits = [
        *(["its saturation"] if held.saturation is not None else []),
        *(["its projection"] if held.projection is not None else []),
    ]
    named = " and ".join(limits) if limits else ""
    acts = f"from these starts {named} never acts" if named else "the file has none"
    return (
        *others,
        Premise(
            STARTS,
            PROVEN if inside else ASSUMED,
            f"{words_of_starts(proof)}; before the first input acts it is {float(held.initial):g}",
            remedy=""
            if inside
            else "start near the reference, with simulation.estimates at the priors; from "
            "elsewhere nothing is proven of the sampled loop",
        ),
        Premise(
            SAMPLED_LOOP,
            PROVEN,
            f"sampled every {drive.period:g} s, its input acts {listed} periods later and is held; "
            f"{sensors}; the estimates' steps are {update}{steps}",
        ),
        Premise(SATURATION, PROVEN, acts),
        Premise(
            SAMPLED_REFERENCE,
            lipschitz_status(system.reference, order),
            f"y_d^({order}) changes by at most {rounded_up(float_up(held.steepest), 6)} per s",
        ),
        Premise(
            TIMING,
            ASSUMED,
            "samples come exactly every period and their inputs exactly after the delay; the "
            "controller computes exactly, and encoders and converter round to the nearest step",
            remedy="keep a margin for jitter and for 32-bit rounding",
        ),
    )
