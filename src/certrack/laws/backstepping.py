"""The backstepping recursion, numeric: gains in, error coordinates and virtual controls out.

The stabilising functions are linear with constant coefficients,

    lambda_m = sum_{j<=m} eta_mj x_j + sum_{i<=q} d_mi y_d^(i)                             [20]

so the whole design is a few vector operations per step; nothing is differentiated. With
Y = (y_d, y_d', ..., y_d^(q)), the error coordinates are e = A x - B Y [6], [30], [31]. q = 0 is the
published law; q > 0 feeds derivatives of the reference forward and q = n - 1 is the classic one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import set_fields

#: A design with a larger coefficient is refused: the certificates square the coefficients, and the
#: square must be a float.
LARGEST_COEFFICIENT = 1e150


def no_damping(n: int) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    """The k and p of a lean design for n states: all inf."""
    return tuple((math.inf,) * (2 * m) for m in range(1, n + 1)), (math.inf,) * (n - 1)


@dataclass(frozen=True)
class Gains:
    """Design parameters of the recursion.

    Parameters
    ----------
    c : n positive numbers, 1/s
        Decay rates of the steps.
    k : n rows, row m of 2m positive numbers or inf, optional
        Damping by Young's inequality: k_{m,2i-1} of the gamma-part of w_i at step m, k_{m,2i} of
        its beta-part. ``inf`` omits a term; all are omitted if left out (a lean design).
    p : n - 1 positive numbers or inf, optional
        Damping of the reference derivative that is not fed forward.
    coupling : float > 0, optional
        rho of the balanced recursion (:mod:`certrack.laws.balanced`); the paper's if left out.
    integral : float > 0, optional
        c_0 of integral action (:mod:`certrack.laws.integral`); none if left out.
    """

    c: tuple[float, ...]
    k: tuple[tuple[float, ...], ...] | None = None
    p: tuple[float, ...] | None = None
    coupling: float | None = None
    integral: float | None = None

    def __post_init__(self) -> None:
        c = checks.reals("law.c", self.c, None, "c_1 ... c_n", above=0)
        if not c:
            raise InputError("law.c", "must not be empty: c_1 ... c_n", [])
        n = len(c)
        limits: dict[str, Any] = {"above": 0, "infinite": True}
        k, p = no_damping(n)
        if self.k is not None:
            rows = checks.sequence("law.k", self.k, n, "row m holds k_m1 ... k_m,2m, m = 1 ... n")
            k = tuple(
                checks.reals(f"law.k[{m}]", row, 2 * m + 2, f"k_{m + 1},j", **limits)
                for m, row in enumerate(rows)
            )
        if self.p is not None:
            p = checks.reals("law.p", self.p, n - 1, "p_1 ... p_{n-1}", **limits)
        set_fields(self, c=c, k=k, p=p)
        if self.coupling is not None:
            set_fields(self, coupling=checks.real("law.coupling", self.coupling, above=0))
            if not self.is_lean:
                raise InputError(
                    "law.coupling",
                    "needs k and p to be inf: damping belongs to the paper's recursion",
                    self.coupling,
                    "Leave out k and p, or coupling",
                )
        if self.integral is not None:
            set_fields(self, integral=checks.real("law.integral", self.integral, above=0))
            if not self.is_lean:
                raise InputError(
                    "law.integral",
                    "needs k and p to be inf: the recursion has a step more, without damping",
                    self.integral,
                    "Leave out k and p, or integral",
                )

    @property
    def is_lean(self) -> bool:
        """Whether all damping is omitted."""
        assert self.k is not None and self.p is not None
        return all(math.isinf(v) for row in (*self.k, self.p) for v in row)

    @property
    def n(self) -> int:
        """Order of the plant that the gains are for."""
        return len(self.c)


@dataclass(frozen=True)
class IntegralPart:
    """What the integral of the error adds; see :mod:`certrack.laws.integral`.

    Attributes
    ----------
    gain : c_0, 1/s
    column : (n,) array
        Of e_1 ... e_n by e_0.
    nu : number
        Of nu by e_0.
    error_matrix : (n + 1, n + 1) array
        Of e_0 ... e_n.
    """

    gain: Any
    column: np.ndarray
    nu: Any
    error_matrix: np.ndarray


@dataclass(frozen=True)
class ErrorCoordinates:
    """Result of the recursion: e = A x - B Y with Y = (y_d ... y_d^(q)) [6], [30], [31].

    Attributes
    ----------
    A : (n, n) array
        Unit lower triangular.
    B : (n, q+1) array
        First row (1, 0 ... 0); row m + 1 holds the d_mi.
    F : (n-1, n) array
        Rows of the nominal chain: F_i x = g_i x_{i+1} + sum_j b_ij x_j.
    c, kappa : (n,) arrays, 1/s
        Decay and added damping [18].
    g : (n-1,) array
        Virtual control coefficients.
    nu_x, nu_Y : (n,) and (q+2,) arrays
        nu = nu_x . x + nu_Y . (y_d ... y_d^(q+1)) - h(x), the part all laws share: ubar of [25]
        without theta_hat.
    weights : (n,) array, optional
        s_1 ... s_n of the balanced recursion; 1 if left out.
    integral : IntegralPart, optional
        Of a law with integral action; then e has a column more and nu a term more.
    """

    A: np.ndarray
    B: np.ndarray
    F: np.ndarray
    c: np.ndarray
    kappa: np.ndarray
    g: np.ndarray
    nu_x: np.ndarray
    nu_Y: np.ndarray
    weights: np.ndarray | None = None
    integral: IntegralPart | None = None

    @property
    def n(self) -> int:
        """Order of the plant."""
        return len(self.A)

    @property
    def q(self) -> int:
        """Feed-forward order."""
        return self.B.shape[1] - 1

    @property
    def eta(self) -> list[np.ndarray]:
        """eta_m1 ... eta_mm of lambda_m [20], m = 1 ... n-1."""
        return [-self.A[m, :m] for m in range(1, self.n)]

    @property
    def d(self) -> np.ndarray:
        """d_m0 ... d_mq of lambda_m [20], shape (n-1, q+1)."""
        return self.B[1:]

    @cached_property
    def R(self) -> np.ndarray:
        """Coefficients of the reference derivative that stays uncompensated; R_n = 0."""
        residual = self.B[:, self.q].copy()
        residual[-1] = 0
        return residual

    @cached_property
    def error_matrix(self) -> np.ndarray:
        """S - C - K of the error system e' = (S - C - K) e + ...

        It is what the open-loop rates [7], [11], [16] and, for e_n, [21] become with the virtual
        controls and the law in them. Balanced: V = sum s_i^2 e_i^2/2, and -g_{i} (s_i/s_{i+1})^2
        below the diagonal. With integral action, that of e_0 ... e_n.
        """
        if self.integral is not None:
            return self.integral.error_matrix
        below = self.g
        if self.weights is not None:
            below = below * (self.weights[:-1] / self.weights[1:]) ** 2
        skew = np.diag(self.g, 1) - np.diag(below, -1)
        return skew - np.diag(self.c + self.kappa)

    @property
    def input_feedback(self) -> np.ndarray:
        """k of v = -k e, what the last row has beside the terms that cancel in V'."""
        return np.append(np.zeros(self.n - 1), -self.error_matrix[-1, -1])

    @cached_property
    def poles(self) -> np.ndarray:
        """Eigenvalues of the error matrix, 1/s."""
        return np.linalg.eigvals(self.error_matrix)

    @cached_property
    def slowest_pole(self) -> float:
        """Smallest magnitude of the poles, 1/s."""
        return float(np.abs(self.poles).min())

    @cached_property
    def fastest_pole(self) -> float:
        """Largest magnitude of the poles, 1/s."""
        return float(np.abs(self.poles).max())


