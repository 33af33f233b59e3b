"""The semidefinite bound of a law without estimates by one Riccati equation, with its gradient."""

from __future__ import annotations

from dataclasses import dataclass

from certrack.certificates.estimates.loop_data import DataGradient
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.search.best_proof import STRICTNESS
from certrack.certificates.search.riccati import RiccatiState, riccati_optimum
from certrack.certificates.semidefinite import Solution


@dataclass(frozen=True)
class RiccatiEstimate:
    """The semidefinite bound, as far as floats tell.

    Attributes
    ----------
    bound : float
        Of limsup |e_1|.
    alpha : float, 1/s
    gradient : DataGradient
        Of the bound.
    state : RiccatiState
    solution : Solution
        Of the semidefinite program, as far inside as a proof of it: its bound is 1e-7 larger.
    """

    bound: float
    alpha: float
    gradient: DataGradient
    state: RiccatiState
    solution: Solution


def riccati_estimate(
    problem: ErrorProblem, warm: RiccatiState | None = None
) -> RiccatiEstimate | None:
    """The bound of a problem without estimates; None if none is reached from the start.

    Parameters
    ----------
    problem : ErrorProblem
        In floats, with bounded inputs.
    warm : RiccatiState, optional
        Of a problem with the same structure, nearby.
    """
    optimum = riccati_optimum(problem, warm)
    if optimum is None:
        return None
    inside = (optimum.solution(strictness, room) for strictness, room, _ in STRICTNESS)
    solution = next(filter(None, inside), None)
    if solution is None:
        return None
    by_M, by_Uy = optimum.equation.by_data(optimum.point)
    bound, time, sizes = optimum.bound, optimum.state.scaling.time, optimum.state.scaling.sizes
    ratio = time * sizes[None, :] / sizes[:, None]
    gradient = DataGradient(bound / 2 * by_M * ratio, bound / 2 * by_Uy * time / sizes[:, None])
    return RiccatiEstimate(bound, optimum.alpha, gradient, optimum.state, solution)
