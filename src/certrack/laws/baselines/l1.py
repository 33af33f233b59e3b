"""L1 adaptive control: a fast estimate of the disturbance, of which the input gets a slow part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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
class L1Adaptive(Baseline):
    """L1 adaptive control of the matched disturbance.

        u  = (nu - v - phi^T theta)/g_n,    v' = filter_rate (sigma - v)
        p' = K xi - v + g_n (u_a - u) + sigma - (p - xi_n),    sigma = -adaptation (p - xi_n)

    u_a is u within the limits of the drive, and p begins at the first xi_n. p predicts xi_n, sigma
    estimates what moves it besides, and the filter keeps noise of the estimate from the input. K is
    from :class:`certrack.laws.lqr.LqrWeights`.
    """

    kind = "l1"
    tuned = ("weight", "adaptation", "filter_rate")
    slower = "lower law.weight"

    weight: float = gain(above=0, default=100.0, help="weight of x_1 - y_d against the input's")
    adaptation: float = gain(above=0, default=50.0, unit="1/s", help="rate of the estimate")
    filter_rate: float = gain(
        above=0, default=10.0, unit="1/s", help="bandwidth of the filter before the input"
    )

    def feedback(self, plant: Plant) -> np.ndarray:
        return weighted_feedback(self.weight, plant, self.known_gain(plant))

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        weight = weight_at(plant, self.known_gain(plant), rate)
        return {"weight": weight, "adaptation": 10 * rate, "filter_rate": 3 * rate}

    def equations(self, s: Signals) -> Equations:
        _, adaptation, filter_rate = map(s.parameter, self.tuned)
        predicted, filtered = symbol("l1_prediction"), symbol("l1_filter")
        xi = deviations(s)
        miss = predicted - xi[-1]
        sigma = -adaptation * miss
        u = known_input(s, s.nu - filtered)
        cut = s.parameter("g_n") * (s.applied - u)
        rate = dot(s.parameters("nu_x", len(xi)), xi) - filtered + cut + sigma - miss
        update = ((predicted, rate), (filtered, filter_rate * (sigma - filtered)))
        return Equations(u, update, (predicted, filtered), ((predicted, xi[-1]),))
