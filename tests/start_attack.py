"""The worst that a sampled loop can be driven to from a start: signs of its kernels, simulated.

Like :mod:`sampled_attack` it shares nothing with the certificates.
"""

import numpy as np
from sampled_attack import GROWTH, STEPS, SampledLoop


class FromStart(SampledLoop):
    """The loop at t = 0 in chosen states, with speeds not yet differenced."""

    def __init__(self, system):
        super().__init__(system)
        drive = system.implementation
        self.x_from = len(drive.velocity)
        plant = system.plant
        numbers = {str(name): float(v) for name, v in plant.constant_values.items()}
        names = {v: numbers.get(v.name, 0.0) for v in plant.drift.expr.free_symbols}
        at_rest = float(plant.drift.expr.xreplace(names))
        self.constant = -at_rest / float(plant.input_gain.expr)  # of the law; not in chi
        self.input = drive.initial_input - self.constant

    def first_state(self, x, noise):
        """chi at t = 0 of each column of x, with the sensors' first errors."""
        chi = np.zeros((len(self.jump), x.shape[1]))
        chi[: self.n], chi[self.newest :] = x, self.input
        measured = chi.copy()
        measured[: self.n] += noise
        for _ in range(self.x_from):  # nothing to take a difference from: as if it stood still
            after = self.jump @ measured
            measured[self.n : self.newest] = after[self.n : self.newest]
            measured[self.n + 1 : self.newest : 2] = 0
        chi[self.n : self.newest] = measured[self.n : self.newest]
        return chi

    def worst(self, x0, reference, periods, output):
        """Largest |e_1|, |x_i|, |u|, |u_k - u_{k-1}| of runs driven for one of them at the end.

        Parameters
        ----------
        x0 : n numbers
        reference : callable
            y_d ... y_d^(q+1) at t.
        periods : int
            Whose end (or jump) the output is driven for.
        output : int
            0 for e_1, 1 ... n for the states, n + 1 for u, n + 2 for its steps.
        """
        n, sides = self.n, np.array([1.0, -1.0])
        row = np.zeros(len(self.jump))
        if output <= n:
            row[max(output - 1, 0)] = 1
        else:
            row[self.newest] = 1
            if output == n + 2:
                row[self.newest + 1] = -1
        step = 0 if output > n else STEPS // 2
        acting = self.signs(row, step, periods)
        largest = np.zeros(n + 3)
        noise = self.mu * acting[0][1]
        chi = self.first_state(np.tile(np.array(x0)[:, None], 2), np.outer(noise, sides))
        last = chi[self.newest].copy()
        for k, (of_w, of_noise, of_step) in enumerate(acting):
            chi = self.jump @ chi + np.outer(self.noise @ (self.mu * of_noise), sides)
            chi += (self.forward @ reference(k * self.T))[:, None]
            chi[self.newest] += self.eta * of_step * sides
            largest[n + 1] = max(largest[n + 1], np.abs(chi[self.newest] + self.constant).max())
            largest[n + 2] = max(largest[n + 2], np.abs(chi[self.newest] - last).max())
            last = chi[self.newest].copy()
            for p in range(STEPS):
                t = k * self.T + p * self.h
                largest[0] = max(largest[0], np.abs(chi[0] - reference(t)[0]).max())
                largest[1 : n + 1] = np.maximum(largest[1 : n + 1], np.abs(chi[:n]).max(axis=1))
                sign = of_w[p] if p < len(of_w) else 0 * self.beta
                norm = np.linalg.norm(chi[:n], axis=0)
                size = GROWTH * np.outer(self.gamma, norm) + self.beta[:, None]
                chi = self.steps[p] @ chi
                chi[:n] += self.through_w @ (sign[:, None] * size * sides)
        return largest


def sine(amplitude, frequency, phase=0.0, orders=4):
    """y_d ... of amplitude sin(frequency t + phase)."""
    j = np.arange(orders)

    def values(t, count):
        turned = frequency * t + phase + j[:count] * np.pi / 2
        return amplitude * frequency ** j[:count] * np.sin(turned)

    return values


def worst_from(system, x0, amplitude, frequency, places, phase=0.0, outputs=None):
    """Largest outputs over attacks that end at several periods."""
    loop = FromStart(system)
    values = sine(amplitude, frequency, phase, loop.q + 2)

    def reference(t):
        return values(t, loop.q + 2)

    largest = np.zeros(loop.n + 3)
    for output in range(loop.n + 3) if outputs is None else outputs:
        for periods in places:
            largest = np.maximum(largest, loop.worst(x0, reference, periods, output))
    return largest
