"""The certificate of the bootstrap."""

from __future__ import annotations

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.bootstrap.check import bounds_error, claimed_bound
from certrack.certificates.bootstrap.search import bootstrap
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.certificate import (
    Certificate,
    NoCertificate,
    missing,
    within_floats,
)
from certrack.certificates.exact import Proof, float_up, from_text, prove
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.semidefinite import SemidefiniteProgram, best_solution
from certrack.core.progress import Progress, silent
from certrack.systems.system import System

#: A proof of e_n by a function that the update laws cancel, and the stages on what it reaches.
BootstrapProof = tuple[Proof | BootstrapStage, ...]


def certify_bootstrap(
    system: System,
    effort: str = "default",
    first: Proof | None = None,
    progress: Progress = silent,
) -> tuple[Certificate, BootstrapProof]:
    """The bootstrap of `system`, and its stages.

    Parameters
    ----------
    system : System
    effort : {"fast", "default", "high"}
        ``fast`` leaves it out, ``default`` what takes longer than about five seconds, ``high``
        goes on with polynomials.
    first : Proof, optional
        A proven bound on e_n, such as the first stage of the cascade; it is sought if left out.
    progress : callable
        Gets the bound so far, as its last argument.

    Returns
    -------
    certificate : Certificate
    proof : the first proof and the stages, or nothing
    """
    try:
        with within_floats():
            exact = error_problem(system, rational)
            if exact.adaptation is None:
                raise NoCertificate("the bootstrap is for the adaptive law")
            if effort == "fast":
                raise NoCertificate("takes more time: --effort default")
            first = first or first_proof(exact)
            stages = bootstrap(system, exact, first, effort, progress)
            if not bounds_error(stages):
                raise NoCertificate(_why_no_smaller(exact.n))
            bound = float_up(from_text(claimed_bound(stages)))
    except NoCertificate as refusal:
        return missing("bootstrap", str(refusal)), ()
    rests_on = tuple(assumptions(system))
    certificate = Certificate("bootstrap", bound, verified=True, assumptions=rests_on)
    return certificate, (first, *stages)


def _why_no_smaller(n: int) -> str:
    """What to do where the stages say nothing new of e_1."""
    if n == 1:  # the first proof is of e_1
        return "no tighter here than semidefinite, which bounds e_1 already: take that one"
    return (
        "its stages do not bound e_1 on both sides: take another certificate, or lower tau, "
        "raise c or the leaks, narrow the ranges"
    )


def first_proof(exact: ErrorProblem) -> Proof:
    """A proven bound on e_n, to begin with.

    Raises
    ------
    NoCertificate
        If there is none.
    """
    target = exact.n - 1
    solution = best_solution(SemidefiniteProgram(exact.in_floats(), target))
    proof = None if solution is None else prove(exact, solution, target)
    if proof is None:
        raise NoCertificate("no bound on e_n to begin with; lower tau, or raise c")
    return proof
