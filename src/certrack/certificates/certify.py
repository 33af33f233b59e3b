"""All certificates of a system, side by side."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from certrack.certificates.arithmetic import rational
from certrack.certificates.cascade import certify_cascade
from certrack.certificates.certificate import (
    Certificate,
    NoCertificate,
    missing,
    within_floats,
)
from certrack.certificates.exact import Proof, prove, proven
from certrack.certificates.formulation import error_problem
from certrack.certificates.implemented.certify import (
    ImplementedCertificate,
    certify_implemented,
    missing_implemented,
)
from certrack.certificates.implemented.drive import NO_IMPLEMENTATION
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.own_multipliers import own_solution
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises import has_ranges
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.published import certify_published, critical_strength
from certrack.certificates.ranges.certify import certify_ranges, without_ranges
from certrack.certificates.ranges.proofs import CellProof
from certrack.certificates.semidefinite import SemidefiniteProgram, Solution, best_solution
from certrack.certificates.strength import critical_semidefinite
from certrack.certificates.tube import Tube, tube
from certrack.core import checks
from certrack.core.notebook import ShownInNotebooks
from certrack.core.progress import Progress, silent
from certrack.core.rounding import rounded_up
from certrack.systems.system import System, require_system

#: How long `certify` may take: the closed forms, the semidefinite program and the cascade are in
#: all of them.
EFFORTS = ("fast", "default", "high")

#: Steps of which `certify` reports: closed forms, semidefinite, cascade, ranges, and the rest.
STEPS = 5


@dataclass(frozen=True)
class Certificates(ShownInNotebooks):
    """Result of :func:`certify`.

    Attributes
    ----------
    published, corrected, rate, semidefinite, cascade : Certificate
        Of the nominal loop; none where constants have ranges.
    vertices, peak, cells : Certificate
        For all constants in their ranges: one quadratic function, peak gains, cells.
    proof, cascade_proof
        The exactly verified numbers behind the semidefinite bound and the cascade.
    cover : cells with their proofs
        Behind the best of vertices, peak and cells.
    attainable : float or None
        What the linear loop reaches at the worst corner of the ranges; no proof.
    implemented : ImplementedCertificate
        Of the loop as the drive runs it: sampled, delayed, quantised; none without
        ``[implementation]``.
    implemented_proof
        The exactly verified numbers behind it, one for each delay.
    critical_published, critical_semidefinite : float
        Largest common scale of tau with a certificate; the second is verified exactly.
    tube : Tube or None
        Bound on |e_1(t)| from the system's own start, of the tightest verified certificate of the
        nominal loop; None where constants have ranges or nothing is verified.
    premises : tuple of Premise
        What the best of it rests on, and whether the system's own truth keeps it. Where it breaks
        one, nothing is verified and there is no tube: bounds are those of the design that the truth
        leaves.
    """

    published: Certificate
    corrected: Certificate
    rate: Certificate
    semidefinite: Certificate
    cascade: Certificate
    vertices: Certificate
    peak: Certificate
    cells: Certificate
    proof: Proof | None
    cascade_proof: tuple[Proof, ...] | None
    critical_published: float
    critical_semidefinite: float
    tube: Tube | None
    premises: tuple[Premise, ...] = ()
    cover: tuple[CellProof, ...] = ()
    attainable: float | None = None
    implemented: ImplementedCertificate = missing_implemented(NO_IMPLEMENTATION)
    implemented_proof: tuple[ImplementedProof, ...] = ()

    def __repr__(self) -> str:
        entries = [getattr(self, entry.name) for entry in fields(self)]
        shown = [
            f"{entry.kind} {rounded_up(entry.bound, 4)}" + (" (verified)" if entry.verified else "")
            for entry in entries
            if isinstance(entry, Certificate) and entry.exists
        ]
        return f"Certificates(limsup |e_1| <= {', '.join(shown) or 'no bound'})"

    @property
    def best(self) -> Certificate:
        """The certificate to ship with: the implemented loop's, else the tightest verified one."""
        if self.implemented.verified:
            return self.implemented
        nominal = (self.semidefinite, self.cascade, self.rate, self.corrected)
        sound = (*nominal, self.cells, self.vertices, self.peak)
        verified = [c for c in sound if c.verified]
        return min(verified, key=lambda c: c.bound) if verified else self.semidefinite

    @property
    def contradicted(self) -> tuple[Premise, ...]:
        """Premises that the system's own truth breaks."""
        return contradicted(self.premises)

    @property
    def verified(self) -> bool:
        """Whether the best bound is proven and no premise is contradicted."""
        return self.best.verified and not self.contradicted

    @property
    def stages(self) -> tuple[Proof, ...] | tuple[CellProof, ...] | tuple[ImplementedProof, ...]:
        """Proof of the best bound: implemented, one stage, a cascade's two or three, or cells.

        Empty where there is none, and where a premise is contradicted.
        """
        if self.contradicted:
            return ()
        return (
            self.implemented_proof
            or self.cover
            or tightest(self.semidefinite, self.proof, self.cascade, self.cascade_proof)
        )


