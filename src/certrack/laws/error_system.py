"""What a law claims: the error system of its nominal loop, and the energy that falls there.

In the nominal loop the uncertain terms are zero, w = 0; all else is as the law believes. A claim
contains no input u: it is what the author derived by hand, so that the conformance kit can compare
it with what the law's formulas do in the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.laws.backstepping import ErrorCoordinates

if TYPE_CHECKING:
    from certrack.laws.base import Signals


@dataclass(frozen=True)
class NominalPlant:
    """What a claim may use besides the signals.

    Attributes
    ----------
    coordinates : ErrorCoordinates
        Of the law, for the plant.
    g_n : number
        The input gain: the law's own where it knows one, else the true one.
    theta : r numbers
        The parameters, likewise.
    """

    coordinates: ErrorCoordinates
    g_n: sympy.Expr
    theta: tuple[sympy.Expr, ...]


@dataclass(frozen=True)
class ErrorSystem:
    """The claim: e' in the nominal loop, and a bound on V'.

    Attributes
    ----------
    errors : formulas
        e_1, e_2 ..., in the states, own states, t and y_d ... y_d^(q).
    rates : formulas
        Their derivatives, one per error. They contain no u, and y_d^(q+1) at most.
    V : formula, optional
        Lyapunov function of the errors and of the own states, positive where they are not zero.
    V_rate : formula, optional
        V' is at most this; it must be negative where errors and own states are large.
    """

    errors: tuple[sympy.Expr, ...]
    rates: tuple[sympy.Expr, ...]
    V: sympy.Expr | None = None
    V_rate: sympy.Expr | None = None


def recursion_errors(x: Sequence[Any], Y: Sequence[Any], design: ErrorCoordinates) -> ErrorSystem:
    """e = A x - B Y with e' = (S - C - K) e - R y_d^(q+1), and V = |e|^2/2.

    So it is under the law for known parameters, g_n u + phi^T theta = nu. S is skew: it has no part
    in V'.
    """
    n, q = design.n, design.q
    A, B, M, R = (m.tolist() for m in (design.A, design.B, design.error_matrix, design.R))
    errors = tuple(_row(A[m], x) - _row(B[m], Y[: q + 1]) for m in range(n))
    rates = tuple(_row(M[m], errors) - R[m] * Y[q + 1] for m in range(n))
    decay = (design.c + design.kappa).tolist()
    V_rate = -_row(decay, [e**2 for e in errors]) - _row(R, errors) * Y[q + 1]
    return ErrorSystem(errors, rates, _row(errors, errors) / 2, V_rate)


def with_estimates(
    claim: ErrorSystem, s: Signals, nominal: NominalPlant, gbar: float, Gamma: np.ndarray
) -> ErrorSystem:
    """The claim where delta_hat and theta_hat stand for 1/g_n and theta [22], [23], [26].

    On the last row there remains phi^T theta_tilde - g_n delta_tilde ubar, which the update laws
    without leakage cancel in V'.
    """
    g_n, delta_error, theta_error = nominal.g_n, *estimation_errors(s.r, nominal)
    ubar = s.nu - _row(s.phi, estimates(s.r)[1])
    mismatch = _row(s.phi, theta_error) - g_n * delta_error * ubar
    weighted = [_row(row, theta_error) for row in np.linalg.inv(Gamma).tolist()]
    V = claim.V + abs(g_n) * delta_error**2 / (2 * gbar) + _row(theta_error, weighted) / 2
    return replace(claim, rates=(*claim.rates[:-1], claim.rates[-1] + mismatch), V=V)


def estimates(r: int) -> tuple[sympy.Symbol, list[sympy.Symbol]]:
    """delta_hat and theta_hat."""
    return symbol("delta_hat"), [symbol(f"theta_hat_{i + 1}") for i in range(r)]


def estimation_errors(r: int, nominal: NominalPlant) -> tuple[sympy.Expr, list[sympy.Expr]]:
    """delta_tilde = 1/g_n - delta_hat and theta_tilde = theta - theta_hat [22]."""
    delta_hat, theta_hat = estimates(r)
    pairs = zip(nominal.theta, theta_hat, strict=True)
    return 1 / nominal.g_n - delta_hat, [theta - guess for theta, guess in pairs]


def _row(coefficients: Sequence[Any], values: Sequence[Any]) -> Any:
    pairs = zip(coefficients, values, strict=True)
    return sum((a * v for a, v in pairs), sympy.Integer(0))
