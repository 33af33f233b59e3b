"""The bootstrap of the adaptive law: its equations, its proofs, and what it must refuse."""

import copy
import json
import math

import flint
import numpy as np
import pytest
import sympy

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.arithmetic import positive_definite, rational
from certrack.certificates.bootstrap.box import Ground
from certrack.certificates.bootstrap.certify import certify_bootstrap
from certrack.certificates.bootstrap.forms import forms_of, scaled_ubar
from certrack.certificates.bootstrap.ground import box_of_states, rows_of
from certrack.certificates.bootstrap.loop import adaptive_loop, formulas_of
from certrack.certificates.bootstrap.proof import proven_definite, row_over_box
from certrack.certificates.bootstrap.ranges import Combination, Ranges, largest_reach
from certrack.certificates.bootstrap.rates import Rate
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.document import _digest
from certrack.certificates.exact import from_text

#: A plant with a full Gamma, ranges of g_n < 0 and theta, feed-forward and a full regressor.
RANGED = """
[plant]
states = ["x1", "x2"]
chain = [1.3]
linear = [[-0.4]]
drift = "-0.3*x2 + 0.2*x1**2"
regressor = ["sin(x1)", "1 + x2/4"]
gain_sign = -1
[plant.ranges]
input_gain = [-1.6, -1.4]
theta = [[0.3, 0.5], [-0.4, -0.3]]
[plant.uncertainty]
tau = [0.05, 0.1]
gamma = [0.2, 0.3]
beta = [0.1, 0.2]
[truth]
input_gain = -1.5
theta = [0.4, -0.35]
omega = ["0.1*sin(t)", "0.2*cos(2*t) + 0.3*x2*sin(t)"]
[reference]
signal = "0.2*sin(t)"
[law]
kind = "adaptive"
c = [1.5, 2]
feedforward = 1
gain_rate = 0.8
leak_gain = 0.5
leak_theta = 0.4
delta0 = -0.6
theta0 = [0.3, -0.3]
Gamma = [[1.0, 0.3], [0.3, 0.7]]
[simulation]
x0 = [0.3, 0]
duration = 40
tail = 10
"""

#: The worst error of example1 that any search has found; no bound may be below.
WORST_OF_EXAMPLE1 = 0.0445


def ranged():
    return certrack.loads(RANGED)


@pytest.fixture(scope="module", params=["example1", "ranged"])
def proven(request):
    """A system, its certificate and the proof."""
    system = ranged() if request.param == "ranged" else certrack.load(request.param)
    return (system, *certify_bootstrap(system, "high"))


class ErrorsByHand:
    """z = (e, theta_tilde, d), its rates and ubar at a state, from the plant's and law's formulas.

    The truth's g_n and theta are given; w_k are numbers.
    """

    def __init__(self, system, gain, theta):
        self.system, self.gain, self.theta = system, gain, np.array(theta)
        self.plant, c = system.plant, system.controller
        self.coordinates = c.coordinates
        gains = dict(zip(c.symbols, c.values.tolist(), strict=True))
        s = c.signals
        formulas = [c.equations.u, *(rate for _, rate in c.equations.update)]
        formulas = [f.xreplace(gains) for f in formulas]
        self.law = sympy.lambdify([s.x, s.Y, c.states], formulas, "math")
        values = {sympy.Symbol(k, real=True): v for k, v in self.plant.constant_values.items()}
        rest = [self.plant.drift.expr, *(phi.expr for phi in self.plant.regressor)]
        self.known = sympy.lambdify([s.x], [f.xreplace(values) for f in rest], "math")
        low = min(map(abs, self.plant.input_gain_range or (gain,)))
        self.v = math.sqrt(abs(gain) / low)

    def states(self, z, Y):
        """x and the estimates (delta_hat, theta_hat) of errors z."""
        n, r = self.plant.n, self.plant.r
        A, B = self.coordinates.A, self.coordinates.B
        x = np.linalg.solve(A, z[:n] + B @ Y[: B.shape[1]])
        return x, np.array([1 / self.gain - z[-1] / self.v, *(self.theta - z[n : n + r])])

    def rates(self, z, Y, w):
        """z', given y_d ... y_d^(q+1) and the values of tau_k w_k."""
        x, estimates = self.states(z, Y)
        plant, n = self.plant, self.plant.n
        u, delta_rate, *theta_rates = self.law(x, Y, estimates)
        h, *phi = self.known(x)
        rates = [
            float(plant.g[i]) * x[i + 1]
            + sum(float(b.expr if hasattr(b, "expr") else b) * x[j] for j, b in enumerate(row))
            for i, row in enumerate(plant.linear)
        ]
        rates.append(h + self.gain * u + self.theta @ np.array(phi))
        B = self.coordinates.B
        e = self.coordinates.A @ (np.array(rates) + w) - B @ Y[1 : B.shape[1] + 1]
        ubar = u / estimates[0]
        return np.array([*e, *(-v for v in theta_rates), -self.v * delta_rate])[: n + len(z)], ubar


