"""The exact edge of stability of a linear sampled loop: the spectral radius of one period.

For a plant with linear rates (drift and regressor linear, no disturbance) and a law that is linear
in the measured states, everything between two samples is a matrix. With the waiting commands as
further states,

    xi = (x, s, u_{k-1} ... u_{k-d-1}),     xi_{k+1} = M(T, delay) xi_k + what the reference adds

and the loop is exponentially stable exactly where all eigenvalues of M lie inside the unit circle.
The uncertain terms w are left out; limits, quantisation and noise too. So are, in a truth with
states of its own, motions that the input does not cause or that no sensor shows: no controller
changes them, and undamped ones would hide the edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable
from certrack.laws.base import Law
from certrack.laws.integral import INTEGRAL
from certrack.loops.controller import (
    SampledController,
    resolved,
    sampled_controller,
)
from certrack.loops.controller_values import controller_values
from certrack.loops.linear_controller import after_first_sample
from certrack.loops.plant import INPUT, plant_values, simulated_plant
from certrack.model.implementation import Implementation
from certrack.systems.system import System

#: A direction counts as new if more than this part of it is: well above the rounding of the
#: orthogonalisation, well below what a sensor or an input of any use contributes.
NEW_DIRECTION = 1e-10


@dataclass(frozen=True)
class LinearLoop:
    """A sampled loop whose plant and law are linear.

    Attributes
    ----------
    system : System
        Without disturbance, limits, quantisation and noise.
    A, b : (N, N) and (N,) arrays
        x' = A x + b u; of a truth with states of its own, what is caused by u and measured.
    C : (n, N) array
        Measured states of the plant's.
    controller : SampledController
    slopes : callable
        Of the controller's parameters: derivatives of the command and the next memories, a row
        each, by the measured states, the memories and the reference y_d ... y_d^(q+1).
    law : Law
        Whose gains count: the system's, or another of the same structure.
    """

    system: System
    A: np.ndarray
    b: np.ndarray
    C: np.ndarray
    controller: SampledController
    slopes: Callable[..., list[Any]]
    law: Law

    def period_map(self, period: float, delay: float) -> np.ndarray:
        """M of the module's text; see :meth:`period_maps`."""
        return self.period_maps(period, delay)[0]

    def period_maps(self, period: float, delay: float) -> tuple[np.ndarray, np.ndarray]:
        """M of the module's text, and what the reference adds.

        Parameters
        ----------
        period : float, s
        delay : float, periods

        Returns
        -------
        M : (N + s + d + 1, N + s + d + 1) array
            d is the whole part of the delay, s the number of the controller's memories.
        G : (N + s + d + 1, q + 2) array
            Over y_d ... y_d^(q+1) at the sample.
        """
        law = self.law_matrix(period)
        N, n, memories = len(self.b), len(self.C), len(law) - 1
        d = math.floor(delay)
        size, width = N + memories + d + 1, law.shape[1] - n - memories
        signals = np.zeros((law.shape[1], size + width))  # measured, memories, reference over xi, Y
        signals[:n, :N], signals[n : n + memories, N : N + memories] = self.C, np.eye(memories)
        signals[n + memories :, size:] = np.eye(width)
        after, units = law @ signals, np.eye(size + width)
        inputs = np.vstack([after[:1], units[N + memories : size]])  # u_k, u_{k-1} ... u_{k-d-1}
        x = units[:N]
        for u, h in ((inputs[d + 1], delay - d), (inputs[d], 1 - delay + d)):
            A, b = self.plant_over(h * period)
            x = A @ x + np.outer(b, u)
        maps = np.vstack([x, after[1:], inputs[: d + 1]])
        return maps[:, :size], maps[:, size:]

    def radius(self, period: float, delay: float) -> float:
        """Spectral radius of the period map; the loop is stable where it is below 1.

        Parameters
        ----------
        period : float, s
        delay : float, periods

        Returns
        -------
        float
            inf where the map is not finite.
        """
        M = self.period_map(period, delay)
        return float(np.abs(np.linalg.eigvals(M)).max()) if np.isfinite(M).all() else math.inf

    def law_matrix(self, period: float) -> np.ndarray:
        """The command and the next memories, a row each, as :attr:`slopes` orders its columns."""
        system = self.system
        assert system.implementation is not None
        implementation = replace(system.implementation, period=period)
        values = controller_values(self.controller, system.plant, self.law, implementation)
        rows = 1 + len(self.controller.states)
        return np.array(self.slopes(*values), dtype=float).reshape(rows, -1)

    def plant_over(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """The plant over a time h with constant input."""
        from scipy.linalg import expm

        N = len(self.b)
        block = np.zeros((N + 1, N + 1))
        block[:N, :N], block[:N, N] = self.A * h, self.b * h
        with np.errstate(all="ignore"):
            transition = expm(block)
        return transition[:N, :N], transition[:N, N]


def linear_loop(system: System) -> LinearLoop | None:
    """The loop as matrices, or None where it is not linear.

    Parameters
    ----------
    system : System
        Its disturbance, limits, quantisation and noise are left out.

    Returns
    -------
    LinearLoop or None
        None also for a law with states of its own or the time in it, and without an implementation.
    """
    law = system.controller
    others = set(law.states) - {INTEGRAL}
    if others or system.implementation is None or law.equations.u.has(TIME):
        return None
    implementation = Implementation(
        system.implementation.period,
        velocity=system.implementation.velocity,
        velocity_filter=system.implementation.velocity_filter,
        counted_delay=system.implementation.design_delay,
    )
    system = system.replace(truth=replace(system.truth, omega=None), implementation=implementation)

    plant = simulated_plant(system)
    moving = (*plant.states, INPUT)
    table = [sympy.diff(f, v) for f in (*plant.rates, *plant.outputs) for v in moving]
    controller = sampled_controller(system.plant, system.controller, implementation)
    command, update = resolved(controller)
    signals = (*controller.measured, *controller.states, *controller.Y)
    slopes = [sympy.diff(after_first_sample(f), v) for f in (command, *update) for v in signals]
    if not (_only_of(table, plant.parameters) and _only_of(slopes, controller.parameters)):
        return None
    values = numpy_callable(plant.parameters, table)(*plant_values(plant, system))
    numbers = np.array(values, dtype=float).reshape(-1, len(moving))
    n = plant.n
    A, b, C = numbers[:n, :-1], numbers[:n, -1], numbers[n:, :-1]
    if system.truth.states:
        V = _reachable_subspace(A, b[:, None])
        A, b, C = V.T @ A @ V, V.T @ b, C @ V
        V = _reachable_subspace(A.T, C.T)
        A, b, C = V.T @ A @ V, V.T @ b, C @ V
    values_of = numpy_callable(controller.parameters, slopes)
    return LinearLoop(system, A, b, C, controller, values_of, system.law)


def _reachable_subspace(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Orthonormal basis, in columns, of the space spanned by B, A B, A^2 B ..."""
    basis: list[np.ndarray] = []
    waiting = list(B.T)
    while waiting and len(basis) < len(A):
        direction = waiting.pop(0)
        size = np.linalg.norm(direction)
        for _ in range(2):  # the second time for rounding
            for vector in basis:
                direction = direction - (vector @ direction) * vector
        if np.linalg.norm(direction) > NEW_DIRECTION * size:
            basis.append(direction / np.linalg.norm(direction))
            waiting.append(A @ basis[-1])
    return np.array(basis).reshape(-1, len(A)).T


def _only_of(table: list[sympy.Expr], parameters: tuple[sympy.Symbol, ...]) -> bool:
    """Whether the formulas contain no symbol but the parameters."""
    return all(entry.free_symbols <= set(parameters) for entry in table)
