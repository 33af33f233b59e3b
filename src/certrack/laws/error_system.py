"""The error system that a law states: what a certificate of the law is a theorem about.

In the error coordinates, every law of the recursion gives

    e' = (S - C - K) e + T w - R y_d^(q+1) + (0 ... 0, g_n u + phi^T theta - nu)

The last entry is the mismatch, and a law that can be certified is one that says which:

    KnownParameters      0, for the g_n and theta that the law uses (the robust law)
    EstimatedParameters  phi^T theta_tilde - g_n delta_tilde ubar, and the update laws cancel it
                         in V' but for the leakage (the adaptive law)

A law with errors of its own states them, their rates and, if it has one, a Lyapunov function
(OwnErrors). No certificate is made of that; the conformance kit checks every kind in the nominal
loop, where w = 0.

The statement is a claim of the law's author. Which equations would obey it is written here, and
whoever certifies the law compares them with those it has: a subclass with other equations inherits
the claim, but does not keep it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import sympy

from certrack.laws.signals import dot


@dataclass(frozen=True)
class KnownParameters:
    """The law uses g_n and theta themselves, so nothing is left of the mismatch.

    Parameters
    ----------
    g_n : formula of the law's gains
    theta : r formulas
    """

    g_n: sympy.Expr
    theta: Sequence[sympy.Expr] = ()

    @property
    def estimates(self) -> tuple[sympy.Symbol, ...]:
        """Own states that the law must have, in this order."""
        return ()

    def input(self, nu: sympy.Expr, phi: Sequence[sympy.Expr]) -> sympy.Expr:
        """u that obeys it."""
        return (nu - dot(phi, self.theta)) / self.g_n

    def rates(
        self, nu: sympy.Expr, phi: Sequence[sympy.Expr], e_n: sympy.Expr, sign_g: sympy.Expr
    ) -> tuple[sympy.Expr, ...]:
        """Rates of the own states that obey it."""
        return ()


@dataclass(frozen=True)
class EstimatedParameters:
    """The law estimates 1/g_n and theta, and its update laws have leakage.

        u          = delta_hat ubar,     ubar = nu - phi^T theta_hat
        delta_hat' = -gbar sign(g_n) ubar e_n - gbar gbar1 (delta_hat - delta_0)
        theta_hat' =  Gamma phi e_n        - Gamma gbar2 (theta_hat - theta_0)

    Parameters
    ----------
    delta_hat, theta_hat : own states of the law
    gain_rate, leak_gain, leak_theta : formulas of the law's gains
        gbar, gbar1, gbar2.
    delta0 : formula
    theta0 : r formulas
    Gamma : r rows of r formulas
    """

    delta_hat: sympy.Symbol
    gain_rate: sympy.Expr
    leak_gain: sympy.Expr
    leak_theta: sympy.Expr
    delta0: sympy.Expr
    theta_hat: Sequence[sympy.Symbol] = ()
    theta0: Sequence[sympy.Expr] = ()
    Gamma: Sequence[Sequence[sympy.Expr]] = field(default=())

    @property
    def estimates(self) -> tuple[sympy.Symbol, ...]:
        """Own states that the law must have, in this order."""
        return (self.delta_hat, *self.theta_hat)

    def input(self, nu: sympy.Expr, phi: Sequence[sympy.Expr]) -> sympy.Expr:
        """u that obeys it."""
        return self.delta_hat * (nu - dot(phi, self.theta_hat))

    def rates(
        self, nu: sympy.Expr, phi: Sequence[sympy.Expr], e_n: sympy.Expr, sign_g: sympy.Expr
    ) -> tuple[sympy.Expr, ...]:
        """Rates of the own states that obey it."""
        ubar = nu - dot(phi, self.theta_hat)
        forgotten = self.leak_gain * (self.delta_hat - self.delta0)
        delta_rate = -self.gain_rate * (sign_g * ubar * e_n + forgotten)
        drive = [
            phi[i] * e_n - self.leak_theta * (self.theta_hat[i] - self.theta0[i])
            for i in range(len(self.theta_hat))
        ]
        return (delta_rate, *(dot(row, drive) for row in self.Gamma))


@dataclass(frozen=True)
class OwnErrors:
    """Errors of the law's own, and what they do where w = 0; derived by hand, without u.

    Parameters
    ----------
    errors : formulas
        In states, own states, t, gains and y_d ... y_d^(q).
    rates : formulas
        Their derivatives, one per error; they may contain y_d^(q+1), too.
    V : formula, optional
        Lyapunov function of the errors, positive where they are not zero.
    V_rate : formula, optional
        V' is at most this; it must be negative where the states are large.
    """

    errors: Sequence[sympy.Expr]
    rates: Sequence[sympy.Expr]
    V: sympy.Expr | None = None
    V_rate: sympy.Expr | None = None


#: What a law may state.
ErrorSystem = KnownParameters | EstimatedParameters | OwnErrors
