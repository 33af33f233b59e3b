"""Sliding modes with a boundary layer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

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
class SlidingMode(Baseline):
    """Sliding mode control.

        u = (nu_eq - k tanh(sigma/layer) - phi^T theta)/g_n,    sigma = S xi

    On sigma = 0 the error decays as (D + rate)^(n-1) e_1 = 0, and nu_eq holds sigma where it is.
    """

    kind = "smc"
    tuned = ("rate", "switching", "layer")
    slower = "lower law.switching/law.layer"

    rate: float = gain(above=0, default=3.0, unit="1/s", help="decay of the error on the surface")
    switching: float = gain(above=0, default=5.0, help="size of the switched part of nu")
    layer: float = gain(above=0, default=0.5, help="width of the boundary layer of sigma")

    def feedback(self, plant: Plant) -> np.ndarray:
        row = sliding_row(plant, self.rate)
        linearised: np.ndarray = equivalent_feedback(plant, row)
        return linearised - self.switching / self.layer * row

    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        return {"rate": rate, "switching": self.switching, "layer": self.layer}

    def equations(self, s: Signals) -> Equations:
        _, switching, layer = map(s.parameter, self.tuned)
        sigma = dot(s.parameters("S", len(s.x)), deviations(s))
        beyond = switching * (sigma / layer - sympy.tanh(sigma / layer))  # than the linear part
        return Equations(known_input(s, s.nu + beyond))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        return {**super().parameters(plant), "S": sliding_row(plant, self.rate)}
