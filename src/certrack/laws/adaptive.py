"""Adaptive law: theta and the size of the input gain are unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from certrack.core.expressions import symbol
from certrack.laws.base import Law, gain, theta_metric, theta_vector
from certrack.laws.equations import Equations
from certrack.laws.error_system import EstimatedParameters
from certrack.laws.numbers import metric, vector
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Adaptive(Law):
    """Adaptive backstepping with leakage [25], [26]; [47] is Example 1's.

        u          = delta_hat ubar,     ubar = nu - phi^T theta_hat
        delta_hat' = -gbar sign(g_n) ubar e_n - gbar gbar1 (delta_hat - delta_0)
        theta_hat' =  Gamma phi e_n - Gamma gbar2 (theta_hat - theta_0)

    delta_hat estimates 1/g_n.

    Parameters
    ----------
    gain_rate : float > 0
        gbar, adaptation gain of delta_hat.
    leak_gain, leak_theta : float > 0
        gbar1, gbar2: leakage towards the prior guesses; it keeps the estimates bounded.
    delta0 : float
        Prior guess of 1/g_n.
    theta0 : r numbers, optional
        Prior guess of theta.
    Gamma : r positive numbers or an r x r positive definite matrix, optional
        Adaptation gain of theta_hat; identity if left out.
    """

    kind = "adaptive"
    moving = ("c_n", "gain_rate", "leak_gain", "leak_theta", "Gamma")

    gain_rate: float = gain(above=0, default=1.0, help="adaptation gain of delta_hat")
    leak_gain: float = gain(above=0, default=0.1, help="leakage of delta_hat towards delta0")
    leak_theta: float = gain(above=0, default=0.1, help="leakage of theta_hat towards theta0")
    delta0: float = gain(default=0.0, help="prior guess of 1/g_n: set it near 1/g_n")
    theta0: tuple[float, ...] | None = theta_vector(help="prior guess of theta")
    Gamma: Any = theta_metric(help="adaptation gain of theta_hat: a diagonal or a full matrix")

    def equations(self, s: Signals) -> Equations:
        gbar, gbar1, gbar2 = map(s.parameter, ("gain_rate", "leak_gain", "leak_theta"))
        delta0, theta0 = s.parameter("delta0"), s.parameters("theta0", s.r)
        Gamma = s.parameters("Gamma", s.r, s.r)
        delta_hat = symbol("delta_hat")
        theta_hat = [symbol(f"theta_hat_{i + 1}") for i in range(s.r)]

        ubar = s.nu - dot(s.phi, theta_hat)  # [25]
        delta_rate = -gbar * s.sign_g * ubar * s.e_n - gbar * gbar1 * (delta_hat - delta0)  # [26]
        drive = [s.phi[i] * s.e_n - gbar2 * (theta_hat[i] - theta0[i]) for i in range(s.r)]
        theta_rate = [dot(Gamma[i * s.r : (i + 1) * s.r], drive) for i in range(s.r)]  # [26]
        update = ((delta_hat, delta_rate), *zip(theta_hat, theta_rate, strict=True))
        return Equations(u=delta_hat * ubar, update=update)

    def error_system(self, s: Signals) -> EstimatedParameters:
        Gamma = s.parameters("Gamma", s.r, s.r)
        return EstimatedParameters(
            delta_hat=symbol("delta_hat"),
            gain_rate=s.parameter("gain_rate"),
            leak_gain=s.parameter("leak_gain"),
            leak_theta=s.parameter("leak_theta"),
            delta0=s.parameter("delta0"),
            theta_hat=[symbol(f"theta_hat_{i + 1}") for i in range(s.r)],
            theta0=s.parameters("theta0", s.r),
            Gamma=[Gamma[i * s.r : (i + 1) * s.r] for i in range(s.r)],
        )

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        return {
            "gain_rate": self.gain_rate,
            "leak_gain": self.leak_gain,
            "leak_theta": self.leak_theta,
            "delta0": self.delta0,
            "theta0": vector("law.theta0", self.theta0, plant.r),
            "Gamma": metric("law.Gamma", self.Gamma, plant.r),
        }
