"""The input as a row over errors and reference, beside the error system, in exact rationals.

Of a linear law on a plant whose drift is linear,

    u = (nu_x x + nu_Y (y_d ... y_d^(q+1)) - h - phi^T theta)/g_n = row e + sum_i c_i y_i + c_0

with |y_i| <= 1, i = 0 ... q + 1, and x = A^-1 (e + B Y).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.core.once import once
from certrack.laws.backstepping import ErrorCoordinates
from certrack.model.linear_drift import linear_parts, total_drift
from certrack.references.base import bound_of
from certrack.systems.system import System


@dataclass(frozen=True)
class InputProblem:
    """The error system with all y_0 ... y_{q+1} among its inputs, and the input's row.

    Attributes
    ----------
    problem : ErrorProblem
    row : (n,) array
        Of e.
    through_y : (q+2,) array
        Of the y_i, scaled to their bounds.
    constant : number
    """

    problem: ErrorProblem
    row: np.ndarray
    through_y: np.ndarray
    constant: Any

    @property
    def direct(self) -> Any:
        """The largest part of |u| that does not come from e."""
        return sum((abs(v) for v in self.through_y), abs(self.constant))

    @property
    def over_all(self) -> np.ndarray:
        """u over z = (e, a, b, y), without the constant."""
        na, nb, _ = self.problem.counts
        none = np.zeros(na + nb, dtype=self.row.dtype)
        return np.concatenate([self.row, none, self.through_y])

    def in_floats(self) -> InputProblem:
        """The same in floating point."""
        row, through_y = self.row.astype(float), self.through_y.astype(float)
        return InputProblem(self.problem.in_floats(), row, through_y, float(self.constant))


@once
def input_problem(system: System) -> InputProblem:
    """The input of a system beside its error system.

    Raises
    ------
    NoCertificate
        If the law is not linear, or the error system is not covered.
    """
    if system.law.online is not None:
        raise NoCertificate("of gains that stand still only, and law.online moves them")
    exact = error_problem(system, rational)
    if exact.adaptation is not None:
        raise NoCertificate("of a law of known parameters only: with estimates u is not linear")
    plant = system.plant
    parts = linear_parts(plant, total_drift(plant, plant.theta or ()))
    if parts is None:
        raise NoCertificate("of a plant whose drift is linear only")
    assert plant.input_gain is not None
    h_x = np.array([rational(v) for v in parts[0]], dtype=object)
    h_0, g_n = rational(parts[1]), rational(plant.input_gain)
    design = error_coordinates(system, rational)
    Y = [exact_float(bound_of(system.reference, i)[0], rational) for i in range(design.q + 2)]
    slopes = (design.nu_x - h_x) / g_n
    coefficients = design.nu_Y / g_n
    coefficients[:-1] = coefficients[:-1] + slopes @ (exact.Xe @ design.B)
    problem = with_all_derivatives(exact, design, Y)
    return InputProblem(problem, slopes @ exact.Xe, coefficients * np.array(Y), -h_0 / g_n)


def with_all_derivatives(
    exact: ErrorProblem, design: ErrorCoordinates, Y: Sequence[Any]
) -> ErrorProblem:
    """The error system with all y_0 ... y_{q+1}, of these bounds, among its inputs."""
    through = exact.Xe @ design.B
    Uy, Xy = (np.zeros((exact.n, len(Y)), dtype=object) + rational(0) for _ in range(2))
    for i in range(design.q + 1):
        Xy[:, i] = through[:, i] * Y[i]
    Uy[:, -1] = -design.R * Y[-1]
    return replace(exact, Uy=Uy, Xy=Xy, derivatives=tuple(range(len(Y)))).read_only()
