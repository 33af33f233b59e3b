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

from dataclasses import replace
from typing import Any

import numpy as np
import sympy
from mpmath import iv, mp

from certrack.certificates.arithmetic import rational, solve, upper
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, from_text, root_up
from certrack.certificates.problem import ErrorProblem, coordinates
from certrack.core.expressions import symbol
from certrack.references.supremum import interval
from certrack.systems.system import System


def centred_problem(
    system: System, problem: ErrorProblem, reached: Proof, kappa: Any
) -> ErrorProblem:
    """The (exact) problem with V centred by `kappa`, on the set that `reached` proves."""
    law = problem.adaptation
    assert law is not None
    found = coordinates(system, rational, object)
    n, q = problem.n, found.q
    AB = problem.Xe @ found.B
    Y = [upper(v, rational) for v in system.reference.bounds(q + 1).values]
    last = found.nu_x @ problem.Xe
    M = problem.M.copy()
    M[-1] = M[-1] - kappa * last
    Uy, Xy = np.zeros((2, n, q + 2), dtype=object) + 0 * kappa
    for i in range(q + 2):
        seen = found.nu_x @ AB[:, i] if i <= q else 0 * kappa
        Uy[-1, i] = -kappa * (seen + found.nu_Y[i]) * Y[i]
        if i <= q:
            Xy[:, i] = AB[:, i] * Y[i]
    Uy[:, -1] = Uy[:, -1] - found.R * Y[-1]
    kept = [
        i for i in range(q + 2) if any(Uy[:, i] != 0) or (problem.counts[0] and any(Xy[:, i] != 0))
    ]
    zeta = np.zeros((n, 1), dtype=object) + 0 * kappa
    zeta[-1, 0] = abs(kappa) * _remainder(system, problem, reached, AB, Y)
    return replace(
        problem,
        M=M,
        Ub=np.hstack([problem.Ub, zeta]) if zeta[-1, 0] != 0 else problem.Ub,
        Uy=Uy[:, kept],
        Xy=Xy[:, kept],
        derivatives=tuple(kept),
        adaptation=replace(law, shift=kappa),
    )


def _remainder(
    system: System, problem: ErrorProblem, reached: Proof, AB: np.ndarray, Y: list[Any]
) -> Any:
    """Bound on |h - phi^T theta_tilde| where e^T P e <= B^2 and s |theta_tilde|^2 <= B^2."""
    law, plant = problem.adaptation, system.plant
    assert law is not None
    P = np.array([[from_text(v) for v in row] for row in reached.P], dtype=object)
    B2 = from_text(reached.bound) ** 2
    spread = problem.Xe @ solve(P, problem.Xe.T)
    box = {}
    for j, state in enumerate(plant.symbols):
        radius = from_text(root_up(B2 * spread[j, j]))
        radius += sum((abs(AB[j, i]) * Y[i] for i in range(AB.shape[1])), 0 * B2)
        box[state] = _enclose(-radius, radius)
    exact = {symbol(name): value for name, value in plant.constant_values.items()}
    total = _magnitude(plant.drift.expr.xreplace(exact), box)
    for i, phi in enumerate(plant.regressor):
        error = from_text(root_up(B2 * law.Gamma[i, i] / P[-1, -1]))
        total = total + _magnitude(phi.expr.xreplace(exact), box) * error
    return total


def _enclose(low: Any, high: Any) -> Any:
    """mpmath interval around two rationals."""
    ends = [iv.mpf(int(v.p)) / iv.mpf(int(v.q)) for v in (low, high)]
    return iv.mpf([ends[0].a, ends[1].b])


def _magnitude(formula: sympy.Expr, box: Any) -> Any:
    """Rational not below |formula| on the box."""
    try:
        found = interval(formula, box)
        size = max(abs(mp.mpf(found.a)), abs(mp.mpf(found.b)))
    except (ArithmeticError, ValueError, TypeError):
        raise NoCertificate("no interval bound of the drift or regressor on the set") from None
    if not mp.isfinite(size):
        raise NoCertificate("the drift or regressor is unbounded on the set")
    return upper(float(size), rational)