def vector_of(system, hand, ground, z, Y, w_parts):
    """w at a state, and which part of the way ubar is between its bounds, from the page."""
    loop = adaptive_loop(system).in_floats()
    numbers = ground.numbers().in_floats()
    middle, radius = numbers.box.mean(axis=1), np.diff(numbers.box, axis=1)[:, 0] / 2
    x, _ = hand.states(z, Y)
    h, *phi = hand.known(x)
    a, b = w_parts
    n, r = loop.n, loop.r
    off = hand.theta - loop.theta_middle
    remainder = h - numbers.slope @ x + np.array(phi) @ off
    sizes = np.abs(numbers.regressor).max(axis=1, initial=0.0)
    spread = np.diff(numbers.drift)[0] / 2 + sizes @ loop.theta_radius
    zeta = (z - middle) / radius
    psi = []
    for i in range(r):
        low, high = numbers.regressor[i]
        if low != high:
            value = (phi[i] - (low + high) / 2) / ((high - low) / 2)
            psi += [value, value * zeta[n - 1], value * zeta[n + i]]
    ranged = [off[i] / v for i, v in enumerate(loop.theta_radius) if v > 0]
    rho = (remainder - numbers.drift.mean()) / spread
    y = [v / bound for v, bound in zip(Y, loop.Y, strict=True)]
    scale = []
    if loop.largest_scale > 1:
        end, v = loop.largest_scale, hand.v
        scale = [(2 / v - 1 - 1 / end) / (1 - 1 / end)]
        scale.append((1 + end - end / v - v) / ((end - 1) ** 2 / 8) - 1)
    return np.array([*zeta, 1.0, *(a / numbers.reach), *b, *y, rho, *ranged, *scale, *psi]), zeta


@pytest.mark.parametrize("gain", [-1.6, -1.47, -1.4])
def test_equations_are_those_of_the_plant_and_the_law(gain):
    """zeta' = F w and the relation of ubar, at random states, against the law's own formulas."""
    rng = np.random.default_rng(3)
    system = ranged()
    _, (_, stage, *_) = certify_bootstrap(system, "high")
    ground, loop = stage.ground, adaptive_loop(system)
    numbers = ground.numbers()
    forms = forms_of(loop.in_floats(), numbers.in_floats())
    low, high = (float(v) for v in numbers.ubar(loop))
    u = system.plant.uncertainty
    for _ in range(20):
        theta = [rng.uniform(0.3, 0.5), rng.uniform(-0.4, -0.3)]
        hand = ErrorsByHand(system, gain, theta)
        z = rng.uniform(*numbers.box.astype(float).T)
        Y = rng.uniform(-1, 1, 3) * 0.2
        x, _ = hand.states(z, Y)
        a = rng.uniform(-1, 1, 2) * np.linalg.norm(x)
        b = rng.uniform(-1, 1, 2)
        tau, gamma, beta = (np.array(v, float) for v in (u.tau, u.gamma, u.beta))
        rates, ubar = hand.rates(z, Y, tau * (gamma * a + beta * b))
        w, _ = vector_of(system, hand, ground, z, Y, (a, b))
        assert np.abs(w).max() <= 1 + 1e-9  # every entry is within its bound
        assert low <= ubar <= high
        first, second = forms.corners  # at the lower and the upper end of pi
        low, high = (float(v) for v in scaled_ubar(loop, numbers))
        part = (hand.v * ubar - low) / (high - low)
        F = (1 - part) * first.F + part * second.F
        relation = (1 - part) * first.relation + part * second.relation
        assert (F @ w) * forms.radius == pytest.approx(rates, abs=1e-9)
        assert relation @ w == pytest.approx(0, abs=1e-9)
