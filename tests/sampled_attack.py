"""The worst that a sampled linear loop can be driven to: signs of its kernels, simulated.

It shares nothing with the certificates: the loop is that of :mod:`certrack.loops.stability`, the
disturbance, the sensors' errors and the converter's act by the signs of the backward rows, and
sines of every phase are the reference.
"""

import math

import numpy as np
from scipy.linalg import expm

from certrack.loops.stability import linear_loop

#: Steps of a period; delays must be multiples of 1/STEPS.
STEPS = 10

#: How much of the bound that grows with the state is used: within a step the state moves.
GROWTH = 0.998


class SampledLoop:
    """chi = (x, memories, inputs newest first), step by step."""

    def __init__(self, system):
        loop = linear_loop(system)
        drive = system.implementation
        u = system.plant.uncertainty
        assert loop is not None, "a loop that is not linear has no attack by its kernels"
        assert u.Delta is None and u.S is None, "the attack knows gamma ||x|| + beta only"
        assert len(drive.delays) == 1, "an attack is on one delay"
        law = loop.law_matrix(drive.period)
        acting = [k for k in range(system.plant.n) if u.tau[k] and u.acts(k)]
        self.n, self.memories, self.T = len(loop.b), len(law) - 1, drive.period
        n, h = self.n, drive.period / STEPS
        W = np.array([[u.tau[k] * (i == k) for k in acting] for i in range(n)]).reshape(n, -1)
        self.W, self.h = W, h
        self.gamma = np.array([u.gamma[k] for k in acting])
        self.beta = np.array([u.beta[k] for k in acting])
        noise = np.array(drive.noise_bound or [0.0] * n)
        self.mu = np.array(drive.measurement_quantum or [0.0] * n) / 2 + noise
        self.eta = drive.input_quantum / 2
        assert noise.any() or not any(drive.noise or ()), "noise without a bound has no worst case"
        self.q = system.controller.coordinates.q
        block = np.zeros((n + 1 + W.shape[1],) * 2)
        block[:n] = np.hstack([loop.A, loop.b[:, None], W]) * h
        over = expm(block)
        self.through_w = over[:n, n + 1 :]
        late = math.floor(drive.delays[0] + 1e-9)
        inputs = late + 2
        size = n + self.memories + inputs
        self.newest = n + self.memories
        self.jump = np.zeros((size, size))
        self.jump[:n, :n] = np.eye(n)
        self.jump[n : self.newest, : self.newest] = law[1:, : self.newest]
        self.jump[self.newest, : self.newest] = law[0, : self.newest]
        for i in range(1, inputs):
            self.jump[self.newest + i, self.newest + i - 1] = 1
        self.forward = np.zeros((size, self.q + 2))
        self.forward[n : self.newest] = law[1:, self.newest :]
        self.forward[self.newest] = law[0, self.newest :]
        self.switch = round((drive.delays[0] - late) * STEPS)
        assert abs(self.switch - (drive.delays[0] - late) * STEPS) < 1e-6
        self.steps = []
        for p in range(STEPS):
            step = np.eye(size)
            step[:n, :n] = over[:n, :n]
            step[:n, self.newest + late + (p < self.switch)] += over[:n, n]
            self.steps.append(step)
        self.noise = self.jump[:, :n].copy()
        self.noise[:n] = 0

    @property
    def radius(self):
        M = np.linalg.multi_dot([*self.steps[::-1], self.jump])
        return float(np.abs(np.linalg.eigvals(M)).max())

    def signs(self, row, step, periods):
        """Of what acts, from the first period on, that a row at the end collects."""
        acting = []
        for k in range(periods, -1, -1):
            in_period = []
            for p in range(step - 1 if k == periods else STEPS - 1, -1, -1):
                before = row @ self.steps[p]
                in_period.append(np.sign((row + before)[: self.n] @ self.W))
                row = before
            acting.append((in_period[::-1], np.sign(row @ self.noise), np.sign(row[self.newest])))
            row = row @ self.jump
        return acting[::-1]

    def from_start(self, x0, periods, step, output, amplitude, frequency, before=None):
        """The largest |x_output| (|u| with None) so late, from a start, for the file's sine."""
        row = np.zeros(len(self.jump))
        row[self.newest if output is None else output] = 1
        orders = np.arange(self.q + 2)
        acting, largest = self.signs(row, step, periods), 0.0
        for side in (1.0, -1.0):
            chi = np.zeros(len(row))
            chi[: self.n] = x0
            for place in (before or {}).values():
                chi[self.n + place] = x0[0]  # the first difference is zero
            for k, (of_w, of_noise, of_step) in enumerate(acting):
                angle = frequency * k * self.T + orders * np.pi / 2
                Y = amplitude * frequency**orders * np.sin(angle)
                chi = self.jump @ chi + side * self.noise @ (self.mu * of_noise) + self.forward @ Y
                chi[self.newest] += side * self.eta * of_step
                for p, sign in enumerate(of_w):
                    size = GROWTH * self.gamma * np.linalg.norm(chi[: self.n]) + self.beta
                    chi = self.steps[p] @ chi
                    chi[: self.n] += self.through_w @ (side * sign * size)
            largest = max(largest, abs(row @ chi))
        return largest

    def error(self, step, periods, amplitude, frequency, phases=8, output=0):
        """The largest |e_1| (|u| with output = None) after so many periods and steps."""
        row = np.zeros(len(self.jump))
        row[self.newest if output is None else output] = 1
        end = periods * self.T + step * self.h
        angles = np.linspace(0, 2 * np.pi, phases, endpoint=False) if amplitude else np.zeros(1)
        angles, sides = (v.ravel() for v in np.meshgrid(angles, [1.0, -1.0]))
        orders = np.arange(self.q + 2)[:, None]

        def reference(t):
            turned = frequency * (t - end) + angles + orders * np.pi / 2
            return amplitude * frequency**orders * np.sin(turned)

        chi = np.zeros((len(row), len(angles)))
        for k, (of_w, of_noise, of_step) in enumerate(self.signs(row, step, periods)):
            Y = reference(k * self.T)
            chi = self.jump @ chi + np.outer(self.noise @ (self.mu * of_noise), sides)
            chi += self.forward @ Y
            chi[self.newest] += self.eta * of_step * sides
            for p, sign in enumerate(of_w):
                norm = np.linalg.norm(chi[: self.n], axis=0)
                size = GROWTH * np.outer(self.gamma, norm) + self.beta[:, None]
                chi = self.steps[p] @ chi
                chi[: self.n] += self.through_w @ (sign[:, None] * size * sides)
        goal = 0.0 if output is None else reference(end)[0]
        return float(np.abs(row @ chi - goal).max())


def worst_error(system, amplitude, frequency, forgotten=1e-7, most=4000):
    """The largest |e_1| found at several places of a period."""
    loop = SampledLoop(system)
    periods = min(int(math.log(forgotten) / math.log(loop.radius)) + 20, most)
    places = sorted({0, loop.switch, STEPS // 2})
    return max(loop.error(step, periods, amplitude, frequency) for step in places)
