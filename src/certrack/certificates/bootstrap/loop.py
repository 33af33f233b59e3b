"""The adaptive loop in its errors, as numbers: what a bootstrap is about.

With theta_tilde = theta - theta_hat, delta_tilde = 1/g_n - delta_hat, phi = phi(x):

    e'           = M e + U (a, b) - R y_d^(q+1) + (0 ... 0, mismatch)
    mismatch     = phi^T theta_tilde - g_n delta_tilde ubar
    theta_tilde' = -Gamma (phi e_n + gbar2 theta_tilde - gbar2 (theta - theta_0))
    delta_tilde' = gbar sign(g_n) ubar e_n - gbar gbar1 (delta_tilde - (1/g_n - delta_0))
    ubar         = nu_x x + nu_Y Y - h - phi^T theta + phi^T theta_tilde,    x = A^-1 (e + B Y)

In the place of delta_tilde stands d = v delta_tilde with v = sqrt(|g_n|/g_0) and g_0 the smallest
|g_n|. Then g_n enters as v alone, in the same way in both rows, and a function that the update laws
cancel does so for every g_n:

    g_n delta_tilde ubar = s g_0 v ubar d,
    d'                   = s gbar v ubar e_n - gbar gbar1 (d - (s/(g_0 v) - v delta_0))

with s = sign(g_n). So the rows see pi = v ubar alone; 1/v, in [1/v_1, 1], acts in
pi = v ubar and in what d is pulled to, where v is between its chord, 1 + v_1 - v_1/v, and that less
((v_1 - 1)/2)^2.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import sympy

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import rational
from certrack.certificates.centred import reference_part
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text, root_up
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.core.expressions import symbol
from certrack.core.powers import put_in
from certrack.systems.system import System


@dataclass(frozen=True)
class AdaptiveLoop:
    """Numbers of the loop, exact or floats.

    Attributes
    ----------
    M, Ua, Ub, Xe : arrays with n rows
        As of :class:`ErrorProblem`.
    selections : n columns each
        S_k of each a-input, |a_k| <= ||S_k x||.
    AB : (n, q+1) array
        x = Xe e + AB (y_d ... y_d^(q)).
    R, nu_x : (n,) arrays
    nu_Y, Y : (q+2,) arrays
        Y_i bounds |y_d^(i)|.
    Gamma, theta0 : (r, r) and (r,) arrays
    theta_middle, theta_radius : (r,) arrays
        Of the box of theta.
    gain_rate, leak_gain, leak_theta, gain_sign, smallest_gain : numbers
        gbar, gbar1, gbar2, s, g_0.
    delta0 : number
    largest_scale : number
        v_1 >= v for all g_n in their range; 1 if g_n has none.
    """

    M: np.ndarray
    Ua: np.ndarray
    Ub: np.ndarray
    Xe: np.ndarray
    selections: tuple[np.ndarray, ...]
    AB: np.ndarray
    R: np.ndarray
    nu_x: np.ndarray
    nu_Y: np.ndarray
    Y: np.ndarray
    Gamma: np.ndarray
    theta0: np.ndarray
    theta_middle: np.ndarray
    theta_radius: np.ndarray
    gain_rate: Any
    leak_gain: Any
    leak_theta: Any
    gain_sign: Any
    smallest_gain: Any
    delta0: Any
    largest_scale: Any

    @property
    def n(self) -> int:
        """Order of the plant."""
        return len(self.M)

    @property
    def r(self) -> int:
        """Number of parameters theta."""
        return len(self.Gamma)

    @property
    def size(self) -> int:
        """Number of errors: e, theta_tilde, d."""
        return self.n + self.r + 1

    def in_floats(self) -> AdaptiveLoop:
        """The same loop in floating point."""
        return AdaptiveLoop(*(_floats_of(getattr(self, entry.name)) for entry in fields(self)))


def _floats_of(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_floats_of(entry) for entry in value)
    return value.astype(float) if isinstance(value, np.ndarray) else float(value)


@dataclass(frozen=True)
class Formulas:
    """Drift and regressor as formulas of the states, with the constants put in."""

    states: tuple[sympy.Symbol, ...]
    drift: sympy.Expr
    regressor: tuple[sympy.Expr, ...]


def formulas_of(system: System) -> Formulas:
    """The formulas of the plant that the law knows."""
    plant = system.plant
    exact = {symbol(name): value for name, value in plant.constant_values.items()}
    regressor = tuple(put_in(phi.expr, exact) for phi in plant.regressor)
    return Formulas(tuple(plant.symbols), put_in(plant.drift.expr, exact), regressor)


def adaptive_loop(system: System, problem: ErrorProblem | None = None) -> AdaptiveLoop:
    """The loop of `system` in exact rationals.

    Raises
    ------
    NoCertificate
        If the law is not the adaptive one, or a bound of the reference is missing.
    """
    problem = error_problem(system, rational) if problem is None else problem
    law = problem.adaptation
    if law is None:
        raise NoCertificate("the bootstrap is for the adaptive law")
    if not law.gamma_is_positive_definite():
        raise NoCertificate("Gamma is not positive definite")
    coordinates = error_coordinates(system, rational)
    AB, Y = reference_part(system, problem)
    n, zero = problem.n, rational(0)
    chosen = problem.selections or (None,) * problem.counts[0]
    identity = np.eye(n, dtype=object) + zero
    ends = np.array(law.theta_box, dtype=object).reshape(len(law.Gamma), 2)
    return AdaptiveLoop(
        M=problem.M,
        Ua=problem.Ua,
        Ub=problem.Ub,
        Xe=problem.Xe,
        selections=tuple(identity if part is None else part[0] + zero for part in chosen),
        AB=AB,
        R=coordinates.R + zero,
        nu_x=coordinates.nu_x,
        nu_Y=coordinates.nu_Y,
        Y=np.array(Y, dtype=object),
        Gamma=law.Gamma,
        theta0=law.theta0,
        theta_middle=(ends[:, 0] + ends[:, 1]) / 2,
        theta_radius=(ends[:, 1] - ends[:, 0]) / 2,
        gain_rate=law.gain_rate,
        leak_gain=law.leak_gain,
        leak_theta=law.leak_theta,
        gain_sign=rational(law.gain_sign),
        smallest_gain=min(law.gains),
        delta0=law.delta0,
        largest_scale=_largest_scale(law),
    )


def _largest_scale(law: Adaptation) -> Any:
    low, high = min(law.gains), max(law.gains)
    return rational(1) if low == high else from_text(root_up(high / low))  # not below the root
