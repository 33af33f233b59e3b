"""Every method, listed once: for `certify`, for the falsifier, for the limit of an ensemble."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.bootstrap.certify import BootstrapProof, certify_bootstrap
from certrack.certificates.cascade import certify_cascade
from certrack.certificates.certificate import (
    Certificate,
    NoCertificate,
    missing,
    within_floats,
)
from certrack.certificates.exact import Proof, float_up, from_text, prove, proven
from certrack.certificates.formulation import error_problem
from certrack.certificates.online.certify import ONLINE, OnlineProof, certify_online
from certrack.certificates.own_multipliers import own_solution
from certrack.certificates.published import certify_published
from certrack.certificates.ranges.certify import (
    RangeCertificates,
    certify_ranges,
    without_ranges,
)
from certrack.certificates.ranges.proofs import CellProof, RangeProver
from certrack.certificates.scope import has_ranges
from certrack.certificates.search.best_proof import ProofSearch, best_proof
from certrack.core.progress import Progress, silent
from certrack.systems.system import System

#: Name of the certificate by iterated quadratic functions on a box.
BOOTSTRAP = "bootstrap"

#: Those of a nominal loop, and those that cover ranges of constants, as they are shown.
NOMINAL_KINDS = ("published", "corrected", "rate", "semidefinite", "cascade", BOOTSTRAP, "peak")
RANGE_KINDS = ("vertices", "peak", "cells")

#: Those of a law whose gains move.
MOVING_KINDS = (*NOMINAL_KINDS, ONLINE)

#: Of which a tube follows: inequalities for V, which hold for every t.
QUADRATIC_KINDS = ("semidefinite", "cascade", ONLINE)

#: Steps of which :func:`every_certificate` reports, as a progress names them.
METHOD_NAMES = (
    "closed forms",
    "semidefinite program",
    "cascade",
    "bootstrap",
    "peak gains, ranges of constants",
)
METHOD_STEPS = len(METHOD_NAMES)

#: Orders up to which peak gains take less than about a second.
FAST_PEAK_ORDER = 25

#: Stages, cells, or that of moving gains; empty where there is none, or none that a file holds.
Proofs = tuple[Proof, ...] | tuple[CellProof, ...] | tuple[OnlineProof, ...] | BootstrapProof


@dataclass(frozen=True)
class Methods:
    """What every method found.

    Attributes
    ----------
    certificates : mapping
        By kind; each method has one, if only to say why there is none.
    proofs : mapping
        By kind.
    kinds : tuple of str
        Those that speak of this loop.
    attainable : float or None
        What the linear loop reaches at the worst corner of the ranges; no proof.
    ranges : RangeCertificates
        All that was asked of the ranges.
    """

    certificates: Mapping[str, Certificate]
    proofs: Mapping[str, Proofs]
    kinds: tuple[str, ...]
    attainable: float | None
    ranges: RangeCertificates

    @property
    def best(self) -> Certificate | None:
        """The smallest bound that exact arithmetic has confirmed."""
        return smallest(self.certificates[kind] for kind in self.kinds)

    @property
    def bootstrap_start(self) -> Proof | None:
        """The proof that the bootstrap begins with; None where there is none."""
        first = next(iter(self.proofs.get("bootstrap", ())), None)
        return first if isinstance(first, Proof) else None

    @property
    def tightest(self) -> Proofs:
        """Proof of the smallest bound of those that a file holds."""
        return self._tightest(self.kinds)

    @property
    def stages(self) -> tuple[Proof, ...] | tuple[OnlineProof, ...]:
        """The same of those from which a tube follows: one to three stages, or of moving gains."""
        moving = self.proofs.get(ONLINE, ())
        return tuple(p for p in moving if isinstance(p, OnlineProof)) or _quadratic(
            self._tightest(QUADRATIC_KINDS)
        )

    def stages_of(self, kind: str) -> tuple[Proof, ...]:
        """The stages behind one of :data:`QUADRATIC_KINDS`."""
        return _quadratic(self.proofs[kind])

    def _tightest(self, kinds: Iterable[str]) -> Proofs:
        saved = (kind for kind in kinds if self.proofs.get(kind))
        best = min(saved, key=lambda kind: self.certificates[kind].bound, default="")
        return self.proofs.get(best, ())


def _quadratic(proofs: Proofs) -> tuple[Proof, ...]:
    return tuple(stage for stage in proofs if isinstance(stage, Proof))


def smallest(certificates: Iterable[Certificate]) -> Certificate | None:
    """The smallest verified bound; None if there is none."""
    verified = (entry for entry in certificates if entry.verified)
    return min(verified, key=lambda entry: entry.bound, default=None)


def every_certificate(
    system: System,
    effort: str = "default",
    progress: Progress = silent,
    *,
    details: bool = False,
    near: float | None = None,
) -> Methods:
    """Certify `system` by every method, for the long run of its reference.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
    progress : callable
        Gets the number of the method that begins, their number and, for ranges, the bound so far.
    details : bool
        Whether it is also asked what each range costs, and how far the ranges may grow.
    near : float, optional, 1/s
        Where the search for the semidefinite one's alpha begins.

    Raises
    ------
    InputError
        If a bound of the reference can neither be proven nor is declared.
    """
    system = system.long_run
    progress(0, METHOD_STEPS, None)
    certificates = dict(certify_published(system))
    progress(1, METHOD_STEPS, None)
    certificates["semidefinite"], proof = certify_semidefinite(system, near)
    progress(2, METHOD_STEPS, None)
    certificates["cascade"], stages = certify_cascade(system)
    progress(3, METHOD_STEPS, None)
    proofs: dict[str, Proofs] = {
        "semidefinite": () if proof is None else (proof,),
        "cascade": stages or (),
    }
    first = None if stages is None else stages[0]
    certificates[BOOTSTRAP], proofs[BOOTSTRAP] = certify_bootstrap(
        system, effort, first, lambda _, __, best: progress(3, METHOD_STEPS, best)
    )
    certificates[ONLINE], proofs[ONLINE] = certify_online(system)
    progress(4, METHOD_STEPS, None)
    ranged, attainable = has_ranges(system), None
    if ranged:
        ranges = certify_ranges(
            system,
            effort,
            lambda _, __, best: progress(4, METHOD_STEPS, best),
            details=details,
        )
        proofs |= {ranges.best.kind: ranges.proof}
        attainable = ranges.attainable
    else:
        ranges = without_ranges()
    certificates |= {"vertices": ranges.vertices, "peak": ranges.peak, "cells": ranges.cells}
    if not ranged:
        certificates["peak"], proofs["peak"] = certify_peak(system, effort)
    kinds: tuple[str, ...] = RANGE_KINDS if ranged else NOMINAL_KINDS
    kinds = kinds if system.law.online is None else MOVING_KINDS
    return Methods(certificates, proofs, kinds, attainable, ranges)


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
    best = every_certificate(system).best
    return math.inf if best is None else best.bound


def certify_peak(
    system: System, effort: str = "default"
) -> tuple[Certificate, tuple[CellProof, ...]]:
    """The certificate by peak gains of a system without ranges, enclosed by balls, and its proof.

    The error loop is linear but for the uncertain terms: each |w_k| counts with the integral of
    its kernel, and where it grows with ||x|| the sizes of all states are a fixed point. The proof
    is a cell without ranges: whoever checks it computes it again.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        ``fast`` leaves out what takes longer than about a second.

    Returns
    -------
    certificate : Certificate
    proof : one cell, or nothing

    Examples
    --------
    >>> import certrack
    >>> found, proof = certrack.certificates.certify_peak(certrack.load("dual-motor-lean"))
    >>> found
    Certificate(peak: limsup |e_1| <= 0.001288, verified)
    """
    try:
        with within_floats():
            error_problem(system, rational)  # refuses what no certificate of this room covers
            prover = RangeProver(system)
            if not prover.by_peak_gains:
                raise NoCertificate(
                    "peak gains are for the robust law: estimates make the loop nonlinear"
                )
            if effort == "fast" and system.plant.n > FAST_PEAK_ORDER:
                raise NoCertificate("takes more time at this order: --effort default")
            proof = prover.peak_proof(prover.box)
    except NoCertificate as refusal:
        return missing("peak", str(refusal)), ()
    bound = float_up(from_text(proof.bound))
    rests_on = tuple(assumptions(system))
    return Certificate("peak", bound, verified=True, assumptions=rests_on), (proof,)


def certify_semidefinite(
    system: System, near: float | None = None
) -> tuple[Certificate, Proof | None]:
    """The tight certificate of `system`, verified exactly, and the numbers that prove it.

    Parameters
    ----------
    system : System
    near : float, optional, 1/s
        Where the search for alpha begins.

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
            search = best_proof(exact, near=near)
            proof = search.proof
            if proof is None:
                damped = own_solution(system, exact)
                proof = None if damped is None else prove(exact, damped)
            if proof is None:
                raise NoCertificate(_why_none(search))
    except NoCertificate as problem:
        return missing("semidefinite", str(problem)), None
    return proven("semidefinite", system, proof), proof


#: The leakage is said to be too slow below this part of the slowest pole.
SLOWEST_LEAKAGE = 1e-9


def _why_none(search: ProofSearch) -> str:
    """Why there is no proof, and the remedy."""
    program = search.program
    if program is not None and program.fastest < SLOWEST_LEAKAGE * program.slowest_pole:
        return (
            "the estimates forget too slowly for a bound to be found: raise gain_rate leak_gain, "
            "or the smallest eigenvalue of Gamma, which may be nearly singular, times leak_theta"
        )
    if search.solution is None:
        return (
            "no certificate found: the uncertainty is too strong for this design; "
            "lower tau, raise c, or use fewer damping terms"
        )
    return (
        "the solver's certificate did not survive exact verification; rescale the states or use "
        "fewer damping terms"
    )
