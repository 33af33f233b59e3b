"""All certificates of a system, side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from certrack.certificates.certificate import Certificate
from certrack.certificates.document import Stage
from certrack.certificates.estimates.estimate import BoundEstimate
from certrack.certificates.exact import Proof
from certrack.certificates.implemented.certify import (
    ImplementedCertificate,
    certify_implemented,
    from_x0_only,
    missing_implemented,
)
from certrack.certificates.implemented.drive import NO_IMPLEMENTATION
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.regional import is_of_starts
from certrack.certificates.level_set import KeptRegion, kept_region, largest_box, premises_from_x0
from certrack.certificates.methods import (
    METHOD_STEPS,
    NOMINAL_KINDS,
    QUADRATIC_KINDS,
    RANGE_KINDS,
    Methods,
    Proofs,
    certify_semidefinite,
    every_certificate,
    smallest,
)
from certrack.certificates.online.certify import OnlineProof, certify_online
from certrack.certificates.online.tube import online_tube, tube_of
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.published import critical_strength
from certrack.certificates.ranges.costs import ConstantCost
from certrack.certificates.ranges.proofs import CellProof
from certrack.certificates.ranges.strength import RangeStrength
from certrack.certificates.ranges.tube import range_tube
from certrack.certificates.region import is_only_in_region
from certrack.certificates.sampled_adaptive.certify import (
    SAMPLED_KIND,
    SampledAdaptiveCertificate,
    certify_sampled_adaptive,
    missing_sampled,
)
from certrack.certificates.sampled_adaptive.premises import premises_of_sampled_adaptive
from certrack.certificates.sampled_adaptive.proof import SampledAdaptiveProof
from certrack.certificates.scope import has_ranges
from certrack.certificates.strength import critical_semidefinite
from certrack.certificates.tube import Tube, tube
from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.notebook import ShownInNotebooks
from certrack.core.progress import Progress, silent
from certrack.core.rounding import rounded_up
from certrack.systems.system import System, require_system

#: How long `certify` may take: the closed forms, the semidefinite program and the cascade are in
#: all of them.
EFFORTS = ("fast", "default", "high")

#: Steps of which `certify` reports: the methods, and the rest.
STEPS = METHOD_STEPS + 1


@dataclass(frozen=True)
class Certificates(ShownInNotebooks):
    """Result of :func:`certify`.

    Attributes
    ----------
    published, corrected, rate, semidefinite, cascade, bootstrap : Certificate
        Of the nominal loop; none where constants have ranges.
    peak : Certificate
        Peak gains: of the nominal loop, or for all constants in their ranges.
    vertices, cells : Certificate
        For all constants in their ranges: one quadratic function, cells.
    online : Certificate
        For every motion of the gains between their ends, with ``[law.online]``.
    proof, cascade_proof
        The exactly verified numbers behind the semidefinite bound and the cascade.
    tightest : stages or cells
        The proof of the smallest bound of those that a file holds.
    kinds : tuple of str
        Which certificates speak of this loop.
    attainable : float or None
        What the linear loop reaches at the worst corner of the ranges; no proof.
    implemented : ImplementedCertificate
        Of the loop as the drive runs it: sampled, delayed, quantised; none without
        ``[implementation]``.
    implemented_proof
        The exactly verified numbers behind it, one for each delay.
    sampled : SampledAdaptiveCertificate
        The same for the adaptive law, from the starts that it states. Only where the file's own
        start is one of them may it be :attr:`best`.
    sampled_proof : SampledAdaptiveProof or None
        The exactly verified numbers behind it.
    constants : tuple of ConstantCost
        What the range of each constant costs: the bound with that range closed. Empty with the
        effort ``fast``.
    critical_ranges : RangeStrength or None
        Largest common scale of all half widths of the ranges with a proof, and what ends it; None
        where constants have no ranges, and with the effort ``fast``.
    critical_published, critical_semidefinite : float
        Largest common scale of tau with a certificate; the second is verified exactly.
    tube : Tube or None
        Bound on |e_1(t)| from the system's own start, of the tighter of semidefinite and cascade,
        or of vertices where constants have ranges; None where none of these is verified. It falls
        to their bound: peak gains say nothing of a transient.
    premises : tuple of Premise
        What the best of it rests on, and whether the system's own truth keeps it. Where it breaks
        one, nothing is verified and there is no tube: bounds are those of the design that the truth
        leaves.
    region : KeptRegion or None
        The stage whose level set keeps the states where the premises hold, if they do not hold
        everywhere; the bounds of the continuous loop are from x0 then.
    starts_box : float or None
        Where a premise of the continuous loop holds only in the region that the states keep from
        x0: the bounds hold from every start with |x_i - x0_i| <= starts_box, in the states' units.
        None where they hold from every start.
    """

    published: Certificate
    corrected: Certificate
    rate: Certificate
    semidefinite: Certificate
    cascade: Certificate
    bootstrap: Certificate
    peak: Certificate
    vertices: Certificate
    cells: Certificate
    online: Certificate
    proof: Proof | None
    cascade_proof: tuple[Proof, ...] | None
    critical_published: float
    critical_semidefinite: float
    tube: Tube | None
    premises: tuple[Premise, ...] = ()
    tightest: Proofs = ()
    kinds: tuple[str, ...] = NOMINAL_KINDS
    attainable: float | None = None
    implemented: ImplementedCertificate = missing_implemented(NO_IMPLEMENTATION)
    implemented_proof: tuple[ImplementedProof, ...] = ()
    sampled: SampledAdaptiveCertificate = missing_sampled(NO_IMPLEMENTATION)
    sampled_proof: SampledAdaptiveProof | None = None
    constants: tuple[ConstantCost, ...] = ()
    critical_ranges: RangeStrength | None = None
    region: KeptRegion | None = None
    starts_box: float | None = None

    def __repr__(self) -> str:
        entries = [getattr(self, entry.name) for entry in fields(self)]
        shown = [
            f"{entry.kind} {rounded_up(entry.bound, 4)}" + (" (verified)" if entry.verified else "")
            for entry in entries
            if isinstance(entry, Certificate) and entry.exists
        ]
        starts = "" if self.starts_box is None else " from x0"
        return f"Certificates(limsup |e_1| <= {', '.join(shown) or 'no bound'}{starts})"

    @property
    def best(self) -> Certificate:
        """The certificate to ship with: the implemented loop's, else the tightest verified one."""
        if self.implemented.verified:
            return self.implemented
        if self.sampled.verified and self.sampled.from_file:
            return self.sampled
        entries = (getattr(self, f.name) for f in fields(self) if f.name != SAMPLED_KIND)
        best = smallest(entry for entry in entries if isinstance(entry, Certificate))
        return self.semidefinite if best is None else best

    @property
    def reason(self) -> str:
        """Why no certificate of this loop gives a bound; empty where one does."""
        if self.best.exists:
            return ""
        return self.vertices.reason if self.kinds == RANGE_KINDS else self.semidefinite.reason

    @property
    def contradicted(self) -> tuple[Premise, ...]:
        """Premises that the system's own truth breaks."""
        return contradicted(self.premises)

    @property
    def verified(self) -> bool:
        """Whether the best bound is proven and no premise is contradicted."""
        return self.best.verified and not self.contradicted

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Proof of the best: of the implemented loop; else of the tightest that a file holds.

        Before it the region that the states keep, if a premise holds there only. Empty where there
        is no proof, and where a premise is contradicted.
        """
        if self.contradicted:
            return ()
        if self.best is self.sampled and self.sampled_proof is not None:
            return (self.sampled_proof,)
        if self.implemented_proof or not self.tightest:
            return self.implemented_proof
        return self.tightest if self.region is None else (self.region, *self.tightest)

    @property
    def tube_kind(self) -> str:
        """The certificate whose bound the tube falls to."""
        if self.kinds == RANGE_KINDS:
            return "vertices"
        return min(QUADRATIC_KINDS, key=lambda kind: getattr(self, kind).bound)

    @property
    def quadratic(self) -> tuple[Proof, ...]:
        """The tighter of the proofs by quadratic functions, from which a tube follows.

        One stage, or the two or three of the cascade. Empty as :attr:`stages` is, and where
        constants have ranges.
        """
        if self.contradicted:
            return ()
        if self.cascade_proof is not None and self.cascade.bound < self.semidefinite.bound:
            return self.cascade_proof
        return () if self.proof is None else (self.proof,)


@one_blas_thread
def certify(
    system: System,
    effort: str = "default",
    progress: Progress = silent,
    *,
    warm: BoundEstimate | None = None,
) -> Certificates:
    """Certify `system` by every method.

    Published, corrected, rate, semidefinite, cascade and peak speak of the nominal loop; where
    constants have ranges, vertices, peak and cells cover them. Implemented speaks of the loop as
    the drive runs it, if the file has ``[implementation]``.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        How long it may take: ``fast`` cuts no ranges of constants into cells and leaves out peak
        gains of large orders, ``high`` cuts them into four times as many as the default and goes
        on with polynomials behind the quadratic functions of the bootstrap.
    progress : callable
        Gets the number of the step that begins, their number and, for ranges, the bound so far.
    warm : BoundEstimate, optional
        Of :func:`certrack.estimate`, for this system or one nearby: a search for a decay rate
        begins at its rate. What is proven is proven as without.

    Returns
    -------
    Certificates
        A method that gives no certificate says why.

    Raises
    ------
    InputError
        If a bound of the reference can neither be proven nor is declared, or the effort is
        unknown.

    Examples
    --------
    >>> import certrack
    >>> found = certrack.certify(certrack.load("dual-motor-lean"))
    >>> found.verified, {premise.status for premise in found.premises}
    (True, {'proven'})
    """
    require_system(system)
    checks.choice("effort", effort, EFFORTS)
    methods = every_certificate(
        system,
        effort,
        lambda step, _, best: progress(step, STEPS, best),
        details=effort != "fast",
        near=None if warm is None or math.isnan(warm.alpha) else warm.alpha,
    )
    progress(METHOD_STEPS, STEPS, None)
    stages = methods.stages
    implemented, implemented_proof = _implemented(
        system,
        margins=effort != "fast",
        effort=effort,
        progress=lambda _, __, best: progress(METHOD_STEPS, STEPS, best),
    )
    later = system.long_run
    adaptive, adaptive_proof = _sampled(system, methods, effort, progress)
    as_run = system if is_of_starts(system) else later
    rests_on = everywhere = premises(as_run if implemented.verified else later)
    region = None
    if implemented.verified:
        rests_on = premises_as_implemented(as_run, implemented_proof)
        if is_only_in_region(rests_on):
            implemented, implemented_proof = from_x0_only(implemented, implemented_proof)
    else:
        region = kept_region(system, _in_all_errors(methods))  # counts a soft start
        rests_on = everywhere = premises_from_x0(later, region)
    if region is not None and adaptive_proof is not None:
        reason = "a premise holds in a region only, which this proof does not know"
        adaptive, adaptive_proof = missing_sampled(reason), None
    if adaptive_proof is not None and adaptive.from_file:
        rests_on = premises_of_sampled_adaptive(system, adaptive_proof)
    result = Certificates(
        **methods.certificates,
        proof=next(iter(methods.stages_of("semidefinite")), None),
        cascade_proof=methods.stages_of("cascade") or None,
        critical_published=critical_strength(later),
        critical_semidefinite=critical_semidefinite(later, methods.certificates["semidefinite"]),
        tube=None
        if contradicted(everywhere)
        else _tube(system, stages, methods.ranges.vertex_proof),
        premises=rests_on,
        tightest=methods.tightest,
        kinds=methods.kinds,
        attainable=methods.attainable,
        implemented=implemented,
        implemented_proof=implemented_proof,
        sampled=adaptive,
        sampled_proof=adaptive_proof,
        constants=methods.ranges.constants,
        critical_ranges=methods.ranges.strength,
        region=region,
        starts_box=None if region is None else largest_box(later, region),
    )
    progress(STEPS, STEPS, None)
    broken = contradicted(everywhere)
    if broken and not result.contradicted:  # where the implemented loop stays it is not broken
        others = replace(result, proof=None, cascade_proof=None, tightest=())
        return replace(_unverified(others, broken[0]), implemented=implemented)
    return _unverified(result, broken[0]) if result.contradicted else result


def _in_all_errors(methods: Methods) -> tuple[Proof, ...]:
    """Stages whose quadratic function is of all errors: of e_1, and the first of a cascade."""
    return (*methods.stages_of("semidefinite")[:1], *methods.stages_of("cascade")[:1])


def _implemented(
    system: System, margins: bool, effort: str, progress: Progress
) -> tuple[ImplementedCertificate, tuple[ImplementedProof, ...]]:
    """That of the loop as it runs; without limits of the input a soft start counts from x0 only."""
    how: Any = {"margins": margins, "effort": effort, "progress": progress}
    if system.long_run is system or is_of_starts(system):
        return certify_implemented(system, from_start=True, **how)
    early, _ = certify_implemented(system, from_start=True, effort=effort, progress=progress)
    later, later_proofs = certify_implemented(system.long_run, **how)
    return replace(later, start=early.start, peaks=early.peaks), later_proofs


def _sampled(
    system: System, methods: Methods, effort: str, progress: Progress
) -> tuple[SampledAdaptiveCertificate, SampledAdaptiveProof | None]:
    """That of the adaptive law as implemented; the bootstrap's first proof is its own, too."""
    if system.implementation is None:
        return missing_sampled(NO_IMPLEMENTATION), None
    return certify_sampled_adaptive(
        system,
        effort,
        methods.bootstrap_start,
        lambda _, __, best: progress(METHOD_STEPS, STEPS, best),
    )


