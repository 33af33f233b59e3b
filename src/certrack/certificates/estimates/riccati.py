"""The semidefinite certificate of a law without estimates by one Riccati equation, with gradient.

For fixed multipliers the matrix inequality of :mod:`certrack.certificates.problem`, its inputs
eliminated by Schur complements, is for X = P^-1

    A X + X A^T + X C X + B <= 0,    A = M + alpha/2 I + Uy D^-1 N^T
    B = (Ua lam^-1 Ua^T + Ub nu^-1 Ub^T + Uy D^-1 Uy^T)/2,   C = 2 (G + N D^-1 N^T)
    G = sum lam_i We_i^T We_i,  N = sum lam_i We_i^T Wy_i,  D = diag(k) - sum lam_i Wy_i^T Wy_i

with ||We_i e + Wy_i y|| what bounds a_i. The smallest X solves the equation, and by the scale of V

    bound^2 = 2 (sum nu + sum k) X_11/alpha

is to be minimised over lam, nu, k and alpha: a smooth function without constraints in their
logarithms. With L from (A + X C)^T L + L (A + X C) + e_1 e_1^T = 0, dX_11 = tr(L dF) for every
change F of the equation, so one more linear equation gives all derivatives, those by M and Uy too.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from certrack.certificates.estimates.loop_data import DataGradient
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scaling import Scaling
from certrack.certificates.semidefinite import SemidefiniteProgram

#: alpha of the programs that a cold start tries, over the fastest rate, and by how much it is then
#: lowered, for at the program's optimum the inequality holds with equality.
COLD_SHARES, INSIDE_SHARE = (0.35, 0.1, 0.03), 0.98

#: Where log bound^2 stands still, cold and warm; what a search sees where there is no X.
COLD_ACCURACY, WARM_ACCURACY, NO_SOLUTION = 1e-6, 2e-3, 1e3

#: A start that has no X gets a smaller alpha, down to this part of it.
ALPHA_SHARES = (1.0, 0.7, 0.4, 0.2, 0.05)

#: An eigenvalue nearer to the axis than this, over the largest, counts as on it.
ON_THE_AXIS = 1e-9


@dataclass(frozen=True)
class RiccatiState:
    """Where a search ended: what the next one near it begins from.

    Attributes
    ----------
    scaling : Scaling
    logarithms : array
        Of lam, nu, k and alpha, scaled.
    curvature : array
        Of the inverse Hessian.
    """

    scaling: Scaling
    logarithms: np.ndarray
    curvature: np.ndarray


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
    """

    bound: float
    alpha: float
    gradient: DataGradient
    state: RiccatiState


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
    assert problem.adaptation is None
    if not sum(problem.counts[1:]):
        return None
    scaling = Scaling.of(problem) if warm is None else warm.scaling
    equation = _Equation(scaling.applied(problem))
    begin = _cold_start(problem, scaling) if warm is None else warm.logarithms
    start = None if begin is None else _with_solution(equation, begin)
    if start is None:
        return None
    options: dict[str, Any] = {"gtol": COLD_ACCURACY if warm is None else WARM_ACCURACY}
    if warm is not None:
        options["hess_inv0"] = warm.curvature
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a line search that meets the edge of existence
        result = minimize(equation.search_value, start, jac=True, method="BFGS", options=options)
    value, _ = equation.value(result.x)
    if not math.isfinite(value):
        return None
    bound = float(scaling.sizes[0] * math.exp(value / 2))
    by_M, by_Uy = equation.by_data(result.x)
    ratio = scaling.time * scaling.sizes[None, :] / scaling.sizes[:, None]
    gradient = DataGradient(
        bound / 2 * by_M * ratio, bound / 2 * by_Uy * scaling.time / scaling.sizes[:, None]
    )
    alpha = float(math.exp(result.x[-1]) / scaling.time)
    curvature = (result.hess_inv + result.hess_inv.T) / 2
    if np.linalg.eigvalsh(curvature).min() <= 0:
        curvature = np.eye(len(start))
    return RiccatiEstimate(bound, alpha, gradient, RiccatiState(scaling, result.x, curvature))


def _cold_start(problem: ErrorProblem, scaling: Scaling) -> np.ndarray | None:
    """From one semidefinite program, the first that is solved."""
    program = SemidefiniteProgram(problem, scaling=scaling)
    if not program.fastest > 0:
        return None
    for share in COLD_SHARES:
        alpha = share * program.fastest
        point = program.point(alpha)
        if point is not None:
            break
    else:
        return None
    _, multipliers = program.parts(point.x)
    rate = INSIDE_SHARE * float(scaling.rate(alpha))
    positive = np.maximum(np.concatenate([*multipliers, [rate]]), np.finfo(float).tiny)
    largest = positive[:-1].max()
    positive[:-1] = np.maximum(positive[:-1], 1e-9 * largest)
    return np.asarray(np.log(positive))


def _with_solution(equation: _Equation, begin: np.ndarray) -> np.ndarray | None:
    """The point, with the largest alpha for which there is an X."""
    for share in ALPHA_SHARES:
        start = begin.copy()
        start[-1] += math.log(share)
        if math.isfinite(equation.value(start)[0]):
            return start
    return None


