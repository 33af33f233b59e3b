"""The adaptive law as a drive runs it, many runs at once, against what is admitted.

It shares nothing with the certificates: the plant's formulas and the numbers of the law alone, with
steps of Runge-Kutta between samples. Disturbances sit on their bounds, their signs from squares of
every frequency or from the errors themselves; the reference is a sine of every phase.
"""

import math
from dataclasses import dataclass

import numpy as np
import sympy

#: Steps of a period; delays must be multiples of 1/STEPS.
STEPS = 4


@dataclass
class Seen:
    """The largest values of all runs, and of their last part.

    Attributes
    ----------
    errors, late_errors : (n,) arrays
        Of |e_i|.
    law, late_law : floats
        Of |u - u_law|, once a sample acts.
    steps, late_steps : (r + 1,) arrays
        Of what a step adds to the rates of theta_hat, delta_hat.
    u : float
    """

    errors: np.ndarray
    late_errors: np.ndarray
    law: float
    late_law: float
    steps: np.ndarray
    late_steps: np.ndarray
    u: float


class Loops:
    """N loops of one system, as implemented."""

    def __init__(self, system, count, seed=0):
        plant, law = system.plant, system.law
        self.random = np.random.default_rng(seed)
        self.system, self.N, self.n, self.r = system, count, plant.n, plant.r
        self.T = system.implementation.period
        self.exact_leak = system.implementation.update == "exact_leak"
        self.late = round(system.implementation.delays[0] * STEPS)
        assert abs(self.late - system.implementation.delays[0] * STEPS) < 1e-9
        numbers = dict(plant.constant_values)
        put = {
            s: v for s in plant.drift.expr.free_symbols for k, v in numbers.items() if str(s) == k
        }
        parts = [plant.drift.expr, *(phi.expr for phi in plant.regressor)]
        parts = [sympy.sympify(part).subs(put) for part in parts]
        self.formulas = sympy.lambdify(list(plant.symbols), parts, "numpy", cse=True)
        c = system.controller.coordinates
        self.A, self.B, self.nu_x, self.nu_Y = c.A, c.B, c.nu_x, c.nu_Y
        self.q = c.q
        self.chain = np.array([float(g.expr) for g in plant.chain])
        self.b = np.zeros((plant.n, plant.n))
        for i, row in enumerate(plant.linear or ()):
            self.b[i, : len(row)] = [float(v.expr) for v in row]
        self.g = float(system.truth.input_gain.expr)
        self.theta = np.array([float(v.expr) for v in system.truth.theta])
        self.law, self.sign = law, math.copysign(1.0, self.g)
        self.Gamma = np.array(law.parameters(plant)["Gamma"], dtype=float).reshape(self.r, self.r)
        self.theta0 = np.array(law.parameters(plant)["theta0"], dtype=float)
        u = plant.uncertainty
        assert u.Delta is None and u.S is None, "the attack knows gamma ||x|| + beta only"
        self.tau, self.gamma, self.beta = (
            np.array(v, dtype=float) for v in (u.tau, u.gamma, u.beta)
        )

    def reference(self, t, orders):
        """y_d and its derivatives, within the bounds of all of them."""
        angle = self.speed * t + self.phase + np.arange(orders)[:, None] * np.pi / 2
        return self.amplitude * self.speed ** np.arange(orders)[:, None] * np.cos(angle)

    def ubar(self, x, Y, theta_hat):
        h, *phi = self._values(x)
        return (
            self.nu_x @ x
            + self.nu_Y @ Y
            - h
            - (np.array(phi).reshape(self.r, -1) * theta_hat).sum(0)
        )

    def _values(self, x):
        return [np.broadcast_to(v, (x.shape[1],)) for v in self.formulas(*x)]

    def rate(self, t, x, u):
        h, *phi = self._values(x)
        signs = np.where(
            self.by_error[:, None] >= 0,
            np.sign(self._pushed(t, x)),
            np.sign(np.cos(self.turning * t + self.turn)),
        ).T
        w = signs * (self.gamma[:, None] * np.linalg.norm(x, axis=0) + self.beta[:, None])
        out = self.b @ x + self.tau[:, None] * w
        out[:-1] += self.chain[:, None] * x[1:]
        out[-1] += self.g * u + h + sum(a * b for a, b in zip(self.theta, phi, strict=True))
        return out

    def _pushed(self, t, x):
        e = self.A @ x - self.B @ self.reference(t, self.q + 1)
        chosen = e[np.maximum(self.by_error, 0), np.arange(self.N)]
        return np.tile(chosen + self.offset, (self.n, 1)).T

    def rates_of_estimates(self, x, Y, estimates):
        e_n = (self.A @ x - self.B @ Y[: self.q + 1])[-1]
        _, *phi = self._values(x)
        law, delta, thetas = self.law, estimates[0], estimates[1:]
        u = self.ubar(x, Y, thetas)
        of_delta = -law.gain_rate * (self.sign * u * e_n)
        of_delta = of_delta - law.gain_rate * law.leak_gain * (delta - law.delta0)
        drive = np.array(phi).reshape(self.r, -1) * e_n
        drive = drive - law.leak_theta * (thetas - self.theta0[:, None])
        return np.vstack([of_delta, self.Gamma @ drive])

    def run(self, duration, errors, priors, amplitude, top):
        """Start at corners of the boxes, and look at all that is bounded."""
        N, n, random = self.N, self.n, self.random
        self.amplitude = amplitude
        self.speed = top * random.choice([0.2, 0.5, 0.8, 1.0], N)
        self.phase = random.uniform(0, 2 * np.pi, N)
        self.turning = random.choice([0.0, 0.3, 1.0, 2.0, 4.0, 8.0], (N, 1)) * np.ones((1, n))
        self.turn = random.uniform(0, 2 * np.pi, (N, 1)) + np.pi * random.integers(0, 2, (N, n))
        self.by_error = random.integers(-2, n, N)
        self.offset = random.choice([0.0, -0.02, 0.02], N)
        e = np.array(errors)[:, None] * random.choice([-1.0, 1.0], (n, N))
        Y = self.reference(0.0, self.q + 3)
        x = np.linalg.solve(self.A, e + self.B @ Y[: self.q + 1])
        ends = np.array(priors)
        estimates = np.where(random.integers(0, 2, (self.r + 1, N)), ends[:, :1], ends[:, 1:])
        h, waiting = self.T / STEPS, []
        held = np.full(N, self.system.implementation.initial_input)
        none, still = np.zeros(n), np.zeros(self.r + 1)
        seen = Seen(none, none, 0.0, 0.0, still, still, 0.0)
        total = round(duration / self.T)
        for k in range(total):
            t, late = k * self.T, k > 0.6 * total
            Y = self.reference(t, self.q + 3)
            u = estimates[0] * self.ubar(x, Y[: self.q + 2], estimates[1:])
            seen.u = max(seen.u, np.abs(u).max())
            waiting.append((k * STEPS + self.late, u))
            first = self.rates_of_estimates(x, Y[: self.q + 2], estimates)
            for p in range(STEPS):
                while waiting and waiting[0][0] == k * STEPS + p:
                    held = waiting.pop(0)[1]
                now = t + p * h
                x = self._step(now, x, held, h)
                self._look(
                    seen,
                    now + h,
                    x,
                    held,
                    estimates,
                    first,
                    (p + 1) * h,
                    late,
                    k * STEPS + p >= self.late,
                )
            estimates = self._after(estimates, first, self.T)
        return seen

    def _after(self, estimates, first, s):
        if not self.exact_leak:
            return estimates + s * first
        law, out = self.law, np.empty_like(estimates)
        pole = law.gain_rate * law.leak_gain
        out[0] = estimates[0] + (1 - math.exp(-pole * s)) / pole * first[0]
        values, vectors = np.linalg.eigh(self.Gamma * law.leak_theta)
        through = vectors @ np.diag((1 - np.exp(-values * s)) / values) @ vectors.T
        out[1:] = estimates[1:] + through @ first[1:]
        return out

    def _look(self, seen, t, x, held, estimates, first, s, late, acting):
        Y = self.reference(t, self.q + 3)
        e = np.abs(self.A @ x - self.B @ Y[: self.q + 1]).max(axis=1)
        between = self._after(estimates, first, s)
        u_law = between[0] * self.ubar(x, Y[: self.q + 2], between[1:])
        m = np.abs(held - u_law).max() if acting else 0.0
        if self.exact_leak:
            law = self.law
            rate = first.copy()
            rate[0] -= law.gain_rate * law.leak_gain * (between[0] - estimates[0])
            rate[1:] -= law.leak_theta * self.Gamma @ (between[1:] - estimates[1:])
        else:
            rate = first
        added = np.abs(rate - self.rates_of_estimates(x, Y[: self.q + 2], between)).max(axis=1)
        added = np.append(added[1:], added[0])
        seen.errors = np.maximum(seen.errors, e)
        seen.law, seen.steps = max(seen.law, m), np.maximum(seen.steps, added)
        if late:
            seen.late_errors = np.maximum(seen.late_errors, e)
            seen.late_law = max(seen.late_law, m)
            seen.late_steps = np.maximum(seen.late_steps, added)

    def _step(self, t, x, u, h):
        a = self.rate(t, x, u)
        b = self.rate(t + h / 2, x + h / 2 * a, u)
        c = self.rate(t + h / 2, x + h / 2 * b, u)
        d = self.rate(t + h, x + h * c, u)
        return x + h / 6 * (a + 2 * b + 2 * c + d)
