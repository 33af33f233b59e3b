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
from certrack.certificates.own_multipliers import own_solution
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.published import certify_published, critical_strength
from certrack.certificates.semidefinite import SemidefiniteProgram, Solution, best_solution
from certrack.certificates.strength import critical_semidefinite
from certrack.certificates.tube import Tube, tube
from certrack.core import checks
from certrack.core.notebook import ShownInNotebooks
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: How long `certify` may take: the closed forms, the semidefinite program and the cascade are in
#: all of them.
EFFORTS = ("fast", "default", "high")


@dataclass(frozen=True)
class Certificates(ShownInNotebooks):
    """Result of :func:`certify`.

    Attributes
    ----------
    published, corrected, rate, semidefinite, cascade : Certificate
    proof, cascade_proof
        The exactly verified numbers behind the semidefinite bound and the cascade.
    critical_published, critical_semidefinite : float
        Largest common scale of tau with a certificate; the second is verified exactly.
    tube : Tube or None
        Bound on |e_1(t)| from the system's own start, of the tightest verified certificate.
    premises : tuple of Premise
        What all of it rests on, and whether the system's own truth keeps it. Where it breaks one,
        nothing is verified and there is no tube: bounds are those of the design that the truth
        leaves.
    """

    published: Certificate
    corrected: Certificate
    rate: Certificate
    semidefinite: Certificate
    cascade: Certificate
    proof: Proof | None
    cascade_proof: tuple[Proof, ...] | None
    critical_published: float
    critical_semidefinite: float
    tube: Tube | None
    premises: tuple[Premise, ...] = ()

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
        """The tightest certificate among the verified ones."""
        sound = (self.semidefinite, self.cascade, self.rate, self.corrected)
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
    def stages(self) -> tuple[Proof, ...]:
        """Proof of the tightest verified bound: one stage, or the two or three of the cascade.

        Empty where there is none, and where a premise is contradicted.
        """
        if self.contradicted:
            return ()
        return tightest(self.semidefinite, self.proof, self.cascade, self.cascade_proof)


def certify(system: System, effort: str = "default") -> Certificates:
    """Certify `system` by every method: published, corrected, rate, semidefinite and cascade.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        How long it may take. Today the three find the same: closed forms, semidefinite program and
        cascade; slower methods will join the second and the third.

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
    checks.choice("effort", effort, EFFORTS)
    classical = certify_published(system)
    semidefinite, proof = certify_semidefinite(system)
    cascade, cascade_proof = certify_cascade(system)
    stages = tightest(semidefinite, proof, cascade, cascade_proof)
    rests_on = premises(system)
    result = Certificates(
        **classical,
        semidefinite=semidefinite,
        cascade=cascade,
        proof=proof,
        cascade_proof=cascade_proof,
        critical_published=critical_strength(system),
        critical_semidefinite=critical_semidefinite(system, semidefinite),
        tube=tube(system, stages) if stages and not contradicted(rests_on) else None,
        premises=rests_on,
    )
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
