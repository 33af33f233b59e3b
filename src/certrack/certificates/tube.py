"""The tube: a certified bound on |e_1(t)| for every t, from a start or a set of starts.

    |e_1(t)| <= sqrt(2 (V(0) e^{-alpha t} + (Delta/alpha) (1 - e^{-alpha t})))

V' <= -alpha V + Delta gives it, with V >= e_1^2/2. The bound at large t is the certificate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.exact import Proof, from_text, squared_bound
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.loops.plant import measured
from certrack.systems.system import System

#: Corners of a box of starts at which V is evaluated: all of a box in 12 states.
MAX_BOX_CORNERS = 4096

#: Factor on results of a few float operations, each of which may have rounded down by 1e-16.
TUBE_ROUNDING = 1 + 1e-12

#: Factor on V(0), for the roundings of a well-conditioned design; what a large A loses is added.
ENERGY_ROUNDING = 1 + 1e-9

#: Float operations, per state, behind an entry of e and of P e.
OPERATIONS = 4


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

    Returns
    -------
    Tube

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> tube = certrack.certificates.tube(system, found.proof)
    >>> bool(tube(0.0) > tube(10.0) >= 0)
    True
    """
    problem = error_problem(system, rational)
    square = squared_bound(problem, proof)
    assert square is not None
    P = np.array([[float(from_text(v)) for v in row] for row in proof.P])
    errors = _entry_errors(system)
    energy = max(_energy(system, problem, P, errors, x) for x in _corners(system, box))
    alpha = math.nextafter(float(from_text(proof.alpha)), 0.0)  # the nearest float may be above
    return Tube(2 * energy, float(square) * TUBE_ROUNDING, alpha)


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


def _entry_errors(system: System) -> tuple[np.ndarray, np.ndarray]:
    """How far each entry of A and of B is from its exact value, with the roundings of A x - B Y."""
    floats, exact = system.controller.coordinates, error_coordinates(system, rational)
    unit = OPERATIONS * floats.n * np.finfo(float).eps
    gap = np.vectorize(lambda v, w: abs(float(v - rational(Fraction(w)))), otypes=[float])
    A, B = (gap(*pair) for pair in ((exact.A, floats.A), (exact.B, floats.B)))
    return A + unit * np.abs(floats.A), B + unit * np.abs(floats.B)


def _energy(
    system: System,
    problem: ErrorProblem,
    P: np.ndarray,
    errors: tuple[np.ndarray, np.ndarray],
    x: tuple[float, ...],
) -> float:
    """V(0) from the plant state `x`, rounded up; the estimates' part at its worst over the ranges.

    e = A x - B Y is a small difference of large terms where the start is near the orbit that the
    loop settles to, and entries of A grow doubly exponentially with the order of a damped design:
    what e^T P e/2 can lose by that is added.
    """
    coordinates = system.controller.coordinates
    Y = system.reference.values(np.array([0.0]), coordinates.q)[:, 0]
    e = coordinates.A @ np.array(x) - coordinates.B @ Y
    total = float(e @ P @ e) / 2
    lost = errors[0] @ np.abs(x) + errors[1] @ np.abs(Y)  # of e
    size, weight = np.abs(e) + lost, np.abs(P)
    loss = lost @ weight @ size + OPERATIONS * len(e) * np.finfo(float).eps * size @ weight @ size
    if problem.adaptation is not None:
        z = system.settings.estimates or (0.0,) * len(system.controller.states)
        adaptation = problem.adaptation.in_floats()
        total += float(P[-1, -1]) * float(adaptation.energy(np.array(z)))
    return max(total * ENERGY_ROUNDING, total + float(loss))
