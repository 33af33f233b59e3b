"""What is certified of an output besides the error, and whether a run is beyond it.

Of the input and of the states of a law that knows its parameters there are quadratic functions of
their own; |x_1| <= |e_1| + Y_0 follows from the error's bound. Of estimates nothing is claimed.

    |y(t)| <= direct + sqrt(2 V(t)),    V(t) <= V(0) e^{-alpha t} + Delta/alpha

so a run that begins with V(0) has sqrt(2 V(0) e^{-alpha t}) more than the bound in the long run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, float_up
from certrack.certificates.input_bounds import certify_input
from certrack.certificates.methods import Methods, every_certificate
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.state_bounds import certify_state
from certrack.core.progress import Progress
from certrack.integrators.base import Outcome
from certrack.references.base import bound_of
from certrack.simulation.run import Run
from certrack.studies.falsifier.alarm import RUN_ROUNDING, Alarm, alarm, why_beyond
from certrack.studies.falsifier.outputs import ESTIMATE, INPUT_NAME, SoughtOutput
from certrack.systems.system import System

#: How a bound was proven, in words.
OF_ITS_OWN, BY_ERROR = "a quadratic function of its own", "that of the error, and Y_0"


@dataclass(frozen=True)
class OutputClaim:
    """A bound on the largest magnitude of an output in the long run.

    Attributes
    ----------
    bound : float
        Rounded up, unit of the output; inf where nothing is claimed.
    verified : bool
        Whether exact arithmetic has confirmed it, and no premise is contradicted.
    by : str
        How it was proven.
    reason : str
        Why nothing is claimed, or not verified.
    proof : Proof or None
        Where it has a quadratic function of its own.
    methods : Methods or None
        The certificates of the error, where it follows from theirs.
    """

    bound: float = math.inf
    verified: bool = False
    by: str = ""
    reason: str = ""
    proof: Proof | None = None
    methods: Methods | None = None

    @property
    def exists(self) -> bool:
        """Whether there is a bound at all."""
        return math.isfinite(self.bound)


def output_claim(
    system: System, output: SoughtOutput, effort: str, progress: Progress
) -> OutputClaim:
    """What is certified of an output of the continuous loop.

    Parameters
    ----------
    system : System
    output : SoughtOutput
    effort : {"fast", "default", "high"}
        Of the error's certificates, where they count.
    progress : callable
        Of these.
    """
    try:
        claim = _proven_claim(system, output, effort, progress)
    except NoCertificate as refusal:
        return OutputClaim(reason=str(refusal))
    broken = contradicted(premises(system))
    if not broken:
        return claim
    reason = f"a premise is contradicted: {broken[0].detail}"
    return OutputClaim(claim.bound, False, claim.by, reason, claim.proof, claim.methods)


def _proven_claim(
    system: System, output: SoughtOutput, effort: str, progress: Progress
) -> OutputClaim:
    """The smaller one of those that exist."""
    if output.kind == ESTIMATE:
        raise NoCertificate("of estimates nothing is claimed")
    if output.kind == INPUT_NAME:
        of_input = certify_input(system)
        if of_input.ultimate is None:
            raise NoCertificate(of_input.reason or of_input.missing["ultimate"])
        return OutputClaim(of_input.ultimate.bound, True, OF_ITS_OWN, "", of_input.ultimate.proof)
    reason = ""
    claims = list[OutputClaim]()
    try:
        of_state = certify_state(system, output.place)
        claims.append(OutputClaim(of_state.bound, True, OF_ITS_OWN, "", of_state.proof))
    except NoCertificate as refusal:
        reason = str(refusal)
    if output.place == 0:
        methods = every_certificate(system, effort, progress)
        if methods.best is not None:
            size = exact_float(bound_of(system.reference, 0)[0], rational)
            most = float_up(rational(methods.best.bound) + size)
            claims.append(OutputClaim(most, True, BY_ERROR, "", None, methods))
    if not claims:
        raise NoCertificate(reason or "the error has no verified bound")
    return min(claims, key=lambda claim: claim.bound)


def output_alarm(
    system: System, output: SoughtOutput, claim: OutputClaim, case: System, run: Run
) -> Alarm | None:
    """The alarm that a run raises against a proven claim, or None.

    Parameters
    ----------
    system : System
        The one that the claim is about.
    output : SoughtOutput
    claim : OutputClaim
    case : System
        What was run.
    run : Run
    """
    if not claim.exists:
        return None
    if claim.methods is not None and claim.methods.best is not None:
        raised = alarm(system, case, run, claim.methods.best, claim.methods.stages)
        if raised is not None:
            return raised
    if run.outcome is Outcome.undefined:  # of what comes after its end there are no values to see
        return why_beyond(system, case, run)
    slack = RUN_ROUNDING * case.settings.tolerance
    slack *= max(1.0, float(np.abs(output.values(run)).max(initial=0.0)))
    if output.tail(run) <= claim.bound + _of_start(case, claim) + slack:
        return None
    return why_beyond(system, case, run)


def _of_start(case: System, claim: OutputClaim) -> float:
    """What the start of a case may add to the bound from the begin of the tail on."""
    if claim.proof is None:
        return math.inf  # the tube of the error has been looked at
    c, t = case.controller.coordinates, case.settings.tail_start
    e = c.A @ np.array(case.settings.x0) - c.B @ case.reference.values(np.zeros(1), c.q)[:, 0]
    P = np.array([[float(v) for v in row] for row in claim.proof.P])
    return float(math.sqrt(max(0.0, e @ P @ e)) * math.exp(-float(claim.proof.alpha) * t / 2))