def _tube(
    system: System,
    stages: tuple[Proof, ...] | tuple[OnlineProof, ...],
    vertex_proof: CellProof | None,
) -> Tube | None:
    """The tube of the nominal loop's certificate, or of one quadratic function for all ranges.

    A soft start is part of what happens from a start, so there it is of a certificate that counts
    it, too.
    """
    if system.long_run is not system:
        if system.law.online is not None:
            _, moving = certify_online(system)
            return online_tube(system, moving[0]) if moving else None
        proof = None if has_ranges(system) else certify_semidefinite(system)[1]
        return None if proof is None else tube(system, proof)
    if vertex_proof is not None:
        return range_tube(system, vertex_proof)
    return tube_of(system, stages) if stages else None


def _unverified(result: Certificates, broken: Premise) -> Certificates:
    """Without a word of verification: the bounds are of another plant than the file's."""
    reason = f"a premise is contradicted: {broken.detail}"
    kinds = [f.name for f in fields(result) if isinstance(getattr(result, f.name), Certificate)]
    changed = {
        kind: replace(c, verified=False, reason=c.reason or reason)
        for kind in kinds
        for c in [getattr(result, kind)]
    }
    constants = tuple(replace(entry, verified=False) for entry in result.constants)
    return replace(result, **changed, constants=constants)
