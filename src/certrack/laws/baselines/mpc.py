"""Model predictive control of the linear chain, with limits of the input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from certrack.core.errors import InputError
from certrack.core.keys import keyed
from certrack.laws.base import gain
from certrack.laws.baselines.base import Baseline, chain_rows, known_input, weight_at
from certrack.laws.equations import Equations
from certrack.laws.signals import Signals
from certrack.model.plant import Plant

if TYPE_CHECKING:
    from certrack.laws.base import Law
    from certrack.model.implementation import Implementation

#: Moves of the input in a plan.
MOVES = 20

#: What a plan needs that formulas cannot say.
NO_FORMULA = "solves a quadratic program at every sample, which no formula states"


@dataclass(frozen=True, kw_only=True)
class Mpc(Baseline):
    """Linear model predictive control with preview of the reference.

        min  sum_j h (weight xi_{1,j}^2 + u_{xi,j}^2) + xi_N^T P xi_N,    h = horizon/N, N = 20
        xi_{j+1} = exp(F h) xi_j + ... u_{xi,j},    low <= u_{ff,j} + u_{xi,j} <= high

    xi = x - Pi Y along the reference to come; h(x) and phi(x)^T theta stay in a plan what they are
    at its sample. P solves Riccati's equation. Without limits the first move is therefore a linear
    feedback K xi, for every N, and the law is that formula. With limits, those of `input_limit` or
    of the saturation, a sampled controller solves the program at every sample where the plan of the
    formula meets them, and applies the first move.
    """

    kind = "mpc"
    tuned = ("weight", "horizon")
    slower = "lower law.weight"

    weight: float = gain(above=0, default=100.0, help="weight of x_1 - y_d against the input's")
    horizon: float = gain(above=0, default=1.0, unit="s", help="length of a plan of 20 moves")
    input_limit: float | None = keyed(
        "number",
        None,
        help="largest |u| of a plan (sampled)",
        above=0,
        otherwise="the saturation, if any",
    )

    def feedback(self, plant: Plant) -> np.ndarray:
        return self.plan_matrices(plant)[2]

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        weight = weight_at(plant, self.known_gain(plant), rate)
        return {"weight": weight, "horizon": 3 / rate}

    def plan_matrices(self, plant: Plant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and K of the moves: xi_{j+1} = A xi_j + B v_j with v = g_n u_xi, and v_j = K xi_j.

        Parameters
        ----------
        plant : Plant

        Raises
        ------
        InputError
            If Riccati's equation has no solution in floating point.
        """
        from scipy.linalg import expm, solve_discrete_are

        n, step, g_n = plant.n, self.horizon / MOVES, self.known_gain(plant)
        block = np.zeros((n + 1, n + 1))
        block[: n - 1, :n], block[n - 1, n] = chain_rows(plant), 1.0
        moved = expm(step * block)
        A, B = moved[:n, :n], moved[:n, n:]
        Q, R = np.zeros((n, n)), np.array([[step / g_n**2]])
        Q[0, 0] = step * self.weight
        try:
            P = solve_discrete_are(A, B, Q, R)
        except (np.linalg.LinAlgError, ValueError):
            message = "has no feedback with this weight and horizon"
            raise InputError("law.weight", message, self.weight, "Choose others") from None
        K = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        return A, B[:, 0], K[0]

    def equations(self, s: Signals) -> Equations:
        return Equations(known_input(s, s.nu))


def planned_limits(law: Law, implementation: Implementation | None) -> tuple[float, float] | None:
    """Limits of the input that plans of the law keep; None where it is a formula.

    Parameters
    ----------
    law : Law
    implementation : Implementation or None

    Returns
    -------
    (low, high) or None

    Raises
    ------
    InputError
        If such plans cannot be made.
    """
    if not isinstance(law, Mpc):
        return None
    if implementation is None:
        if law.input_limit is None:
            return None
        remedy = "Add a table [implementation], or leave the limit out"
        raise InputError("law.input_limit", "needs a sampled controller", remedy=remedy)
    low, high = implementation.saturation or (-np.inf, np.inf)
    if law.input_limit is not None:
        low, high = max(low, -law.input_limit), min(high, law.input_limit)
    if not np.isfinite([low, high]).any():
        return None
    if low >= high:
        raise InputError("law.input_limit", "leaves nothing of the saturation", law.input_limit)
    for key, value in (
        ("implementation.rate_limit", implementation.rate_limit),
        ("law.observer", law.observer),
    ):
        if value is not None:
            remedy = "Leave it out, or the limits of the input"
            raise InputError(key, "is not known to the plans of the mpc law", remedy=remedy)
    return float(low), float(high)


def require_formula(law: Law, implementation: Implementation | None, purpose: str) -> None:
    """Refuse a law that is more than its formulas.

    Raises
    ------
    InputError
    """
    if planned_limits(law, implementation) is not None:
        remedy = "Leave out law.input_limit and the saturation: then it is a linear feedback"
        raise InputError("law.kind", f"mpc {NO_FORMULA}: no {purpose}", remedy=remedy)