def certify(system: System, effort: str = "default", progress: Progress = silent) -> Certificates:
    """Certify `system` by every method.

    Published, corrected, rate, semidefinite and cascade speak of the nominal loop; where constants
    have ranges, vertices, peak and cells cover them. Implemented speaks of the loop as the drive
    runs it, if the file has ``[implementation]``.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        How long it may take: ``fast`` cuts no ranges of constants into cells, ``high`` cuts them
        into four times as many as the default.
    progress : callable
        Gets the number of the step that begins, their number and, for ranges, the bound so far.

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
    progress(0, STEPS, None)
    classical = certify_published(system)
    progress(1, STEPS, None)
    semidefinite, proof = certify_semidefinite(system)
    progress(2, STEPS, None)
    cascade, cascade_proof = certify_cascade(system)
    stages = tightest(semidefinite, proof, cascade, cascade_proof)
    progress(3, STEPS, None)
    ranges = (
        certify_ranges(system, effort, lambda _, __, best: progress(3, STEPS, best))
        if has_ranges(system)
        else without_ranges()
    )
    progress(4, STEPS, None)
    implemented, implemented_proof = certify_implemented(system, from_start=True)
    rests_on = premises_as_implemented(system) if implemented.verified else premises(system)
    result = Certificates(
        **classical,
        semidefinite=semidefinite,
        cascade=cascade,
        vertices=ranges.vertices,
        peak=ranges.peak,
        cells=ranges.cells,
        proof=proof,
        cascade_proof=cascade_proof,
        critical_published=critical_strength(system),
        critical_semidefinite=critical_semidefinite(system, semidefinite),
        tube=tube(system, stages) if stages and not contradicted(rests_on) else None,
        premises=rests_on,
        cover=ranges.proof,
        attainable=ranges.attainable,
        implemented=implemented,
        implemented_proof=implemented_proof,
    )
    progress(STEPS, STEPS, None)
    return _unverified(result) if result.contradicted else result


def _unverified(result: Certificates) -> Certificates:
    """Without a word of verification: the bounds are of another plant than the file's."""
    reason = f"a premise is contradicted: {result.contradicted[0].detail}"
    kinds = [f.name for f in fields(result) if isinstance(getattr(result, f.name), Certificate)]
    changed = {
        kind: replace(c, verified=False, reason=c.reason or reason)
        for kind in kinds
        for c in [getattr(result, kind)]
    }
    return replace(result, **changed)


def tightest(
    semidefinite: Certificate,
    proof: Proof | None,
    cascade: Certificate,
    cascade_proof: tuple[Proof, ...] | None,
) -> tuple[Proof, ...]:
    """Proof of the tightest verified bound: one stage, or the two or three of the cascade."""
    if cascade_proof is not None and cascade.bound < semidefinite.bound:
        return cascade_proof
    return () if proof is None else (proof,)


def best_sound_bound(system: System) -> float:
    """The tightest sound bound on limsup |e_1|; inf if there is none.

    Parameters
    ----------
    system : System

    Returns
    -------
    float

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> certrack.certificates.best_sound_bound(system) == found.best.bound
    True
    """
    if has_ranges(system):
        return certify_ranges(system).best.bound
    classical = certify_published(system)
    semidefinite, _ = certify_semidefinite(system)
    cascade, _ = certify_cascade(system)
    return min(classical["rate"].bound, semidefinite.bound, cascade.bound)


def certify_semidefinite(system: System) -> tuple[Certificate, Proof | None]:
    """The tight certificate of `system`, verified exactly, and the numbers that prove it.

    Parameters
    ----------
    system : System

    Returns
    -------
    certificate : Certificate
    proof : Proof or None
        None where there is no certificate.

    Examples
    --------
    >>> import certrack
    >>> found, proof = certrack.certificates.certify_semidefinite(certrack.load("dual-motor-lean"))
    >>> found.verified
    True
    """
    try:
        with within_floats():
            exact = error_problem(system, rational)
            program = SemidefiniteProgram(exact.in_floats())
            solution = best_solution(program)
            proof = None if solution is None else prove(exact, solution)
            if proof is None:
                damped = own_solution(system, exact)
                proof = None if damped is None else prove(exact, damped)
            if proof is None:
                raise NoCertificate(_why_none(program, solution))
    except NoCertificate as problem:
        return missing("semidefinite", str(problem)), None
    return proven("semidefinite", system, proof), proof


#: The leakage is said to be too slow below this part of the slowest pole.
SLOWEST_LEAKAGE = 1e-9


def _why_none(program: SemidefiniteProgram, solution: Solution | None) -> str:
    """Why there is no proof, and the remedy."""
    if program.fastest < SLOWEST_LEAKAGE * program.slowest_pole:
        return (
            "the estimates forget too slowly for a bound to be found: raise gain_rate leak_gain, "
            "or the smallest eigenvalue of Gamma, which may be nearly singular, times leak_theta"
        )
    if solution is None:
        return (
            "no certificate found: the uncertainty is too strong for this design; "
            "lower tau, raise c, or use fewer damping terms"
        )
    return (
        "the solver's certificate did not survive exact verification; rescale the states or use "
        "fewer damping terms"
    )
