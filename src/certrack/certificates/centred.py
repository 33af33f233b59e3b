"""The centred stage: the adaptive law analysed around better virtual parameters.

The leakage pulls the estimates to the prior guesses, and V counts the distance to the true values.
V may as well be centred elsewhere: at (1 - kappa) delta and (1 + kappa) theta, nearer to the
guesses. With D = delta_tilde - kappa/g_n and theta_tilde + kappa theta in its place, the leakage
costs less, and of the cancellation there remains, on the last row,

    -kappa ubar - kappa phi^T theta = -kappa nu_lin + zeta,   zeta = kappa (h - phi^T theta_tilde)

with nu_lin = nu_x . x + nu_Y . Y. The linear part joins the matrix inequality; zeta is bounded on
the set that an earlier stage has proven to be reached, by interval arithmetic rounded outward.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import sympy
from mpmath import iv, mp

from certrack.certificates.arithmetic import exact_float, rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, from_text, root_up
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.intervals import enclosure
from certrack.certificates.problem import ErrorProblem
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.powers import put_in
from certrack.systems.system import System


def centred_problem(
    system: System, problem: ErrorProblem, reached: Proof, kappa: Any
) -> ErrorProblem:
    """The problem with V centred by `kappa`, on the set that `reached` proves.

    Parameters
    ----------
    system : System
    problem : ErrorProblem
        Of `system`, in exact rationals, with the adaptive law.
    reached : Proof
        A proven bound on e_n, so that e^T P e <= bound^2 in the long run.
    kappa : rational
        Which part of delta and theta the centre is moved by.

    Raises
    ------
    NoCertificate
        If drift and regressor have no interval bound on that set.
    """
    law = problem.adaptation
    assert law is not None
    coordinates = error_coordinates(system, rational)
    n, q = problem.n, coordinates.q
    AB, Y = reference_part(system, problem)
    M = problem.M.copy()
    M[-1] = M[-1] - kappa * (coordinates.nu_x @ problem.Xe)
    Uy, Xy = np.zeros((2, n, q + 2), dtype=object) + 0 * kappa
    for i in range(q + 2):
        through_x = coordinates.nu_x @ AB[:, i] if i <= q else 0 * kappa
        Uy[-1, i] = -kappa * (through_x + coordinates.nu_Y[i]) * Y[i]
        if i <= q:
            Xy[:, i] = AB[:, i] * Y[i]
    Uy[:, -1] = Uy[:, -1] - coordinates.R * Y[-1]
    acting = [
        i for i in range(q + 2) if any(Uy[:, i] != 0) or (problem.counts[0] and any(Xy[:, i] != 0))
    ]
    zeta = np.zeros((n, 1), dtype=object) + 0 * kappa
    zeta[-1, 0] = abs(kappa) * remainder_bound(system, problem)(reached)
    return replace(
        problem,
        M=M,
        Ub=np.hstack([problem.Ub, zeta]) if zeta[-1, 0] != 0 else problem.Ub,
        Uy=Uy[:, acting],
        Xy=Xy[:, acting],
        derivatives=tuple(acting),
        adaptation=replace(law, shift=kappa),
    )


def reference_part(system: System, problem: ErrorProblem) -> tuple[np.ndarray, list[Any]]:
    """A^{-1} B and the bounds Y: x = A^{-1} e + A^{-1} B (y_d ... y_d^(q)), |y_d^(i)| <= Y_i."""
    coordinates = error_coordinates(system, rational)
    try:
        bounds = system.reference.bounds(coordinates.q + 1).values
    except InputError as unbounded:
        raise NoCertificate(f"the centred stage needs all bounds of y_d: {unbounded}") from None
    return problem.Xe @ coordinates.B, [exact_float(v, rational) for v in bounds]


def remainder_bound(system: System, problem: ErrorProblem) -> Callable[[Proof], Any]:
    """Bound on |h - phi^T theta_tilde| as a function of what is reached.

    The function takes a proof, for the set e^T P e <= B^2, s |theta_tilde|^2 <= B^2 with B its
    bound, and raises NoCertificate where drift and regressor have no interval bound on that set.
    """
    law, plant = problem.adaptation, system.plant
    assert law is not None
    AB, Y = reference_part(system, problem)
    exact = {symbol(name): value for name, value in plant.constant_values.items()}
    drift = put_in(plant.drift.expr, exact)
    regressor = [put_in(phi.expr, exact) for phi in plant.regressor]

    def bound(reached: Proof) -> Any:
        P = np.array([[from_text(v) for v in row] for row in reached.P], dtype=object)
        B2 = from_text(reached.bound) ** 2
        spread = problem.Xe @ solve(P, problem.Xe.T)
        box = {}
        for j, state in enumerate(plant.symbols):
            # |x_j| <= max over the ellipsoid of |(A^-1 e)_j|, plus |(A^-1 B)_j| Y; a smaller box
            # would leave out states that are reached, and the bound would be wrong
            radius = from_text(root_up(B2 * spread[j, j]))
            radius += sum((abs(AB[j, i]) * Y[i] for i in range(AB.shape[1])), 0 * B2)
            box[state] = _enclose(-radius, radius)
        total = _magnitude(drift, box)
        for i, phi in enumerate(regressor):
            error = from_text(root_up(B2 * law.Gamma[i, i] / P[-1, -1]))
            total = total + _magnitude(phi, box) * error
        return total

    return bound


def _enclose(low: Any, high: Any) -> Any:
    """mpmath interval around two rationals: a division of intervals rounds outward."""
    ends = [iv.mpf(int(v.p)) / iv.mpf(int(v.q)) for v in (low, high)]
    return iv.mpf([ends[0].a, ends[1].b])


def _magnitude(formula: sympy.Expr, box: Any) -> Any:
    """Rational not below |formula| on the box."""
    try:
        size = mp.mpf(abs(enclosure(formula, box)).b)
    except (ArithmeticError, ValueError, TypeError):
        raise NoCertificate("no interval bound of the drift or regressor on the set") from None
    bound = float(size)  # exactly, for the ends of mpmath's intervals have 53 bits
    if not math.isfinite(bound):
        raise NoCertificate("the drift or regressor is unbounded on the set")
    return exact_float(bound, rational)
