"""The certificate of gains that move, its proof, and the check of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import Certificate, NoCertificate, missing, within_floats
from certrack.certificates.exact import Proof, failed_condition, from_text, proven
from certrack.certificates.online.ends import end_problems
from certrack.certificates.online.rates import RateProgram, prove_rates, squared_rate_bound
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.ranges.vertices import VertexProgram, prove_vertices
from certrack.certificates.search.best_proof import best_proof
from certrack.certificates.semidefinite import Bounded, Program, best_solution
from certrack.systems.system import System

#: The name of the method.
ONLINE = "online"

#: Parts of the best alpha that are tried to be proven.
SMALLER_RATES = (1.0, 0.95, 0.85, 0.7, 0.5)


class SolvedEnds(Bounded, Protocol):
    """What a program returns, with its decay rate."""

    @property
    def alpha(self) -> float:
        """Decay rate, 1/s."""


EndsOptimum = TypeVar("EndsOptimum", bound=SolvedEnds)


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
        return _first_proven(
            VertexProgram(floats), lambda solution: prove_vertices(problems, solution)
        )
    return _first_proven(
        RateProgram(floats, float(rate)), lambda solution: prove_rates(problems, solution, rate)
    )


def _first_proven(
    program: Program[EndsOptimum], prove: Callable[[EndsOptimum], tuple[Proof, ...] | None]
) -> tuple[Proof, ...] | None:
    """The proof of the best alpha, or of a smaller one: the largest leave exact arithmetic no room.

    Ends that are far apart have solutions up to a largest alpha only, and the best is near it.
    """
    best = best_solution(program)
    for part in SMALLER_RATES if best is not None else ():
        assert best is not None
        solution = best if part == 1 else program.solve(part * best.alpha)
        stages = None if solution is None else prove(solution)
        if stages is not None:
            return stages
    return None


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
