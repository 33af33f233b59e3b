"""Robust law: theta and the input gain are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from certrack.core.errors import DesignError
from certrack.core.rationals import float_of
from certrack.laws.base import Law
from certrack.laws.equations import Equations
from certrack.laws.error_system import KnownParameters
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Robust(Law):
    """Backstepping for known parameters (Corollary 1; [54] is Example 2's).

    u = (nu - phi^T theta) / g_n
    """

    kind = "robust"
    moving: ClassVar[tuple[str, ...]] = ("c",)

    def equations(self, s: Signals) -> Equations:
        g_n, theta = s.parameter("g_n"), s.parameters("theta", s.r)
        return Equations(u=(s.nu - dot(s.phi, theta)) / g_n)

    def error_system(self, s: Signals) -> KnownParameters | None:
        return KnownParameters(s.parameter("g_n"), s.parameters("theta", s.r))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        g_n = self.known_gain(plant)
        if plant.theta is None and plant.r:
            raise DesignError(
                "plant.theta", f"the {self.kind} law must know theta", remedy=_REMEDY_FOR_UNKNOWN
            )
        theta = [float_of(value.expr) for value in plant.theta or ()]
        return {"g_n": g_n, "theta": theta}

    def known_gain(self, plant: Plant) -> float:
        """g_n, which the plant must state."""
        if plant.input_gain is None:
            raise DesignError(
                "plant.input_gain",
                f"the {self.kind} law must know g_n",
                remedy=_REMEDY_FOR_UNKNOWN,
            )
        return float_of(plant.input_gain.expr)


_REMEDY_FOR_UNKNOWN = 'State it, or use kind = "adaptive"'
