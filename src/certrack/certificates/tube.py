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
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.loops.plant import measured
from certrack.systems.system import System

#: Corners of a box of starts at which V is evaluated: all of a box in 12 states.
MAX_BOX_CORNERS = 4096

#: Factor on results of a few float operations, each of which may have rounded down by 1e-16.
TUBE_ROUNDING = 1 + 1e-12

#: Factor on V(0): its quadratic form may lose more digits, for the entries of A can be large.
ENERGY_ROUNDING = 1 + 1e-9


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
        return np.sqrt(square) * TUBE_ROUNDING

    def settling_time(self, level: float) -> float:
        """Time after which |e_1| <= level is guaranteed, s; inf if it never is."""
        square = level**2
        if self.start <= square:
            return 0.0
        if square <= self.floor * TUBE_ROUNDING:
            return math.inf
        return (
            math.log((self.start - self.floor) / (square - self.floor)) / self.alpha * TUBE_ROUNDING
        )


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
        One stage, with P >= e_1 e_1^T: the semidefinite certificate's.
    box : n intervals, optional
        Set of initial plant states; the system's x0 if left out.

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners.
    """
    problem = error_problem(system, rational)
    square = squared_bound(problem, proof)
    assert square is not None
    P = np.array([[float(from_text(v)) for v in row] for row in proof.P])
    energy = max(_energy(system, problem, P, x) for x in _corners(system, box))
    alpha = math.nextafter(float(from_text(proof.alpha)), 0.0)  # the nearest float may be above
    return Tube(2 * energy * ENERGY_ROUNDING, float(square) * TUBE_ROUNDING, alpha)


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
    if math.prod(map(len, distinct)) > MAX_BOX_CORNERS:
        raise InputError("box", f"must have at most {MAX_BOX_CORNERS} corners", n)
    return list(product(*distinct))


def _energy(system: System, problem: ErrorProblem, P: np.ndarray, x: tuple[float, ...]) -> float:
    """V(0) from the plant state `x`, the estimates' part at its worst over the ranges."""
    coordinates = system.controller.coordinates
    Y = system.reference.values(np.array([0.0]), coordinates.q)[:, 0]
    e = coordinates.A @ np.array(x) - coordinates.B @ Y
    total = float(e @ P @ e) / 2
    if problem.adaptation is not None:
        z = system.settings.estimates or (0.0,) * len(system.controller.states)
        adaptation = problem.adaptation.in_floats()
        total += float(P[-1, -1]) * float(adaptation.energy(np.array(z)))
    return total