class _Equation:
    """The Riccati equation of one scaled problem, for any multipliers."""

    def __init__(self, problem: ErrorProblem) -> None:
        self.problem = problem
        self._na, self._nb, self._ny = problem.counts
        parts = problem.selections or (None,) * self._na
        self._We, self._Wy = [], []
        for part in parts:
            if part is None:
                self._We.append(problem.Xe)
                self._Wy.append(problem.Xy)
            else:
                through = part[0] @ problem.Xy
                self._We.append(part[0] @ problem.Xe)
                self._Wy.append(through if part[1] is None else through + part[1])
        self._ee = np.array([W.T @ W for W in self._We]).reshape(-1, problem.n, problem.n)
        self._ey = np.array([W.T @ V for W, V in zip(self._We, self._Wy, strict=True)]).reshape(
            -1, problem.n, self._ny
        )
        self._yy = np.array([V.T @ V for V in self._Wy]).reshape(-1, self._ny, self._ny)
        self._last: tuple[bytes, tuple[float, np.ndarray]] | None = None
        self._solved: tuple[np.ndarray, ...] = ()

    def search_value(self, logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        """The same as :meth:`value`, finite where there is no X."""
        value, gradient = self.value(logarithms)
        return (value, gradient) if math.isfinite(value) else (NO_SOLUTION, 0 * logarithms)

    def value(self, logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        """log bound^2 and its gradient; inf where there is no X."""
        key = logarithms.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._computed(logarithms)
        return self._last[1]

    def by_data(self, logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of log bound^2 by M and Uy."""
        self._last = None
        self.value(logarithms)
        X, L, N, D = self._solved
        Uy = self.problem.Uy
        by_Uy = 2 * L @ X @ N @ D + L @ Uy @ D
        return 2 * L @ X / X[0, 0], by_Uy / X[0, 0]

    def _computed(self, logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        p, nothing = self.problem, (math.inf, 0 * logarithms)
        values = np.exp(np.clip(logarithms, -300, 300))
        na, nb, n = self._na, self._nb, p.n
        lam, nu, k, alpha = values[:na], values[na : na + nb], values[na + nb : -1], values[-1]
        inner = np.diag(k) - np.tensordot(lam, self._yy, 1)
        if self._ny and np.linalg.eigvalsh(inner)[0] <= 0:
            return nothing
        D = np.linalg.inv(inner)
        N = np.tensordot(lam, self._ey, 1)
        UD = p.Uy @ D
        A = p.M + UD @ N.T + alpha / 2 * np.eye(n)
        B = ((p.Ua / lam) @ p.Ua.T + (p.Ub / nu) @ p.Ub.T + UD @ p.Uy.T) / 2
        C = 2 * (np.tensordot(lam, self._ee, 1) + N @ D @ N.T)
        solved = _smallest_solution(A, B, C)
        if solved is None:
            return nothing
        X, L = solved
        self._solved = X, L, N, D
        total = float(nu.sum() + k.sum())
        LX = L @ X
        XLX = X @ LX
        by_D = 2 * p.Uy.T @ LX @ N + 2 * N.T @ XLX @ N + p.Uy.T @ L @ p.Uy / 2
        by_inner = -D @ (by_D + by_D.T) @ D / 2
        by_N = 2 * LX.T @ UD + 4 * XLX @ N @ D
        gradient = np.empty_like(values)
        gradient[:na] = (
            2 * np.tensordot(self._ee, XLX, 2)
            + np.tensordot(self._ey, by_N, 2)
            - np.tensordot(self._yy, by_inner, 2)
            - np.einsum("ij,ij->j", p.Ua, L @ p.Ua) / (2 * lam**2)
        )
        gradient[na : na + nb] = -np.einsum("ij,ij->j", p.Ub, L @ p.Ub) / (2 * nu**2)
        gradient[na + nb : -1] = np.diag(by_inner)
        gradient[-1] = np.trace(LX)
        gradient *= values / X[0, 0]
        gradient[na:-1] += values[na:-1] / total
        gradient[-1] -= 1
        return math.log(2 * total * X[0, 0] / alpha), gradient


def _smallest_solution(
    A: np.ndarray, B: np.ndarray, C: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The smallest X with A X + X A^T + X C X + B = 0, and its adjoint L; None if there is none.

    X spans, with the identity, the stable subspace of a Hamiltonian matrix.
    """
    n = len(A)
    values, vectors = np.linalg.eig(np.block([[A.T, C], [-B, -A]]))
    stable = values.real < 0
    if stable.sum() != n or np.abs(values.real).min() < ON_THE_AXIS * np.abs(values).max():
        return None
    upper, lower, poles = vectors[:n, stable], vectors[n:, stable], values[stable]
    try:
        inverse = np.linalg.inv(upper)
    except np.linalg.LinAlgError:
        return None
    X = (lower @ inverse).real
    X = (X + X.T) / 2
    if not X[0, 0] > 0:
        return None
    # (A + X C)^T = A^T + C X = upper diag(poles) inverse
    ends = np.outer(inverse[:, 0], inverse[:, 0]) / (poles[:, None] + poles[None, :])
    L = -(upper @ ends @ upper.T).real
    return X, (L + L.T) / 2
