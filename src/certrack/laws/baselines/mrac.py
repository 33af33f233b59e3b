"""Model reference adaptive control: gains of states, nu, regressor and a constant are adapted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.core.expressions import symbol
from certrack.laws.base import gain
from certrack.laws.baselines.base import (
    Baseline,
    deviations,
    known_input,
    weight_at,
    weighted_feedback,
)
from certrack.laws.equations import Equations
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Mrac(Baseline):
    """Model reference adaptive control with leakage.

        u   = (nu - k^T psi - phi^T theta)/g_n,    psi = (xi, nu, phi, 1)
        k_i' = adaptation sigma psi_i - leak k_i,    sigma = (P xi)_n

    The reference model is xi' = [F; K] xi with K from :class:`certrack.laws.lqr.LqrWeights`, and
    [F; K]^T P + P [F; K] = -I.
    """

    kind = "mrac"
    tuned = ("weight", "adaptation", "leak")
    slower = "lower law.weight"

    weight: float = gain(above=0, default=100.0, help="weight of x_1 - y_d against the input's")
    adaptation: float = gain(above=0, default=1.0, help="adaptation gain")
    leak: float = gain(above=0, default=0.5, unit="1/s", help="leakage of the adapted gains")

    def feedback(self, plant: Plant) -> np.ndarray:
        return weighted_feedback(self.weight, plant, self.known_gain(plant))

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        weight = weight_at(plant, self.known_gain(plant), rate)
        settled = replace(self, weight=weight)
        # A constant is adapted as k' = adaptation P_nn xi_n, xi_n' = ... - k: an oscillator.
        adaptation = rate**2 / float(settled.parameters(plant)["P_n"][-1])
        return {"weight": weight, "adaptation": adaptation, "leak": rate / 10}

    def equations(self, s: Signals) -> Equations:
        _, adaptation, leak = map(s.parameter, self.tuned)
        xi = deviations(s)
        sigma = dot(s.parameters("P_n", len(xi)), xi)
        psi = [*xi, s.nu, *s.phi, 1]
        k = [symbol(f"mrac_k{i + 1}") for i in range(len(psi))]
        rates = [adaptation * sigma * part - leak * now for part, now in zip(psi, k, strict=True)]
        u = known_input(s, s.nu - dot(k, psi))
        return Equations(u, tuple(zip(k, rates, strict=True)))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        from scipy.linalg import solve_continuous_lyapunov

        model = self.coordinates(plant).error_matrix
        P = solve_continuous_lyapunov(model.T, -np.eye(plant.n))
        return {**super().parameters(plant), "P_n": P[-1]}
