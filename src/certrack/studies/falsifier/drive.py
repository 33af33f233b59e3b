"""The worst case found of the loop as it is implemented, and what it is held against."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from certrack.certificates import Certificate
from certrack.certificates.implemented.certify import ImplementedCertificate, certify_implemented
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.regional import is_regional
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.core.progress import Progress
from certrack.integrators.base import Outcome
from certrack.simulation.run import Run
from certrack.studies.falsifier.alarm import DEFECT, Alarm
from certrack.studies.falsifier.escape import Escape, first_escape
from certrack.studies.falsifier.linear.search import sampled_case
from certrack.studies.falsifier.outputs import ERROR, INPUT_NAME, SoughtOutput
from certrack.systems.system import System


@dataclass(frozen=True)
class DriveFalsification:
    """The worst case found of the loop as it is implemented.

    Attributes
    ----------
    worst_error : float
        Largest |e_1|, or output that is sought, of its last part, by the ordinary sampled
        simulation; inf if it escapes.
    estimate : float or None
        The same by the linear loop, where the sensors' rounding is the worst error of half a step;
        None where the loop is not linear.
    system : System
        Replays it.
    stopped : str or None
        How the run ended, where it did not reach its end.
    certificate : Certificate
        Of the loop as it is implemented; not verified if a premise is contradicted.
    limited : bool
        Whether the input may have met its limits, or the run begins where nothing is certified: the
        certificate is not for such a run, which begins elsewhere than the file's.
    escape : Escape or None
        Where a bound of w grows faster than the state: the nearest start found from which the
        states escape.
    runs : int
        Runs of the search, where the loop is not linear.
    """

    worst_error: float
    estimate: float | None
    system: System
    stopped: str | None
    certificate: Certificate
    limited: bool = False
    escape: Escape | None = None
    runs: int = 0

    @property
    def exceeds(self) -> bool:
        """Whether the case is beyond a verified bound: then certrack is wrong."""
        if self.certificate.verified and self.escape is not None and self.escape.within:
            return True
        beyond = self.certificate.verified and self.worst_error > self.certificate.bound
        return beyond and not self.limited


#: What an alarm of the sampled loop says.
BEYOND_IMPLEMENTED = (
    "the worst case of the loop as implemented is beyond its certificate: certrack itself is "
    "wrong; please report this file"
)


def first_alarm(alarms: Iterable[Alarm | None], drive: DriveFalsification | None) -> Alarm | None:
    """The first alarm of the continuous runs; else that of the loop as implemented, or None."""
    raised = next(filter(None, alarms), None)
    if raised is None and drive is not None and drive.exceeds:
        return Alarm(DEFECT, BEYOND_IMPLEMENTED)
    return raised


def attacked_by_kernels(
    system: System,
    bounds: tuple[float, ...],
    effort: str,
    certifying: Progress,
    output: SoughtOutput = ERROR,
) -> DriveFalsification:
    """The worst case of the linear loop as it is implemented, and its certificate.

    Parameters
    ----------
    system : System
        With an implementation.
    bounds : Y_0 ... Y_{q+1}
    effort : {"fast", "default", "high"}
    certifying : callable
        Of the certificate.
    output : SoughtOutput
        What is made large; the certificate's bound is then of that.

    Raises
    ------
    NothingTried
        Where the loop is not linear or not stable, or nothing is found.
    """
    case = sampled_case(system, bounds, output)
    implemented, proofs = certify_implemented(system, effort=effort, progress=certifying)
    known = premises_as_implemented(system, proofs) if proofs else premises(system)
    certificate = _about(unless_contradicted(implemented, contradicted(known)), output)
    run, escape, limited = case.run, None, may_be_limited(system, case.run)
    if is_regional(system):
        if output == ERROR:
            escape = first_escape(system, bounds, implemented.polytope)
        within = (
            implemented.polytope is not None and case.system.settings.x0 in implemented.polytope
        )
        limited = limited or not within
    return DriveFalsification(
        case.error, case.estimate, case.system, ending_of(run), certificate, limited, escape
    )


def _about(certificate: Certificate, output: SoughtOutput) -> Certificate:
    """The certificate with the bound that it has of an output."""
    if output == ERROR or not certificate.exists:
        return certificate
    assert isinstance(certificate, ImplementedCertificate)
    if output.kind == INPUT_NAME:
        return replace(certificate, bound=certificate.peak_input)
    return replace(certificate, bound=certificate.states[output.place])


def unless_contradicted(certificate: Certificate, broken: Sequence[Premise]) -> Certificate:
    """The certificate; without a word of verification where a premise is broken."""
    if not broken or not certificate.exists:
        return certificate
    reason = f"a premise is contradicted: {broken[0].detail}"
    return replace(certificate, verified=False, reason=reason)


def may_be_limited(system: System, run: Run) -> bool:
    """Whether the input of a run may have met limits that the file has."""
    drive = system.implementation
    assert drive is not None
    if drive.saturation is None:
        return drive.rate_limit is not None
    low, high = drive.saturation
    within = bool((run.u > low).all() and (run.u < high).all())
    return drive.rate_limit is not None or not within


def ending_of(run: Run) -> str | None:
    """How a run ended, where it did not reach its end."""
    return None if run.outcome is Outcome.finished else run.outcome.name
