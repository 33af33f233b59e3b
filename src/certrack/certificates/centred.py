"""The centred stage: the adaptive law analysed around better virtual parameters.

The leakage pulls the estimates to the prior guesses, and V counts the distance to the true values.
V may as well be centred elsewhere: at (1 - kappa) delta and (1 + kappa) theta, nearer to the
guesses. With D = delta_tilde - kappa/g_n and theta_tilde + kappa theta in its place, the leakage
costs less, and of the cancellation there remains, on the last row,

    -kappa ubar - kappa phi^T theta = -kappa nu_lin + zeta,   zeta = kappa (h - phi^T theta_tilde)

with nu_lin = nu_x . x + nu_Y . Y. The linear part joins the matrix inequality; zeta is bounded on
the set that an earlier stage has proven to be reached, by interval arithmetic rounded outward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import sympy
from mpmath import iv, mp

from certrack.certificates.arithmetic import exact_float, rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, float_up, from_text, root_up
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.intervals import enclosure
from certrack.certificates.problem import ErrorProblem
from certrack.core.enclosures import WIDENING
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.magnitudes import largest_magnitudes
from certrack.core.powers import put_in
from certrack.laws.backstepping import ErrorCoordinates
from certrack.systems.system import System


@dataclass(frozen=True)
class CentredProblems:
    """The problem with V centred by any kappa, on the set that a proof reaches.

    Attributes
    ----------
    problem : ErrorProblem
        Not centred.
    row : array
        Of M, for each kappa.
    columns : array
        Of Uy in the last row, for each kappa: of y_d ... y_d^(q+1).
    residual : array
        The last column of Uy, without kappa.
    Xy : array
        All columns of the reference.
    remainder : number
        Bound on zeta, for each kappa.
    """

    problem: ErrorProblem
    row: np.ndarray
    columns: np.ndarray
    residual: np.ndarray
    Xy: np.ndarray
    remainder: Any

    @classmethod
    def of(cls, system: System, problem: ErrorProblem, reached: Proof) -> CentredProblems:
        """Those of `system`.

        Parameters
        ----------
        system : System
        problem : ErrorProblem
            Of `system`, in exact rationals, with the adaptive law.
        reached : Proof
            A proven bound on e_n, so that e^T P e <= bound^2 in the long run.

        Raises
        ------
        NoCertificate
            If drift and regressor have no interval bound on that set.
        """
        coordinates = error_coordinates(system, rational)
        _, Y = reference_part(system, problem)
        return cls.of_design(problem, coordinates, Y, RemainderBound(system, problem)(reached))

    @classmethod
    def of_design(
        cls, problem: ErrorProblem, coordinates: ErrorCoordinates, Y: list[Any], remainder: Any
    ) -> CentredProblems:
        """Those of a design, in the arithmetic of its numbers.

        Parameters
        ----------
        problem : ErrorProblem
        coordinates : ErrorCoordinates
        Y : numbers
            Bounds of y_d ... y_d^(q+1).
        remainder : number
            Bound on zeta, for each kappa.
        """
        q, zero, AB = coordinates.q, 0 * Y[0], problem.Xe @ coordinates.B
        Xy = np.zeros((problem.n, q + 2), dtype=object) + zero
        Xy[:, : q + 1] = AB * np.array(Y[: q + 1], dtype=object)
        through_x = np.append(coordinates.nu_x @ AB, zero)
        return cls(
            problem,
            coordinates.nu_x @ problem.Xe,
            (through_x + coordinates.nu_Y) * np.array(Y, dtype=object),
            coordinates.R * Y[-1],
            Xy,
            remainder,
        )

    def at(self, kappa: Any) -> ErrorProblem:
        """The problem whose V is centred by `kappa`, in the arithmetic of this one."""
        problem, law = self.problem, self.problem.adaptation
        assert law is not None
        M = problem.M.copy()
        M[-1] = M[-1] - kappa * self.row
        Uy = 0 * self.Xy
        Uy[-1] = -kappa * self.columns
        Uy[:, -1] = Uy[:, -1] - self.residual
        by_states = problem.counts[0] > 0
        acting = [
            i
            for i in range(Uy.shape[1])
            if any(Uy[:, i] != 0) or (by_states and any(self.Xy[:, i] != 0))
        ]
        zeta = 0 * self.Xy[:, :1]
        zeta[-1, 0] = abs(kappa) * self.remainder
        return replace(
            problem,
            M=M,
            Ub=np.hstack([problem.Ub, zeta]) if zeta[-1, 0] != 0 else problem.Ub,
            Uy=Uy[:, acting],
            Xy=self.Xy[:, acting],
            derivatives=tuple(acting),
            adaptation=replace(law, shift=kappa),
        )

    def in_floats(self) -> CentredProblems:
        """The same in floating point."""
        return CentredProblems(
            self.problem.in_floats(),
            self.row.astype(float),
            self.columns.astype(float),
            self.residual.astype(float),
            self.Xy.astype(float),
            float(self.remainder),
        )


def centred_problem(
    system: System, problem: ErrorProblem, reached: Proof, kappa: Any
) -> ErrorProblem:
    """The problem with V centred by `kappa`, on the set that `reached` proves.

    Parameters
    ----------
    system : System
    problem : ErrorProblem
        Of `system`, in exact rationals, with the adaptive law.
    reached : Proof
        A proven bound on e_n, so that e^T P e <= bound^2 in the long run.
    kappa : rational
        Which part of delta and theta the centre is moved by.

    Raises
    ------
    NoCertificate
        If drift and regressor have no interval bound on that set.
    """
    return CentredProblems.of(system, problem, reached).at(kappa)


def reference_part(system: System, problem: ErrorProblem) -> tuple[np.ndarray, list[Any]]:
    """A^{-1} B and the bounds Y: x = A^{-1} e + A^{-1} B (y_d ... y_d^(q)), |y_d^(i)| <= Y_i."""
    coordinates = error_coordinates(system, rational)
    return problem.Xe @ coordinates.B, bounds_needed(system, coordinates.q)


def bounds_needed(system: System, q: int) -> list[Any]:
    """The bounds of y_d ... y_d^(q+1), in rationals.

    Raises
    ------
    NoCertificate
        If one is neither proven nor declared.
    """
    try:
        bounds = system.reference.bounds(q + 1).values
    except InputError as unbounded:
        raise NoCertificate(f"the centred stage needs all bounds of y_d: {unbounded}") from None
    return [exact_float(v, rational) for v in bounds]


class RemainderBound:
    """Bound on |h - phi^T theta_tilde| as a function of what is reached.

    Parameters
    ----------
    system : System
    problem : ErrorProblem
        Of `system`, in exact rationals, with the adaptive law.
    """

    def __init__(self, system: System, problem: ErrorProblem) -> None:
        law, plant = problem.adaptation, system.plant
        assert law is not None
        AB, Y = reference_part(system, problem)
        exact = {symbol(name): value for name, value in plant.constant_values.items()}
        self._law, self._Xe, self._states = law, problem.Xe, plant.symbols
        self._drift = put_in(plant.drift.expr, exact)
        self._regressor = [put_in(phi.expr, exact) for phi in plant.regressor]
        # |x_j| <= max over the ellipsoid of |(A^-1 e)_j|, plus |(A^-1 B)_j| Y; a smaller box would
        # leave out states that are reached, and the bound would be wrong
        self._offsets = [
            sum((abs(AB[j, i]) * Y[i] for i in range(AB.shape[1])), rational(0))
            for j in range(plant.n)
        ]
        self._spreads = cache(self._spreads_of)

    def _spreads_of(self, rows: tuple[tuple[str, ...], ...]) -> tuple[list[Any], list[Any]]:
        """What the square of the bound is multiplied with, for each x_j and each theta_i."""
        P = np.array([[from_text(v) for v in row] for row in rows], dtype=object)
        states = np.diagonal(self._Xe @ solve(P, self._Xe.T))
        count = len(self._regressor)
        return list(states), [self._law.Gamma[i, i] / P[-1, -1] for i in range(count)]

    def __call__(self, reached: Proof) -> Any:
        """On the set e^T P e <= B^2, s |theta_tilde|^2 <= B^2, with B the bound of a proof.

        Raises
        ------
        NoCertificate
            Where drift and regressor have no interval bound on that set.
        """
        B2 = from_text(reached.bound) ** 2
        states, errors = self._spreads(reached.P)
        box = {}
        for state, spread, offset in zip(self._states, states, self._offsets, strict=True):
            radius = from_text(root_up(B2 * spread)) + offset
            box[state] = _enclose(-radius, radius)
        total = _magnitude(self._drift, box)
        for phi, spread in zip(self._regressor, errors, strict=True):
            error = from_text(root_up(B2 * spread))
            total = total + _magnitude(phi, box) * error
        return total

    def in_floats(self, reached: Proof, squares: np.ndarray) -> np.ndarray:
        """Floats not below the bounds on many sets, whose B^2 are the given ones.

        Parameters
        ----------
        reached : Proof
            Of the same P.
        squares : (N,) array

        Returns
        -------
        (N,) array
            Infinite where the float enclosures know no bound; the call itself may.
        """
        states, errors = self._spreads(reached.P)

        def radius(spread: Any) -> np.ndarray:
            return np.sqrt(squares * float_up(spread)) * (1 + WIDENING)

        box = {}
        for state, spread, offset in zip(self._states, states, self._offsets, strict=True):
            size = (radius(spread) + float_up(offset)) * (1 + WIDENING)
            box[state] = -size, size
        try:
            total = largest_magnitudes(self._drift, box, len(squares))
            for phi, spread in zip(self._regressor, errors, strict=True):
                part = largest_magnitudes(phi, box, len(squares)) * radius(spread)
                total = (total + part * (1 + WIDENING)) * (1 + WIDENING)
        except TypeError:  # a function without a rule
            return np.full(len(squares), np.inf)
        return np.where(np.isnan(total), np.inf, total)


def _enclose(low: Any, high: Any) -> Any:
    """mpmath interval around two rationals: a division of intervals rounds outward."""
    ends = [iv.mpf(int(v.p)) / iv.mpf(int(v.q)) for v in (low, high)]
    return iv.mpf([ends[0].a, ends[1].b])


def _magnitude(formula: sympy.Expr, box: Any) -> Any:
    """Rational not below |formula| on the box."""
    try:
        size = mp.mpf(abs(enclosure(formula, box)).b)
    except (ArithmeticError, ValueError, TypeError):
        raise NoCertificate("no interval bound of the drift or regressor on the set") from None
    bound = float(size)  # exactly, for the ends of mpmath's intervals have 53 bits
    if not math.isfinite(bound):
        raise NoCertificate("the drift or regressor is unbounded on the set")
    return exact_float(bound, rational)
