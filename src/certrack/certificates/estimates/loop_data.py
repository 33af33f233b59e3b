"""The loop of a law with known parameters in plant coordinates: what changes with its gains.

With xi = x - Pi Y, Y = (y_d ... y_d^(q)) and Pi = A^-1 B, which no gain moves,

    xi' = M xi + sum_k tau_k I_k w_k - R y_d^(q+1),      M = [F; K],   e_1 = xi_1

where F are the plant's first n - 1 rows, K = nu_x, and of R only the last entry depends on the
gains. Every law with this q, whatever its recursion, is one point (K, R_n) of these coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certrack.certificates.arithmetic import decimal
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.laws.backstepping import ErrorCoordinates
from certrack.systems.system import System


@dataclass(frozen=True)
class DataGradient:
    """Derivatives of a number by the data of an :class:`ErrorProblem`.

    Attributes
    ----------
    M : (n, n) array
    Uy : (n, ny) array
    """

    M: np.ndarray
    Uy: np.ndarray

    def along(self, above: ErrorProblem, below: ErrorProblem) -> float:
        """What the number changes by from one problem to another beside it."""
        change = (self.M * (above.M - below.M)).sum() + (self.Uy * (above.Uy - below.Uy)).sum()
        return float(change)


def in_plant_coordinates(problem: ErrorProblem) -> ErrorProblem:
    """The problem of a law without estimates, in the coordinates xi of the module's text.

    A quadratic V, or a peak gain, says the same of e_1 in any coordinates.
    """
    Xe = problem.Xe
    A = np.linalg.inv(Xe)
    return replace(
        problem,
        M=Xe @ problem.M @ A,
        Ua=Xe @ problem.Ua,
        Ub=Xe @ problem.Ub,
        Uy=Xe @ problem.Uy,
        Xe=np.eye(problem.n),
    )


@dataclass(frozen=True)
class PlainLoop:
    """The loops of one plant, reference and q, for any gains.

    Attributes
    ----------
    problem : ErrorProblem
        In plant coordinates, of some design.
    last_bound : float
        Y_{q+1}; the column of R is R times it. Zero where R always vanishes (q = n - 1).
    """

    problem: ErrorProblem
    last_bound: float

    @classmethod
    def of(cls, system: System) -> PlainLoop:
        """The loops of `system` with other gains.

        Raises
        ------
        NoCertificate
            If its law is not one with known parameters that certificates cover.
        """
        return cls.from_problem(error_problem(system, decimal), system)

    @classmethod
    def from_problem(cls, problem: ErrorProblem, system: System) -> PlainLoop:
        """From the system's problem in floats."""
        q = system.controller.coordinates.q
        acts = q + 1 in problem.derivatives
        last = float(system.reference.bounds(q + 1).values[-1]) if acts else 0.0
        return cls(in_plant_coordinates(problem), last)

    def with_design(self, design: ErrorCoordinates) -> ErrorProblem:
        """The problem of another design."""
        R = np.linalg.solve(design.A, design.R)
        return self.with_feedback(design.nu_x, float(R[-1]))

    def with_feedback(self, K: np.ndarray, r: float) -> ErrorProblem:
        """The problem of nu = K xi + ... with r for the last entry of R."""
        M, Uy = self.problem.M.copy(), self.problem.Uy
        M[-1] = K
        if self.last_bound:
            Uy = Uy.copy()
            Uy[-1, -1] = -r * self.last_bound
        return replace(self.problem, M=M, Uy=Uy)
