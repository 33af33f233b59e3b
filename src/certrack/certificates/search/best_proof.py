"""The best certificate of one quadratic function: searched in floats, proven exactly."""

from __future__ import annotations

from dataclasses import dataclass

from certrack.certificates.exact import Proof, prove
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.search.decay_rate import best_by_slope
from certrack.certificates.search.riccati import riccati_optimum
from certrack.certificates.semidefinite import SemidefiniteProgram, Solution, best_solution

#: How strict the inequality is made, at which part of the cost, with how much room at most, and
#: how far the solution of a Riccati equation then gives way, until exact arithmetic confirms it.
#: With less room than the first the tubes of shipped systems begin up to 6 % higher; at order 12
#: the equation has no solution with as much.
STRICTNESS = ((1e-7, 1e5, 3e-8), (1e-7, 1e3, 3e-8), (1e-6, 10.0, 1e-7), (1e-5, 10.0, 1e-6))


@dataclass(frozen=True)
class ProofSearch:
    """What a search for a proof ended with.

    Attributes
    ----------
    proof : Proof or None
    program : SemidefiniteProgram or None
        The program that was solved; None where the Riccati equation sufficed.
    solution : Solution or None
        Its best solution.
    """

    proof: Proof | None
    program: SemidefiniteProgram | None = None
    solution: Solution | None = None


def best_proof(exact: ErrorProblem, target: int = 0, near: float | None = None) -> ProofSearch:
    """The proof of the least bound on limsup |e_target| that is reached.

    Without estimates the multipliers and the rate come from a Riccati equation, otherwise from
    semidefinite programs, whose rate is first searched by its slope and then on a grid. A result
    that exact arithmetic does not confirm makes room for the next search.

    Parameters
    ----------
    exact : ErrorProblem
        In exact rationals.
    target : int
        Which e_i is bounded (from 0).
    near : float, optional, 1/s
        Where the search for the rate of a program begins.
    """
    floats = exact.in_floats()
    if exact.adaptation is None:
        proof = _by_riccati_equation(exact, floats, target)
        if proof is not None:
            return ProofSearch(proof)
    program = SemidefiniteProgram(floats, target)
    solution = best_by_slope(program, near)
    proof = None if solution is None else prove(exact, solution, target)
    if solution is not None and proof is None:
        solution = best_solution(program)
        proof = None if solution is None else prove(exact, solution, target)
    return ProofSearch(proof, program, solution)


def _by_riccati_equation(exact: ErrorProblem, floats: ErrorProblem, target: int) -> Proof | None:
    lowest = riccati_optimum(floats, target=target)
    if lowest is None:
        return None
    for strictness, largest_room, back_off in STRICTNESS:
        solution = lowest.solution(strictness, largest_room)
        proof = None if solution is None else prove(exact, solution, target, (back_off,))
        if proof is not None:
            return proof
    return None
