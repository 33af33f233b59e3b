"""Coordinates of the plant, which every linear law shares: xi = x - Pi Y, Y = (y_d ... y_d^(q)).

The rows of Pi are the states of a plant that follows the reference exactly, as far as q derivatives
tell them:

    Pi_1 = (1, 0 ... 0),   g_i Pi_{i+1} = D Pi_i - sum_{j<=i} b_ij Pi_j

where D differentiates, and drops y_d^(q+1). No gain stands in them, so with nu = K xi + Pi_n D Y +
r y_d^(q+1) (for D Y up to y_d^(q))

    xi' = [F; K] xi + sum tau_k I_k w_k - R y_d^(q+1),   R_i = Pi_iq for i < n,   R_n = Pi_nq - r

Every lean backstepping law is one K and one r here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certrack.laws.backstepping import ErrorCoordinates
from certrack.model.plant import Plant


@dataclass(frozen=True)
class PlantCoordinates(ErrorCoordinates):
    """Error coordinates with A = I and B = Pi; c, kappa and the weights are none."""

    @cached_property
    def R(self) -> np.ndarray:
        residual = self.B[:, self.q].copy()
        residual[-1] = residual[-1] - self.nu_Y[-1]
        return residual

    @cached_property
    def error_matrix(self) -> np.ndarray:
        """[F; K]."""
        return np.vstack([self.F, self.nu_x])

    @property
    def input_feedback(self) -> np.ndarray:
        return -self.nu_x


def plant_coordinates(
    g: np.ndarray, b: np.ndarray, K: np.ndarray, r: Any, q: int
) -> PlantCoordinates:
    """The coordinates for one feedback, in the arithmetic of the arguments.

    Parameters
    ----------
    g, b, q
        As in :func:`certrack.laws.recursion.recursion`.
    K : (n,) array
        nu_x.
    r : number
        Coefficient of y_d^(q+1) in nu.
    """
    n = len(g) + 1
    F = b + np.eye(n - 1, n, 1, dtype=b.dtype) * g[:, None]
    Pi = np.zeros((n, q + 1), dtype=b.dtype)
    Pi[0, 0] = 1
    for i in range(n - 1):
        row = -(b[i] @ Pi)
        row[1:] = row[1:] + Pi[i, :-1]
        Pi[i + 1] = row / g[i]
    nu_Y = np.append(-(K @ Pi), r)
    nu_Y[1:-1] = nu_Y[1:-1] + Pi[-1, :-1]
    none = np.zeros(n, dtype=b.dtype)
    return PlantCoordinates(np.eye(n, dtype=b.dtype), Pi, F, none, none, g, K, nu_Y)


def balancing_feedforward(g: np.ndarray, b: np.ndarray, K: np.ndarray, q: int) -> float:
    """r for which a constant y_d^(q+1) moves x_1 by nothing: e_1^T [F; K]^-1 R = 0.

    At q = n - 1 that is Pi_nq, where nothing is left of y_d^(q+1) at all.
    """
    without = plant_coordinates(g, b, K, 0.0, q)
    unit = np.eye(len(K))[:, -1]
    through = np.linalg.solve(without.error_matrix, np.stack([without.R, unit], axis=1))[0]
    return float(through[0] / through[1])


def output_derivatives(plant: Plant) -> np.ndarray:
    """Rows that give y, y' ... y^(n-1) of the states, where nothing uncertain acts: (n, n)."""
    F = np.zeros((plant.n, plant.n))
    F[:-1] = plant.b
    F[range(plant.n - 1), range(1, plant.n)] += plant.g
    rows = [np.eye(plant.n)[0]]
    for _ in range(plant.n - 1):
        rows.append(rows[-1] @ F)
    return np.array(rows)
