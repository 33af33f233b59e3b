"""An attack on bounds for constants that vary in time: an ascent by the maximum principle.

The linear loop under y_d = a sin(w t), with the constants at some corner of their box, and every
bounded input at one of its ends, in each of many short steps. Forward the states, backward the
sensitivities of the output at the end; then each step takes the corner and the signs that are best
for the end, until nothing changes. Every step is an exact exponential, so what comes out is what an
admissible loop reaches: a lower estimate of the worst case, and no proof.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from certrack.certificates.ranges.loop import RangedLoop, error_form


@dataclass(frozen=True)
class Wave:
    """y_d = amplitude sin(frequency t)."""

    amplitude: float
    frequency: float

    def derivatives(self, order: int) -> np.ndarray:
        """y_d ... y_d^(order) as combinations of (sin, cos) of the phase, a row each."""
        a, w = self.amplitude, self.frequency
        turn = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
        return np.array([a * w**i * turn[i % 4] for i in range(order + 1)])


class VaryingLoop:
    """The loop in steps of one length, for some points of the box.

    The state is (e, sin, cos, 1); inputs are the w_k without growth and the bounded brackets.
    """

    def __init__(
        self, loop: RangedLoop, points: list[tuple], step: float, wave: Wave, growing: bool = False
    ) -> None:
        self.loop, self.step, self.wave, self.n = loop, step, wave, loop.n
        u, A = loop.system.plant.uncertainty, loop.coordinates.A.astype(float)
        n, q = loop.n, loop.coordinates.q
        columns = [A[:, k] * float(u.tau[k] * u.beta[k]) for k in range(n) if u.tau[k] * u.beta[k]]
        Xe, B = loop.Xe.astype(float), loop.coordinates.B.astype(float)
        gammas = u.gamma if growing else [0] * n
        tables = wave.derivatives(q + 1)
        moves, forces = [], []
        for point in points:
            form = error_form(loop, loop.entries.at(point))
            M, W = form.M.astype(float), form.W.astype(float)
            here = [
                *columns,
                *(
                    A[:, -1] * float(value) * float(size)
                    for value, size in zip(form.brackets, loop.sizes, strict=True)
                ),
            ]
            N = np.array(here).reshape(len(here), n).T
            # a disturbance +-gamma x_j is within gamma ||x||
            choices = [(np.zeros((n, n)), np.zeros((n, q + 2)))]
            for k, j, sign in itertools.product(range(n), range(n), (1, -1)):
                if gammas[k]:
                    out = sign * float(u.tau[k] * gammas[k]) * A[:, k]
                    through = np.zeros((n, q + 2))
                    through[:, : q + 1] = np.outer(out, (Xe @ B)[j])
                    choices.append((np.outer(out, Xe[j]), through))
            for dM, dW in choices:
                F = np.zeros((n + 3 + N.shape[1],) * 2)
                F[:n, :n] = M + dM
                F[:n, n : n + 2] = (W + dW) @ tables
                F[:n, n + 2] = form.offset.astype(float)
                F[n, n + 1], F[n + 1, n] = wave.frequency, -wave.frequency
                F[:n, n + 3 :] = N
                E = expm(F * step)
                moves.append(E[: n + 3, : n + 3])
                forces.append(E[: n + 3, n + 3 :])
        self.moves, self.forces = np.array(moves), np.array(forces)

    def run(self, z: np.ndarray, choice: np.ndarray, signs: np.ndarray) -> np.ndarray:
        """The states (steps + 1, n + 3) from a start."""
        states = [z]
        for k, b in zip(choice, signs, strict=True):
            states.append(self.moves[k] @ states[-1] + self.forces[k] @ b)
        return np.array(states)

    def ascent(
        self,
        z: np.ndarray,
        output: np.ndarray,
        steps: int,
        rng: np.random.Generator,
        *,
        rounds: int = 12,
        still: int = 0,
    ) -> np.ndarray:
        """The run (steps + 1, n + 3) whose output is largest at its end.

        With `still`, points come in groups of so many between which nothing may jump: the constants
        of a group are the same, and only its slopes vary in time.
        """
        count, b = len(self.moves), self.forces.shape[2]
        groups = [range(count)] if not still else np.arange(count).reshape(-1, still)
        best = None
        for group in groups:
            choice = rng.choice(group, steps)
            signs = rng.choice([-1.0, 1.0], (steps, b))
            largest = -np.inf
            for _ in range(rounds):
                states = self.run(z, choice, signs)
                reached = float(output @ states[-1])
                if reached <= largest * (1 + 1e-9) if largest > 0 else reached <= largest:
                    break
                largest = reached
                if best is None or reached > output @ best[-1]:
                    best = states
                choice, signs = choice.copy(), signs.copy()
                row = output.copy()
                for k in range(steps - 1, -1, -1):
                    through = row @ self.forces[group]
                    value = row @ self.moves[group] @ states[k] + np.abs(through).sum(axis=1)
                    i = int(np.argmax(value))
                    choice[k], signs[k] = group[i], np.where(through[i] >= 0, 1.0, -1.0)
                    row = row @ self.moves[choice[k]]
        assert best is not None
        return best

    def start(self, x0: np.ndarray, phase: float) -> np.ndarray:
        """(e, sin, cos, 1) for plant states and a phase of the reference."""
        c = self.loop.coordinates
        wave = np.array([np.sin(phase), np.cos(phase)])
        Y = self.wave.derivatives(c.q) @ wave
        e = c.A.astype(float) @ x0 - c.B.astype(float) @ Y
        return np.concatenate([e, wave, [1.0]])