def is_moderate(design: ErrorCoordinates) -> bool:
    """Whether the coefficients of a design are finite, and their squares too."""
    parts = (design.kappa, design.nu_x, design.nu_Y, design.A, design.B)
    return all(
        bool(np.isfinite(part).all()) and np.abs(part).max() < LARGEST_COEFFICIENT for part in parts
    )


def carry_out(
    g: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    weights: Sequence[np.ndarray],
    residual_weights: np.ndarray,
    q: int,
) -> ErrorCoordinates:
    """The recursion itself, in the arithmetic of its arguments (float, or exact rationals).

    Parameters
    ----------
    g, b, c
        As in :func:`recursion`.
    weights : n arrays
        Entry i of row m is 1/(4 k_{m,2i-1}) + 1/(4 k_{m,2i}).
    residual_weights : (n-1,) array
        1/(4 p_m).
    q : int
        Feed-forward order.
    """
    n = len(c)
    F = b + np.eye(n - 1, n, 1, dtype=b.dtype) * g[:, None]
    A, B = np.eye(n, dtype=b.dtype), np.zeros((n, q + 1), dtype=b.dtype)
    kappa = np.zeros(n, dtype=b.dtype)
    B[0, 0] = 1
    for m in range(n):  # step m + 1 of the paper
        eta = -A[m, :m]
        kappa[m] = weights[m][m] + (weights[m][:m] * eta**2).sum()  # [18], [25]
        if m < n - 1:
            kappa[m] += B[m, q] ** 2 * residual_weights[m]
        x_part = -(c[m] + kappa[m]) * A[m] + eta @ F[:m]
        y_part = (c[m] + kappa[m]) * B[m]
        if m:
            x_part -= g[m - 1] * A[m - 1]
            y_part += g[m - 1] * B[m - 1]
        if m == n - 1:  # nu, of [25]: every derivative is fed forward
            nu_Y = np.append(y_part, 0) + np.append(0, B[m])
            break
        y_part[1:] += B[m, :q]  # the derivatives that lambda_m may use
        lambda_x = (x_part - b[m]) / g[m]  # [9], [13], [18]
        A[m + 1, : m + 1] = -lambda_x[: m + 1]
        B[m + 1] = y_part / g[m]
    return ErrorCoordinates(A, B, F, c, kappa, g, x_part, nu_Y)
