"""The certificate of gains that move, its proof, and the check of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import Certificate, NoCertificate, missing, within_floats
from certrack.certificates.exact import Proof, failed_condition, from_text, proven
from certrack.certificates.online.ends import end_problems
from certrack.certificates.online.rates import RateProgram, prove_rates, squared_rate_bound
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.ranges.vertices import VertexProgram, prove_vertices
from certrack.certificates.search.best_proof import best_proof
from certrack.certificates.semidefinite import best_solution
from certrack.systems.system import System

#: The name of the method.
ONLINE = "online"


@dataclass(frozen=True)
class OnlineProof:
    """Proof for gains that move.

    Attributes
    ----------
    bound : str
        Decimal.
    ends : stages
        One with estimates; else one for each end, which share alpha and the bound, and P where the
        gains may move at any speed.
    """

    bound: str
    ends: tuple[Proof, ...]


def certify_online(system: System) -> tuple[Certificate, tuple[OnlineProof, ...]]:
    """The certificate of `system` for every motion of its gains, and its proof.

    Parameters
    ----------
    system : System

    Returns
    -------
    certificate : Certificate
    proof : one, or none
    """
    try:
        with within_floats():
            problems = end_problems(system)
            stages = _proven_stages(system, problems)
            if stages is None:
                raise NoCertificate(
                    "no certificate found for all gains between the ends: bring them nearer to "
                    "each other, or state law.online.rate"
                )
    except NoCertificate as refusal:
        return missing(ONLINE, str(refusal)), ()
    return proven(ONLINE, system, stages[0]), (OnlineProof(stages[0].bound, stages),)


def _proven_stages(system: System, problems: tuple[ErrorProblem, ...]) -> tuple[Proof, ...] | None:
    if len(problems) == 1:
        proof = best_proof(problems[0]).proof
        return None if proof is None else (proof,)
    floats, rate = [problem.in_floats() for problem in problems], _rate(system)
    if rate is None:
        solution = best_solution(VertexProgram(floats))
        return None if solution is None else prove_vertices(problems, solution)
    moving = best_solution(RateProgram(floats, float(rate)))
    return None if moving is None else prove_rates(problems, moving, rate)


def failed_online(system: System, proof: OnlineProof) -> str:
    """Empty if the proof holds, else what fails."""
    problems = end_problems(system)
    if len(proof.ends) != len(problems):
        return "there is not one stage for each end of the gains, or one with estimates"
    first = proof.ends[0]
    if any((end.alpha, end.bound) != (first.alpha, proof.bound) for end in proof.ends):
        return "the ends do not share alpha and the bound"
    rate = _rate(system)
    if len(problems) == 2 and rate is not None:
        square = squared_rate_bound(problems, proof.ends, rate)
        if square is None:
            return "the matrix inequalities of gains with a bounded speed do not hold"
        bound = from_text(proof.bound)
        holds = bound >= 0 and bound * bound >= square
        return "" if holds else "the bound is smaller than what the inequalities give"
    for problem, stage in zip(problems, proof.ends, strict=True):
        if stage.P != first.P:
            return "the ends do not share P, although the gains may move at any speed"
        if reason := failed_condition(problem, stage):
            return reason
    return ""


def _rate(system: System) -> Any:
    """The largest |w'| of the admitted set as an exact rational; None for any speed."""
    assert system.law.online is not None
    rate = system.law.online.rate
    return None if rate is None else rational(rate)
