"""The cost for which a law is optimal, where its input enters freely.

Backstepping leaves e' = M_0 e + e_n v, where M_0 is the error matrix with 0 in the place of its
last decay rate, and takes v = -(c_n + kappa_n) e_n. With the weights s_i of the balanced recursion
(1 in the paper's) and V = sum s_i^2 e_i^2, that v minimises

    J = int [2 sum_{i<n} (c_i + kappa_i) s_i^2 e_i^2 + c s_n^2 e_n^2 + s_n^2 v^2/c] dt = V(e(0))

with c = c_n + kappa_n: V' = -2 sum_{i<n} (c_i + kappa_i) s_i^2 e_i^2 + 2 s_n^2 e_n v, because all
else in M_0 is skew, and so V' + (what stands in the integral) = s_n^2 (v + c e_n)^2/c, which is
zero for this v and positive for any other. A linear law from weights has the cost of its weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certrack.laws.backstepping import ErrorCoordinates
from certrack.laws.base import Law
from certrack.laws.linear import Linear
from certrack.model.plant import Plant


@dataclass(frozen=True)
class Cost:
    """int (sum state_i e_i^2 + input v^2) dt, which the law minimises where w = 0.

    Attributes
    ----------
    state : (n,) array
        Weights of e_1 ... e_n.
    input : float
        Weight of v.
    of_states : (n, n) array
        A^T diag(state) A: the same weights in x - x_d, with x_d = A^-1 B Y.
    """

    state: np.ndarray
    input: float
    of_states: np.ndarray


def optimal_cost(law: Law, plant: Plant, coordinates: ErrorCoordinates) -> Cost | None:
    """The cost of a law; None for a linear law whose K was given.

    Parameters
    ----------
    law : Law
    plant : Plant
    coordinates : ErrorCoordinates
        Of the law for the plant.
    """
    n = coordinates.n
    if isinstance(law, Linear):
        if law.lqr is None:
            return None
        state = law.lqr.diagonal(n)
        return Cost(state, law.lqr.input / law.known_gain(plant) ** 2, np.diag(state))
    squares = np.ones(n) if coordinates.weights is None else coordinates.weights**2
    decay = coordinates.c + coordinates.kappa
    state = squares * decay * np.append(np.full(n - 1, 2.0), 1.0)
    return Cost(state, float(squares[-1] / decay[-1]), coordinates.A.T * state @ coordinates.A)


def freed_loop(coordinates: ErrorCoordinates) -> tuple[np.ndarray, np.ndarray]:
    """M_0 and k of the loop that v = -k e closes: e' = M_0 e + e_n v.

    Of a linear law v = K xi is all that nu does; of the recursion, what is left of it when the
    terms that cancel are taken away.
    """
    k = coordinates.input_feedback
    freed = coordinates.error_matrix.copy()
    freed[-1] = freed[-1] + k
    return freed, k
