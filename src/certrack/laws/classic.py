"""Classic adaptive law: the baseline of the paper's Example 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.laws.base import Law, gain, theta_metric
from certrack.laws.equations import Equations
from certrack.laws.error_system import EstimatedParameters
from certrack.laws.numbers import metric
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Classic(Law):
    """Adaptive backstepping without damping and leakage (Krstic type) [48].

        u          = delta_hat ubar,     ubar = nu - phi^T theta_hat
        delta_hat' = -gbar sign(g_n) ubar e_n
        theta_hat' =  Gamma phi e_n

    All derivatives of y_d up to order n are fed forward (q = n - 1).

    Parameters
    ----------
    gain_rate : float > 0
        gbar, adaptation gain of delta_hat.
    Gamma : r positive numbers or an r x r positive definite matrix, optional
        Adaptation gain of theta_hat; identity if left out.
    """

    kind = "classic"
    no_certificate = (
        "without leakage the estimates may drift under disturbances, so V' <= -alpha V + Delta "
        "does not follow; use the adaptive law"
    )

    gain_rate: float = gain(above=0, default=1.0, help="adaptation gain of delta_hat")
    Gamma: Any = theta_metric(help="adaptation gain of theta_hat: a diagonal or a full matrix")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("k", "p"):
            if getattr(self, name) is not None:
                raise InputError(
                    f"law.{name}", "the classic law has no damping", remedy="Remove it"
                )
        if self.feedforward:
            raise InputError("law.feedforward", "the classic law always has n - 1; remove it")

    def order(self, plant: Plant) -> int:
        return plant.n - 1

    def equations(self, s: Signals) -> Equations:
        gbar, Gamma = s.parameter("gain_rate"), s.parameters("Gamma", s.r, s.r)
        delta_hat = symbol("delta_hat")
        theta_hat = [symbol(f"theta_hat_{i + 1}") for i in range(s.r)]

        ubar = s.nu - dot(s.phi, theta_hat)  # [48]
        delta_rate = -gbar * s.sign_g * ubar * s.e_n
        drive = [phi * s.e_n for phi in s.phi]
        theta_rate = [dot(Gamma[i * s.r : (i + 1) * s.r], drive) for i in range(s.r)]
        update = ((delta_hat, delta_rate), *zip(theta_hat, theta_rate, strict=True))
        return Equations(u=delta_hat * ubar, update=update)

    def error_system(self, s: Signals) -> EstimatedParameters:
        """That of the adaptive law without leakage."""
        Gamma, none = s.parameters("Gamma", s.r, s.r), sympy.Integer(0)
        return EstimatedParameters(
            delta_hat=symbol("delta_hat"),
            gain_rate=s.parameter("gain_rate"),
            leak_gain=none,
            leak_theta=none,
            delta0=none,
            theta_hat=[symbol(f"theta_hat_{i + 1}") for i in range(s.r)],
            theta0=[none] * s.r,
            Gamma=[Gamma[i * s.r : (i + 1) * s.r] for i in range(s.r)],
        )

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        return {
            "gain_rate": self.gain_rate,
            "Gamma": metric("law.Gamma", self.Gamma, plant.r),
        }
