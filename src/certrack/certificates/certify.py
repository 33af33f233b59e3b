"""All certificates of a system, side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass

import flint

from certrack.certificates.arithmetic import rational
from certrack.certificates.cascade import certify_cascade
from certrack.certificates.certificate import Certificate, NoCertificate, missing, within_floats
from certrack.certificates.exact import Proof, prove, proven
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.published import certify_published, critical_strength
from certrack.certificates.semidefinite import SemidefiniteProgram, best_solution
from certrack.certificates.tube import Tube, tube
from certrack.systems.system import System

#: Critical strengths beyond this are reported as infinite, below its inverse as zero.
MAX_STRENGTH = 1e9

#: Whether any certificate exists is asked at this part of the fastest alpha: a smaller alpha asks
#: less of the loop, and the solver copes with three decades.
SLOW_RATE = 1e-3


@dataclass(frozen=True)
class Certificates:
    """Result of :func:`certify`.

    Attributes
    ----------
    published, corrected, rate, semidefinite, cascade : Certificate
    proof, cascade_proof
        The exactly verified numbers behind the semidefinite bound and the cascade.
    critical_published, critical_semidefinite : float
        Largest common scale of tau with a certificate; the second is verified exactly.
    tube : Tube or None
        Bound on |e_1(t)| from the system's own start.
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

    @property
    def best(self) -> Certificate:
        """The tightest sound certificate."""
        sound = (self.semidefinite, self.cascade, self.rate, self.corrected)
        return min(sound, key=lambda c: c.bound)

    @property
    def stages(self) -> tuple[Proof, ...]:
        """Proof of the tightest verified bound: one stage, or the two or three of the cascade."""
        if self.cascade_proof is not None and self.cascade.bound < self.semidefinite.bound:
            return self.cascade_proof
        return () if self.proof is None else (self.proof,)


def certify(system: System) -> Certificates:
    """Certify `system` by every method: published, corrected, rate, semidefinite and cascade.

    Parameters
    ----------
    system : System

    Returns
    -------
    Certificates
        A method that gives no certificate says why.

    Raises
    ------
    InputError
        If a bound of the reference can neither be proven nor is declared.
    """
    classical = certify_published(system)
    semidefinite, proof = certify_semidefinite(system)
    cascade, cascade_proof = certify_cascade(system)
    return Certificates(
        **classical,
        semidefinite=semidefinite,
        cascade=cascade,
        proof=proof,
        cascade_proof=cascade_proof,
        critical_published=critical_strength(system),
        critical_semidefinite=critical_semidefinite(system, semidefinite),
        tube=None if proof is None else tube(system, proof),
    )


def best_sound_bound(system: System) -> float:
    """The tightest sound bound on limsup |e_1|; inf if there is none."""
    classical = certify_published(system)
    semidefinite, _ = certify_semidefinite(system)
    cascade, _ = certify_cascade(system)
    return min(classical["rate"].bound, semidefinite.bound, cascade.bound)


def certify_semidefinite(system: System) -> tuple[Certificate, Proof | None]:
    """The tight certificate of `system`, verified exactly, and the numbers that prove it."""
    try:
        with within_floats():
            exact = error_problem(system, rational)
            solution = best_solution(SemidefiniteProgram(exact.in_floats()))
            if solution is None:
                raise NoCertificate(
                    "no certificate found: the uncertainty is too strong for this design; "
                    "lower tau, raise c, or use fewer damping terms"
                )
            proof = prove(exact, solution)
            if proof is None:
                raise NoCertificate(
                    "the solver's certificate did not survive exact verification; rescale the "
                    "states or use fewer damping terms"
                )
    except NoCertificate as problem:
        return missing("semidefinite", str(problem)), None
    return proven("semidefinite", system, proof), proof


def critical_semidefinite(
    system: System, certified: Certificate | None = None, accuracy: float = 1e-3
) -> float:
    """Largest common scale of tau for which a certificate exists, verified exactly.

    Parameters
    ----------
    certified : Certificate, optional
        The verified bound at scale 1, where it exists: it holds at every smaller scale, too, and
        its rate tells how slow the leakage lets V fall.
    accuracy : float
        Relative width of the bisection; the value returned is proven feasible.
    """
    try:
        exact = error_problem(system, rational)
    except NoCertificate:
        return 0.0
    holds = certified is not None and certified.verified
    slow = certified.alpha / 2 if holds and certified is not None else math.inf
    if not holds and not _provable(exact, 0.0, slow):
        return 0.0
    if not exact.counts[0]:
        return math.inf
    low, high = (1.0, 4.0) if holds else (0.0, 1.0)
    while _provable(exact, high, slow):
        low, high = high, 4 * high
        if high > MAX_STRENGTH:
            return math.inf
    while high - low > accuracy * high and high > 1 / MAX_STRENGTH:
        middle = (low + high) / 2 if low else high / 4
        if _provable(exact, middle, slow):
            low = middle
        else:
            high = middle
    return low


def _provable(exact: ErrorProblem, strength: float, slow: float) -> bool:
    """Whether the problem with scaled tau has an exactly verified certificate."""
    scaled = exact.homogeneous(flint.fmpq(*float(strength).as_integer_ratio()))
    try:
        with within_floats():
            program = SemidefiniteProgram(scaled.in_floats())
            if not program.fastest > 0:
                return False
            solution = program.solve(min(SLOW_RATE * program.fastest, slow))
            return solution is not None and prove(scaled, solution) is not None
    except NoCertificate:
        return False
