"""Super-twisting: a sliding mode of the second order, whose input is continuous."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.laws.base import gain
from certrack.laws.baselines.base import (
    Baseline,
    deviations,
    equivalent_feedback,
    known_input,
    sliding_row,
)
from certrack.laws.equations import Equations
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class SuperTwisting(Baseline):
    """Super-twisting control, smooth within a layer.

    u  = (nu_eq - k_1 sigma/(sigma^2 + layer^2)^(1/4) + w - phi^T theta)/g_n,    sigma = S xi
    w' = -k_2 sigma/sqrt(sigma^2 + layer^2)
    """

    kind = "super-twisting"
    tuned = ("rate", "k_1", "k_2", "layer")
    slower = "lower law.k_1 or raise law.layer"

    rate: float = gain(above=0, default=3.0, unit="1/s", help="decay of the error on the surface")
    k_1: float = gain(above=0, default=5.0, help="gain of the root of sigma")
    k_2: float = gain(above=0, default=2.0, unit="1/s", help="gain of the integrated sign")
    layer: float = gain(above=0, default=0.1, help="sigma below which both are smooth")

    def feedback(self, plant: Plant) -> np.ndarray:
        row = sliding_row(plant, self.rate)
        return equivalent_feedback(plant, row) - self.k_1 / np.sqrt(self.layer) * row

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        return {"rate": rate, "k_1": self.k_1, "k_2": self.k_2, "layer": self.layer}

    def equations(self, s: Signals) -> Equations:
        _, k_1, k_2, layer = map(s.parameter, self.tuned)
        w = symbol("twisting_integral")
        sigma = dot(s.parameters("S", len(s.x)), deviations(s))
        size = sympy.sqrt(sigma**2 + layer**2)
        linear = k_1 * sigma / sympy.sqrt(layer)  # is in nu
        nu = s.nu + linear - k_1 * sigma / sympy.sqrt(size) + w
        return Equations(known_input(s, nu), ((w, -k_2 * sigma / size),))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        return {**super().parameters(plant), "S": sliding_row(plant, self.rate)}
