"""The tube: a certified bound on |e_1(t)| for every t, from a start or a set of starts.

    |e_1(t)| <= sqrt(2 (V(0) e^{-alpha t} + (Delta/alpha) (1 - e^{-alpha t})))

V' <= -alpha V + Delta gives it, with V >= e_1^2/2. The bound at large t is the certificate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.exact import Proof, from_text, squared_bound
from certrack.certificates.problem import ErrorProblem, error_problem
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.loops.plant import measured
from certrack.systems.system import System

MAX_CORNERS = 4096
ROUNDING = 1 + 1e-12


@dataclass(frozen=True)
class Tube:
    """Bound on |e_1(t)|.

    Attributes
    ----------
    start : float
        2 V(0), rounded up.
    floor : float
        2 Delta/alpha, rounded up: the square of the certificate's bound.
    alpha : float, 1/s
        Rounded down.
    """

    start: float
    floor: float
    alpha: float

    def __call__(self, t: np.ndarray | float) -> np.ndarray:
        """The bound at times `t`, unit of the output."""
        decay = np.exp(-self.alpha * np.asarray(t, dtype=float))
        square = self.start * decay + self.floor * (1 - decay)
        return np.sqrt(square) * ROUNDING

    def settling_time(self, level: float) -> float:
        """Time after which |e_1| <= level is guaranteed, s; inf if it never is."""
        square = level**2
        if self.start <= square:
            return 0.0
        if square <= self.floor * ROUNDING:
            return math.inf
        return math.log((self.start - self.floor) / (square - self.floor)) / self.alpha * ROUNDING


def tube(
    system: System,
    proof: Proof,
    box: Sequence[tuple[float, float]] | None = None,
) -> Tube:
    """Tube of a proven certificate.

    Parameters
    ----------
    system : System
        The one the proof is for; its reference at t = 0 and its initial estimates count.
    proof : Proof
    box : n intervals, optional
        Set of initial plant states; the system's x0 if left out.
    """
    problem = error_problem(system, rational)
    square = squared_bound(problem, proof)
    assert square is not None
    P = np.array([[float(from_text(v)) for v in row] for row in proof.P])
    energy = max(_energy(system, problem, P, x) for x in _corners(system, box))
    alpha = math.nextafter(float(from_text(proof.alpha)), 0.0)
    return Tube(2 * energy * (1 + 1e-9), float(square) * ROUNDING, alpha)


def _corners(system: System, box: Sequence[tuple[float, float]] | None) -> list[tuple[float, ...]]:
    """Starts at which the convex V can be largest."""
    if box is None:
        return [tuple(measured(system, np.array([system.settings.x0]).T)[:, 0].tolist())]
    n = system.plant.n
    pairs = [
        checks.ordered_pair(f"box[{i}]", pair)
        for i, pair in enumerate(checks.sequence("box", box, n, "[low, high] per state"))
    ]
    distinct = [tuple(dict.fromkeys(pair)) for pair in pairs]
    if math.prod(map(len, distinct)) > MAX_CORNERS:
        raise InputError("box", f"must have at most {MAX_CORNERS} corners", n)
    return list(product(*distinct))


def _energy(system: System, problem: ErrorProblem, P: np.ndarray, x: tuple[float, ...]) -> float:
    found = system.controller.coordinates
    Y = system.reference.values(np.array([0.0]), found.q)[:, 0]
    e = found.A @ np.array(x) - found.B @ Y
    total = float(e @ P @ e) / 2
    if problem.adaptation is not None:
        z = system.settings.estimates or (0.0,) * len(system.controller.states)
        estimates = np.array(z)
        total += float(P[-1, -1]) * float(problem.in_floats().estimate_energy(estimates))
    return total
