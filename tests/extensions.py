"""Laws and a reference as the cells of a notebook define them, for the tests of what users add."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from scipy.interpolate import BPoly, PPoly, make_interp_spline

import certrack
from certrack import references
from certrack.laws import (
    Equations,
    Law,
    OwnErrors,
    Plant,
    Signals,
    dot,
    gain,
    register,
    symbol,
)


@register
@dataclass(frozen=True, kw_only=True)
class DynamicSurface(Law):
    """Dynamic surface control of example1: a filter instead of the derivative of the virtual law.

    z_1 = x1 - y_d,  alpha = (-c_1 z_1 - b_11 x1 + y_d')/g_1,  filter' = (alpha - filter)/T_f
    u = (-c_2 (x2 - filter) - g_1 z_1 + filter' - h - phi^T theta)/g_n
    """

    kind = "dynamic-surface"
    filter_time: float = gain(above=0, default=0.05, unit="s", help="time constant of the filter")
    filter0: float = gain(default=0.0, help="initial value of the filter")

    def equations(self, s: Signals) -> Equations:
        c, g, b = s.parameters("c", 2), s.parameter("g_1"), s.parameter("b_11")
        g_n, theta, T_f = s.parameter("g_n"), s.parameters("theta", s.r), s.parameter("filter_time")
        held = symbol("alpha_filter")
        z_1 = s.x[0] - s.Y[0]
        alpha = (-c[0] * z_1 - b * s.x[0] + s.Y[1]) / g
        rate = (alpha - held) / T_f
        drift = s.plant.drift.expr + dot(s.phi, theta)
        u = (-c[1] * (s.x[1] - held) - g * z_1 + rate - drift) / g_n
        return Equations(u, ((held, rate),), filters=(held,))

    def error_system(self, s: Signals) -> OwnErrors:
        g, b = s.plant.chain[0].expr, s.plant.linear[0][0].expr
        held, z_1 = symbol("alpha_filter"), s.x[0] - s.Y[0]
        z_2 = s.x[1] - held
        alpha = (-self.c[0] * z_1 - b * s.x[0] + s.Y[1]) / g
        z_1_rate = -self.c[0] * z_1 + g * (z_2 + held - alpha)
        return OwnErrors((z_1, z_2), (z_1_rate, -self.c[1] * z_2 - g * z_1))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        return {
            "c": self.c,
            "g_1": float(plant.chain[0].expr),
            "b_11": float(plant.linear[0][0].expr),
            "g_n": float(plant.input_gain.expr),
            "theta": [float(value.expr) for value in plant.theta],
            "filter_time": self.filter_time,
        }

    def initial_states(self, plant: Plant) -> Mapping[str, float]:
        return {"alpha_filter": self.filter0}


@register
@dataclass(frozen=True, kw_only=True)
class PrescribedPerformance(Law):
    """|e_1| < rho(t) = (rho_0 - rho_end) exp(-a t) + rho_end, by a logarithmic barrier.

    xi = e_1/rho,  eps = log((1 + xi)/(1 - xi)),  alpha = -k_1 eps
    u = -sign(g_n) (k_2 (x2 - alpha) + w),  w' = k_w tanh(x2 - alpha) - sigma (w - w_0)
    """

    kind = "prescribed-performance"
    rho_0: float = gain(above=0, default=3.0, help="bound of |e_1| at the start")
    rho_end: float = gain(above=0, default=0.2, help="bound of |e_1| in the end")
    speed: float = gain(above=0, default=1.0, unit="1/s", help="how fast the bound shrinks")
    k_1: float = gain(above=0, default=1.0, help="gain of the barrier")
    k_2: float = gain(above=0, default=20.0, help="gain of the input")
    k_w: float = gain(above=0, default=2.0, help="rate of the bias")
    sigma: float = gain(above=0, default=0.5, unit="1/s", help="leak of the bias")
    w_0: float = gain(default=0.25, help="prior guess and initial value of the bias")

    GAINS = ("rho_0", "rho_end", "speed", "k_1", "k_2", "k_w", "sigma", "w_0")

    def equations(self, s: Signals) -> Equations:
        rho_0, rho_end, speed, k_1, k_2, k_w, sigma, w_0 = map(s.parameter, self.GAINS)
        bias = symbol("bias")
        rho = (rho_0 - rho_end) * sympy.exp(-speed * s.t) + rho_end
        xi = (s.x[0] - s.Y[0]) / rho
        alpha = -k_1 * sympy.log((1 + xi) / (1 - xi))
        error = s.x[1] - alpha
        u = -s.sign_g * (k_2 * error + bias)
        return Equations(u, ((bias, k_w * sympy.tanh(error) - sigma * (bias - w_0)),))

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        return {name: getattr(self, name) for name in self.GAINS}

    def initial_states(self, plant: Plant) -> Mapping[str, float]:
        return {"bias": self.w_0}


@references.register("spline")
@dataclass(frozen=True)
class Spline(references.Reference):
    """Quintic spline through points, at rest before the first and after the last one."""

    times: tuple[float, ...] = references.key("numbers", help="increasing times", unit="s")
    points: tuple[float, ...] = references.key("numbers", help="y_d then", shape="one per time")

    def __post_init__(self) -> None:
        references.check_fields(self, "reference")
        if len(self.points) != len(self.times) or np.any(np.diff(self.times) <= 0):
            raise references.InputError("reference.points", "must be one per increasing time")

    @property
    def order(self) -> float:
        return 3  # at both ends the third derivative jumps

    @cached_property
    def _polynomials(self) -> PPoly:
        rest = [(1, 0.0), (2, 0.0)]
        spline = make_interp_spline(self.times, self.points, k=5, bc_type=(rest, rest))
        return PPoly.from_spline(spline)

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        inside = np.clip(t, self.times[0], self.times[-1])
        rows = [self._polynomials(inside, i) for i in range(order + 1)]
        rows[1:] = [np.where((t >= self.times[0]) & (t < self.times[-1]), r, 0) for r in rows[1:]]
        return np.array(rows)

    def bounds(self, order: int) -> references.Bounds:
        pieces = [
            self._polynomials.derivative(i) if i else self._polynomials for i in range(order + 1)
        ]
        hulls = (np.abs(BPoly.from_power_basis(piece).c).max() for piece in pieces)  # Bernstein
        bounds = tuple(references.round_up(float(hull) * (1 + 1e-9)) for hull in hulls)
        return references.Bounds(bounds, ("proven",) * (order + 1))

    def breaks(self, start: float, end: float) -> np.ndarray:
        times = np.array(self.times)
        return times[(times > start) & (times < end)]

    @property
    def piece_symbols(self) -> tuple[sympy.Symbol, ...]:
        return tuple(map(symbol, ("piece_start", *(f"piece_a{k}" for k in range(6)))))

    def piece_values(self, t: float) -> np.ndarray:
        t = t * (1 + 1e-12) + 1e-12
        if not self.times[0] <= t < self.times[-1]:
            return np.array([0.0, self.points[0 if t < self.times[0] else -1], *[0.0] * 5])
        k = np.searchsorted(self._polynomials.x, t, side="right") - 1
        return np.array([self._polynomials.x[k], *self._polynomials.c[::-1, k]])

    def formulas(self, order: int) -> tuple[sympy.Expr, ...]:
        start, *a = self.piece_symbols
        signal = sum(a[k] * (references.TIME - start) ** k for k in range(1, 6)) + a[0]
        return tuple(sympy.diff(signal, references.TIME, i) for i in range(order + 1))


def _example1(law: Law, **changes: Any) -> certrack.System:
    system = certrack.load("example1")
    plant = replace(system.plant, input_gain=2, theta=[2])
    return system.replace(plant=plant, law=law, **changes).with_settings(duration=5, x0=(1, 0))


def dynamic_surface(**changes: Any) -> certrack.System:
    return _example1(DynamicSurface(c=(4, 8), filter0=0.5), **changes)


def prescribed_performance(**changes: Any) -> certrack.System:
    return _example1(PrescribedPerformance(c=(1, 1)), **changes)


def spline(**changes: Any) -> certrack.System:
    reference = Spline(times=(0.5, 1.5, 2.5, 4.0), points=(0.0, 0.3, -0.2, 0.1))
    system = certrack.load("example1").with_settings(duration=5)
    return system.replace(reference=reference, **changes)


SYSTEMS = {
    "dynamic-surface": dynamic_surface,
    "prescribed-performance": prescribed_performance,
    "spline": spline,
}
