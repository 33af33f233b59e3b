"""The error system as a linear matrix inequality, in floats or in exact rationals.

    e' = (S - C - K) e + sum_k tau_k A_k w_k - R y_d^(q+1) + (0 ... 0, mismatch)

The uncertain terms are split, w_k = a_k + b_k with |a_k| <= gamma_k ||x||, |b_k| <= beta_k (nothing
is lost), and every input is scaled to its bound: |a_k| <= ||x||, |b_k| <= 1, |y_i| <= 1. For the
adaptive law the mismatch phi^T theta_tilde - g_n delta_tilde ubar is cancelled by the update laws
when V contains the estimates with the same weight s as e_n^2.

The same formulas serve both arithmetics, so what is optimised is what is verified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.adaptation import Adaptation


@dataclass(frozen=True)
class ErrorProblem:
    """Data of the linear matrix inequality.

    Attributes
    ----------
    M : (n, n) array
        S - C - K.
    Ua, Ub, Uy : arrays with n rows
        Input columns of a, b and the reference derivatives, scaled.
    Xe, Xy : arrays with n rows
        x = Xe e + Xy y.
    states : indices k (from 0) of the a-inputs, then of the b-inputs
    derivatives : orders i of the reference derivatives that matter
    adaptation : Adaptation or None
    selections : (S, T) or None for each a-input
        What bounds it: |a_k| <= ||S x + T y||; ||x|| where there is None, and for all if left out.
        A T of None is zero.
    """

    M: np.ndarray
    Ua: np.ndarray
    Ub: np.ndarray
    Uy: np.ndarray
    Xe: np.ndarray
    Xy: np.ndarray
    states: tuple[tuple[int, ...], tuple[int, ...]]
    derivatives: tuple[int, ...]
    adaptation: Adaptation | None
    selections: tuple[tuple[np.ndarray, np.ndarray | None] | None, ...] = ()

    @property
    def n(self) -> int:
        """Order of the plant."""
        return self.M.shape[0]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of a-, b- and reference inputs."""
        return self.Ua.shape[1], self.Ub.shape[1], self.Uy.shape[1]

    def read_only(self) -> ErrorProblem:
        """The problem, whose arrays nobody can change any more: it may be used again."""
        for matrix in (self.M, self.Ua, self.Ub, self.Uy, self.Xe, self.Xy):
            matrix.flags.writeable = False
        return self

    def inequality(
        self, P: np.ndarray, lam: np.ndarray, nu: np.ndarray, k: np.ndarray, alpha: Any
    ) -> np.ndarray:
        """Matrix of the quadratic form that must be <= 0 in z = (e, a, b, y).

        e^T P (M e + U (a, b, y)) + alpha/2 e^T P e
          + sum lam_k (||x||^2 - a_k^2) - sum nu_k b_k^2 - sum k_i y_i^2

        with ||S_k x + T_k y||^2 in the place of ||x||^2 where something else bounds a_k.
        """
        n, (na, nb, ny) = self.n, self.counts
        size = n + na + nb + ny
        Q = np.zeros((size, size), dtype=self.M.dtype)
        a, b, y = slice(n, n + na), slice(n + na, n + na + nb), slice(n + na + nb, size)
        PM = P @ self.M
        Q[:n, :n] = (PM + PM.T + alpha * P) / 2
        Q[:n, a], Q[:n, b], Q[:n, y] = P @ self.Ua / 2, P @ self.Ub / 2, P @ self.Uy / 2
        for weight, (We, Wy) in self._weighted(lam):
            Q[:n, :n] += weight * (We.T @ We)
            Q[:n, y] += weight * (We.T @ Wy)
            Q[y, y] += weight * (Wy.T @ Wy)
        Q[a, :n], Q[b, :n], Q[y, :n] = Q[:n, a].T, Q[:n, b].T, Q[:n, y].T
        diagonal = np.arange(n, size)
        Q[diagonal, diagonal] -= np.concatenate([lam, nu, k])
        return Q

    def _weighted(self, lam: np.ndarray) -> list[tuple[Any, tuple[np.ndarray, np.ndarray]]]:
        """What bounds the a-inputs, as rows of e and y, with the weight of its square."""
        if not len(lam):
            return []
        chosen = self.selections or (None,) * len(lam)
        unselected = [v for v, part in zip(lam, chosen, strict=True) if part is None]
        weighted = [(sum(unselected[1:], unselected[0]), (self.Xe, self.Xy))] if unselected else []
        for v, part in zip(lam, chosen, strict=True):
            if part is not None:
                S, T = part
                Wy = S @ self.Xy
                weighted.append((v, (S @ self.Xe, Wy if T is None else Wy + T)))
        return weighted

    def leakage(self, alpha: Any) -> Any:
        """q(alpha) of :meth:`Adaptation.leakage_cost`; 0 without estimates."""
        return 0 if self.adaptation is None else self.adaptation.leakage_cost(alpha)

    def homogeneous(self, strength: Any) -> ErrorProblem:
        """Only the a-inputs, with tau scaled: what decides whether any certificate exists."""
        n = self.n
        none = self.Ub[:, :0]
        selections = tuple(None if part is None else (part[0], None) for part in self.selections)
        return replace(
            self,
            selections=selections,
            Ua=self.Ua * strength,
            Ub=none,
            Uy=none,
            Xy=np.zeros((n, 0), dtype=self.M.dtype),
            states=(self.states[0], ()),
            derivatives=(),
        )

    def in_floats(self) -> ErrorProblem:
        """The same problem in floating point, with the same structure."""
        arrays = {
            name: getattr(self, name).astype(float) for name in ("M", "Ua", "Ub", "Uy", "Xe", "Xy")
        }
        adaptation = None if self.adaptation is None else self.adaptation.in_floats()

        def floats(matrix: np.ndarray | None) -> Any:
            return None if matrix is None else matrix.astype(float)

        selections = tuple(
            None if part is None else (floats(part[0]), floats(part[1])) for part in self.selections
        )
        return replace(self, **arrays, adaptation=adaptation, selections=selections)
