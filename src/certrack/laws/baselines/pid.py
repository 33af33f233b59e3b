"""PID: the output's error, its integral and its filtered derivative; the model feeds forward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.laws.base import gain
from certrack.laws.baselines.base import (
    Baseline,
    followed_states,
    highest_gain,
    placed_feedback,
)
from certrack.laws.equations import Equations
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Pid(Baseline):
    """PID with feed-forward.

        u  = u_ff + sign(g_n) (k_p e + w + k_d (e - f)/T_f),    e = y_d - x_1
        w' = k_i e,    f' = (e - f)/T_f
        u_ff = (Pi_n (y_d' ... y_d^(q+1)) - h(Pi Y) - phi(Pi Y)^T theta)/g_n

    Only the output is fed back; f begins at the first e.
    """

    kind = "pid"
    tuned = ("k_p", "k_i", "k_d", "filter_time")
    slower = "raise law.filter_time"

    k_p: float = gain(above=0, default=10.0, help="gain of the error")
    k_i: float = gain(above=0, default=1.0, help="gain of its integral")
    k_d: float = gain(above=0, default=1.0, help="gain of its derivative")
    filter_time: float = gain(
        above=0, default=0.02, unit="s", help="time constant of the derivative's filter"
    )

    def feedback(self, plant: Plant) -> np.ndarray:
        return placed_feedback(plant, 1.0 / self.filter_time)

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        """The last coefficients of (D + rate)^(n+1) int e dt: with n = 2 all poles are there."""
        n, b_0 = plant.n, highest_gain(plant, self.known_gain(plant))
        k_i, k_p, k_d = (comb(n + 1, i) * rate ** (n + 1 - i) / b_0 for i in range(3))
        return {"k_p": k_p, "k_i": k_i, "k_d": k_d, "filter_time": 0.1 / rate}

    def equations(self, s: Signals) -> Equations:
        k_p, k_i, k_d, T_f = map(s.parameter, self.tuned)
        integrated, filtered = symbol("pid_integral"), symbol("pid_filter")
        e = s.Y[0] - s.x[0]
        slope = (e - filtered) / T_f
        at = dict(zip(s.x, followed_states(s), strict=True))
        known = sum(
            (f * v for f, v in zip(s.phi, s.parameters("theta", s.r), strict=True)),
            s.plant.drift.expr,
        )
        rates = dot(s.parameters("Pi_n", s.q + 1), s.Y[1:])
        u_ff = (rates - sympy.sympify(known).subs(at, simultaneous=True)) / s.parameter("g_n")
        u = u_ff + s.sign_g * (k_p * e + integrated + k_d * slope)
        update = ((integrated, k_i * e), (filtered, slope))
        return Equations(u, update, (filtered,), ((filtered, e),))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        numbers = super().parameters(plant)
        return {**numbers, "Pi_n": numbers["Pi"][-1]}
