"""Active disturbance rejection: an observer extended by the total disturbance, of the output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from certrack.core.expressions import symbol
from certrack.laws.base import gain
from certrack.laws.baselines.base import Baseline, placed_feedback
from certrack.laws.equations import Equations
from certrack.laws.plant_coordinates import output_derivatives
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Adrc(Baseline):
    """Linear active disturbance rejection control (LADRC).

        z_i' = z_{i+1} + l_i (x_1 - z_1),  z_n' = z_{n+1} + b_0 u + l_n (x_1 - z_1),
        z_{n+1}' = l_{n+1} (x_1 - z_1),    b_0 = g_n g_1 ... g_{n-1}
        b_0 u = y_d^(n) + sum a_i (y_d^(i) - z_{i+1}) - z_{n+1}

    Poles of the control are at -rate, those of the observer at -observer_rate. Only the output is
    fed back; derivatives of y_d beyond feedforward + 1 are taken as zero. The observer gets u as
    the drive limits it, and z_1 begins at the first x_1.
    """

    kind = "adrc"
    tuned = ("rate", "observer_rate")
    slower = "lower law.observer_rate"

    rate: float = gain(above=0, default=3.0, unit="1/s", help="poles of the control")
    observer_rate: float = gain(above=0, default=20.0, unit="1/s", help="poles of the observer")

    def feedback(self, plant: Plant) -> np.ndarray:
        return placed_feedback(plant, self.rate)

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        return {"rate": rate, "observer_rate": 5 * rate}

    def equations(self, s: Signals) -> Equations:
        n = len(s.x)
        z = [symbol(f"adrc_z{i + 1}") for i in range(n + 1)]
        b_0, a, length = s.parameter("b_0"), s.parameters("a", n), s.parameters("l", n + 1)
        wanted = [*s.Y, *[0] * n][: n + 1]  # y_d ... y_d^(n)
        parts = [y - estimate for y, estimate in zip(wanted[:n], z, strict=False)]
        u = (wanted[n] + dot(a, parts) - z[n]) / b_0
        miss = s.x[0] - z[0]
        rates = [after + gain_ * miss for after, gain_ in zip([*z[1:], 0], length, strict=True)]
        rates[n - 1] += b_0 * s.applied
        return Equations(u, tuple(zip(z, rates, strict=True)), tuple(z), ((z[0], s.x[0]),))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        n = plant.n
        numbers = super().parameters(plant)
        return {
            **numbers,
            "b_0": numbers["g_n"] * output_derivatives(plant)[-1, -1],
            "a": [comb(n, i) * self.rate ** (n - i) for i in range(n)],
            "l": [comb(n + 1, i + 1) * self.observer_rate ** (i + 1) for i in range(n + 1)],
        }
