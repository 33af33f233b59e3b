"""The semidefinite program of a law without estimates, for fixed multipliers: a Riccati equation.

The matrix inequality of :mod:`certrack.certificates.problem`, its inputs eliminated by Schur
complements, is for X = P^-1

    A X + X A^T + X C X + B <= 0,    A = M + alpha/2 I + Uy D^-1 N^T
    B = (Ua lam^-1 Ua^T + Ub nu^-1 Ub^T + Uy D^-1 Uy^T)/2,   C = 2 (G + N D^-1 N^T)
    G = sum lam_i We_i^T We_i,  N = sum lam_i We_i^T Wy_i,  D = diag(k) - sum lam_i Wy_i^T Wy_i

with ||We_i e + Wy_i y|| what bounds a_i. The smallest X solves the equation, and by the scale of V

    bound^2 = 2 (sum nu + sum k) X_tt/alpha

for the target e_t is to be minimised over lam, nu, k and alpha: a smooth function without
constraints in their logarithms. With L from (A + X C)^T L + L (A + X C) + e_t e_t^T = 0,
dX_tt = tr(L dF) for every change F of the equation, so one more linear equation gives all
derivatives, those by M and Uy too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certrack.certificates.problem import ErrorProblem

#: An eigenvalue nearer to the axis than this, over the largest, counts as on it.
ON_THE_AXIS = 1e-9

#: Logarithms of multipliers are taken within these limits.
LARGEST_LOGARITHM = 300

#: The least that counts as curvature of the logarithm of the bound.
LEAST_CURVATURE = 1e-3


@dataclass(frozen=True)
class RiccatiPoint:
    """The logarithm of bound^2 for some multipliers.

    Attributes
    ----------
    value : float
    gradient : array
        By the logarithms of lam, nu, k and alpha.
    curvature : array
        About the diagonal of the Hessian.
    X, L, N, D : arrays
        Of the module's text; D inverted.
    """

    value: float
    gradient: np.ndarray
    curvature: np.ndarray
    X: np.ndarray
    L: np.ndarray
    N: np.ndarray
    D: np.ndarray


class RiccatiEquation:
    """The equation of one scaled problem without estimates, for any multipliers.

    Parameters
    ----------
    problem : ErrorProblem
        In floats.
    target : int
        Which e_i is bounded (from 0).
    """

    def __init__(self, problem: ErrorProblem, target: int = 0) -> None:
        self.problem, self.target = problem, target
        self.counts = na, nb, ny = problem.counts
        n = problem.n
        parts = problem.selections or (None,) * na
        self._ee, self._ey = np.zeros((na, n, n)), np.zeros((na, n, ny))
        self._yy = np.zeros((na, ny, ny))
        for i, part in enumerate(parts):
            We, Wy = problem.Xe, problem.Xy
            if part is not None:
                We, Wy = part[0] @ We, part[0] @ Wy + (0 if part[1] is None else part[1])
            self._ee[i], self._ey[i], self._yy[i] = We.T @ We, We.T @ Wy, Wy.T @ Wy
        self._eye, self._slices = np.eye(n), (slice(na), slice(na, na + nb), slice(na + nb, -1))
        self._rows = (  # the same with a row for each a-input
            self._ee.reshape(na, n * n),
            self._ey.reshape(na, n * ny),
            self._yy.reshape(na, ny * ny),
        )

    @property
    def reference_weights(self) -> np.ndarray:
        """For a lam of 1 of each a-input, what it takes of each k at least, with room."""
        return 2 * self.counts[2] * np.einsum("ijj->ij", self._yy)

    def sizes(self, form: np.ndarray) -> np.ndarray:
        """tr(We_i^T We_i form) of each a-input."""
        return self._rows[0] @ form.ravel()

    def at(self, logarithms: np.ndarray) -> RiccatiPoint | None:
        """The point with these logarithms; None where there is no X."""
        p, t = self.problem, self.target
        values = np.exp(np.clip(logarithms, -LARGEST_LOGARITHM, LARGEST_LOGARITHM))
        lam, nu, k = (values[part] for part in self._slices)
        alpha = float(values[-1])
        equation = self._matrices(lam, nu, k, alpha)
        if equation is None:
            return None
        A, B, C, N, D, UD = equation
        solved = smallest_solution(A, B, C, t)
        if solved is None:
            return None
        X, L = solved
        unit = float(X[t, t])
        total = float(nu.sum() + k.sum())
        LX = L @ X
        XLX = X @ LX
        by_D = 2 * p.Uy.T @ LX @ N + 2 * N.T @ XLX @ N + p.Uy.T @ L @ p.Uy / 2
        by_inner = -D @ (by_D + by_D.T) @ D / 2
        by_N = 2 * LX.T @ UD + 4 * XLX @ N @ D
        # what raises and what lowers the bound with each multiplier: at an optimum they balance,
        # and their sum is about the second derivative
        up, down = np.empty_like(values), np.zeros_like(values)
        a, b, y = self._slices
        up[a] = (
            2 * (self._rows[0] @ XLX.ravel())
            + self._rows[1] @ by_N.ravel()
            - self._rows[2] @ by_inner.ravel()
        ) * (lam / unit)
        down[a] = _column_forms(L, p.Ua) / (2 * lam * unit)
        up[b], up[y] = nu / total, k / total
        down[b] = _column_forms(L, p.Ub) / (2 * nu * unit)
        down[y] = -np.diagonal(by_inner) * k / unit
        up[-1], down[-1] = alpha * float(np.trace(LX)) / unit, 1.0
        return RiccatiPoint(
            math.log(2 * total * unit / alpha),
            up - down,
            np.maximum(np.abs(up) + np.abs(down), LEAST_CURVATURE),
            X,
            L,
            N,
            D,
        )

    def _matrices(
        self, lam: np.ndarray, nu: np.ndarray, k: np.ndarray, alpha: float
    ) -> tuple[np.ndarray, ...] | None:
        """A, B, C, N, D^-1 and Uy D^-1; None where D is not positive definite."""
        p = self.problem
        n, ny = self._eye.shape[0], len(k)
        inner = np.diag(k) - (lam @ self._rows[2]).reshape(ny, ny)
        if ny:
            try:
                np.linalg.cholesky(inner)
            except np.linalg.LinAlgError:
                return None
        D = np.linalg.inv(inner)
        N = (lam @ self._rows[1]).reshape(n, ny)
        UD = p.Uy @ D
        A = p.M + UD @ N.T + alpha / 2 * self._eye
        B = ((p.Ua / lam) @ p.Ua.T + (p.Ub / nu) @ p.Ub.T + UD @ p.Uy.T) / 2
        C = 2 * ((lam @ self._rows[0]).reshape(n, n) + N @ D @ N.T)
        return A, B, C, N, D, UD

    def strict_solution(
        self, logarithms: np.ndarray, slack: float, largest_room: float
    ) -> np.ndarray | None:
        """An X for which the inequality is strict, at the cost of this part of X_tt; or None.

        Room is made in the inequality as on the central path of the program, by the inverse of L:
        where it costs little there is much of it, up to about `largest_room` times alpha X, and P
        then is no larger than it must be.
        """
        values = np.exp(logarithms)
        lam, nu, k = (values[part] for part in self._slices)
        equation = self._matrices(lam, nu, k, float(values[-1]))
        if equation is None:
            return None
        A, B, C = equation[:3]
        tight = smallest_solution(A, B, C, self.target)
        if tight is None:
            return None
        X, L = tight
        share = slack / (largest_room * len(X)) * float(np.sum(L * X))
        cost = slack * X[self.target, self.target] / len(X)
        room = cost * np.linalg.inv(L + share * np.linalg.inv(X))
        solved = smallest_solution(A, B + (room + room.T) / 2, C, self.target)
        return None if solved is None else solved[0]

    def by_data(self, point: RiccatiPoint) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the point's value by M and Uy."""
        X, L, N, D = point.X, point.L, point.N, point.D
        unit = X[self.target, self.target]
        by_Uy = 2 * L @ X @ N @ D + L @ self.problem.Uy @ D
        return 2 * L @ X / unit, by_Uy / unit


def _column_forms(L: np.ndarray, U: np.ndarray) -> np.ndarray:
    """u^T L u of each column."""
    forms: np.ndarray = (U * (L @ U)).sum(axis=0)
    return forms


def smallest_solution(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, target: int = 0
) -> tuple[np.ndarray, np.ndarray] | None:
    """The smallest X with A X + X A^T + X C X + B = 0, and its adjoint L; None if there is none.

    X spans, with the identity, the stable subspace of a Hamiltonian matrix.
    """
    n = len(A)
    hamiltonian = np.empty((2 * n, 2 * n))
    hamiltonian[:n, :n], hamiltonian[:n, n:] = A.T, C
    hamiltonian[n:, :n], hamiltonian[n:, n:] = -B, -A
    if not np.isfinite(hamiltonian).all():
        return None
    values, vectors = np.linalg.eig(hamiltonian)
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
    if not X[target, target] > 0:
        return None
    # (A + X C)^T = A^T + C X = upper diag(poles) inverse
    row = inverse[:, target]
    ends = np.outer(row, row) / (poles[:, None] + poles[None, :])
    L = -(upper @ ends @ upper.T).real
    return X, (L + L.T) / 2
