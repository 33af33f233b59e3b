"""The paper's certificate, its corrected last step, and the rate form.

    mu1  = min c_i - (1 + eps) ||A^{-1}||_F^2 G                                        > 0
    Dbar = ((1 + 1/eps) G ||A^{-1} B||^2 + sum p_i) D^2 + H
           + |g_n| gbar1 (delta - delta_0)^2 / 2 + gbar2 ||theta - theta_0||^2 / 2
    rho1 = min(mu1, gbar2/2, |g_n| gbar1/2)
    rho2 = max(1/2, lambda_max(Gamma^{-1})/2, |g_n|/(2 gbar))

so that

    V' <= -mu1 ||e||^2 - gbar2/2 ||theta~||^2 - |g_n| gbar1/2 delta~^2 + Dbar    [33]
       <= -rho1 ||Xi||^2 + Dbar                                                  [39]

and V <= rho2 ||Xi||^2 [37]; by the comparison principle
V <= V(0) e^{-rho1 t/rho2} + (rho2/rho1) Dbar (1 - e^{-rho1 t/rho2}) [40].

    published  sqrt(Dbar/rho1)            [42], by [41], which needs rho2 = 1/2
    corrected  sqrt(2 rho2 Dbar/rho1)     what [40] does imply, for e_1^2 <= 2 V
    rate       sqrt(2 Dbar/alpha)         alpha = min(2 mu1, gbar2 lambda_min(Gamma), gbar gbar1)

eps is free and optimised in floating point; then the formulas are evaluated in exact rationals and
the root is rounded up. So the last two are proven, but for lambda_min(Gamma), for which stands a
rational below it. The first is the paper's, and nobody has proven it where rho2 > 1/2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import (
    ToNumber,
    decimal,
    exact_float,
    positive_definite,
    rational,
)
from certrack.certificates.assumptions import assumptions
from certrack.certificates.certificate import (
    OUT_OF_RANGE,
    Certificate,
    NoCertificate,
    missing,
    within_floats,
)
from certrack.certificates.exact import float_down, float_up, from_text, root_up
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.core.once import once
from certrack.laws.backstepping import ErrorCoordinates
from certrack.laws.linear import Linear
from certrack.references.base import total_bound
from certrack.systems.system import System

#: By this part the published strength is rounded down; the root of 12 digits is above by less.
STRENGTH_ROUNDING = 1 - 1e-9

#: lambda_min(Gamma) is tried with so many digits, from below.
EIGENVALUE_DIGITS = (12, 9, 6, 3, 1)

#: Where eps is looked for, as parts of the largest that leaves mu1 positive: six decades, in this
#: many points, for the bound need not be unimodal; a bounded minimisation refines the best.
EPS_RANGE, EPS_POINTS = (1e-6, 0.999999), 400

#: mu1 must be positive at this eps already: as eps goes to 0, the bound grows without limit.
SMALL_EPS = 1e-9


@dataclass(frozen=True)
class Terms:
    """The numbers in the formulas above, before eps is chosen.

    `adaptation` is None for the robust law. `leak` is the cost of the prior guesses, `reference2`
    is ||A^{-1} B Y||^2, `residual` what the derivative of y_d that is not fed forward costs, and
    `gamma_min` lambda_min(Gamma) or less (infinite without theta). All are floats, or all exact
    rationals, and so are the results for an eps of their kind.
    """

    c_min: Any
    A_norm2: Any
    G: Any
    reference2: Any
    residual: Any
    H: Any
    leak: Any
    gains: tuple[Any, ...]
    adaptation: Adaptation | None
    gamma_min: Any = math.inf

    def mu1(self, eps: Any) -> Any:
        """Decay left after the gamma-parts [32], [34]."""
        return self.c_min - (1 + eps) * self.A_norm2 * self.G

    def dbar(self, eps: Any) -> Any:
        """Constant part of V' [34]."""
        gamma_part = (1 + 1 / eps) * self.G * self.reference2 if self.G else 0 * self.H
        return gamma_part + self.residual + self.H + self.leak

    def rho1(self, eps: Any) -> Any:
        """Decay of ||Xi||^2 [38]."""
        if self.adaptation is None:
            return self.mu1(eps)
        a = self.adaptation
        rates = [self.mu1(eps), min(self.gains) * a.leak_gain / 2]
        return min(rates + ([a.leak_theta / 2] if len(a.Gamma) else []))

    def rho2(self) -> Any:
        """Largest weight in V [36]."""
        half = (self.H * 0 + 1) / 2
        if self.adaptation is None:
            return half
        a = self.adaptation
        weights = [half, max(self.gains) / (2 * a.gain_rate)]
        return max(weights + ([half / self.gamma_min] if len(a.Gamma) else []))

    def alpha(self, eps: Any) -> Any:
        """Decay rate of V."""
        if self.adaptation is None:
            return 2 * self.mu1(eps)
        a = self.adaptation
        rates = [2 * self.mu1(eps), a.gain_rate * a.leak_gain]
        return min(rates + ([a.leak_theta * self.gamma_min] if len(a.Gamma) else []))


def certify_published(system: System) -> dict[str, Certificate]:
    """Published, corrected and rate form of `system`, each with its best eps."""
    try:
        with within_floats():
            terms, exact = collect(system), collect(system, rational)
    except NoCertificate as problem:
        return {kind: missing(kind, str(problem)) for kind in ("published", "corrected", "rate")}
    premises = (*assumptions(system), "D of Assumption 2 for the reference")

    def best(kind: str, square: Callable[[Terms, Any], Any]) -> Certificate:
        try:
            with within_floats():
                eps = exact_float(_minimise(partial(square, terms), terms), rational)
                if not (exact.mu1(eps) > 0 and exact.rho1(eps) > 0):
                    raise NoCertificate(OUT_OF_RANGE)
                bound = float_up(from_text(root_up(square(exact, eps))))
                rate = float_down(exact.alpha(eps)) if kind == "rate" else math.nan
                delta = float_up(exact.dbar(eps)) if kind == "rate" else math.nan
        except NoCertificate as problem:
            return missing(kind, str(problem))
        if not math.isfinite(bound):
            return missing(kind, OUT_OF_RANGE)
        return Certificate(kind, bound, rate, delta, kind != "published", assumptions=premises)

    return {
        "published": best("published", lambda t, eps: t.dbar(eps) / t.rho1(eps)),
        "corrected": best("corrected", lambda t, eps: 2 * t.rho2() * t.dbar(eps) / t.rho1(eps)),
        "rate": best("rate", lambda t, eps: 2 * t.dbar(eps) / t.alpha(eps)),
    }


def critical_strength(system: System) -> float:
    """Largest common scale of tau with mu1 > 0 for some eps: sqrt(min c/(||A^{-1}||_F^2 G)).

    What tau-bar is in Theorem 1, for tau in fixed proportions [35]. The factor (1 + eps) of mu_3 is
    1 here: eps may be as small as one likes, so this is the least upper bound of the strengths.
    From the exact rationals of the design, rounded down.
    """
    try:
        with within_floats():
            terms = collect(system, critical=True)
            if not terms.G:
                return math.inf
            Xe = error_problem(system, rational).Xe
            G, _ = uncertainty_terms(system, rational)
            c_min = min(rational(c) for c in system.law.gains().c)
            return float(from_text(root_up(c_min / ((Xe**2).sum() * G)))) * STRENGTH_ROUNDING
    except NoCertificate:
        return 0.0


@once
def collect(system: System, number: ToNumber = decimal, *, critical: bool = False) -> Terms:
    """The terms of the formulas, in the arithmetic of `number`.

    `leak` is the constant part of [27]; with H and `residual` it is that of [29]. With `critical`,
    mu1 may be negative.

    Raises
    ------
    NoCertificate
        Where a needed damping term is missing or, unless `critical`, mu1 is not positive.
    """
    problem, coordinates = error_problem(system, number), error_coordinates(system, number)
    adaptation, zero = problem.adaptation, number(0)
    G, H = uncertainty_terms(system, number)
    residual = residual_damping(system, coordinates, number)
    reference2, last = zero, zero
    if G != 0 or residual != 0:
        reference2, last = _reference_terms(system, problem.Xe @ coordinates.B, number)
    leak, gains, gamma_min = zero, (zero + 1,), math.inf
    if adaptation is not None:
        gains = adaptation.gains
        delta2 = max(g * d**2 for g, d in adaptation.delta_offsets())
        leak = delta2 * adaptation.leak_gain / 2
        if len(adaptation.Gamma):
            theta2 = max(v @ v for v in adaptation.theta_offsets())
            leak = leak + adaptation.leak_theta / 2 * theta2
            gamma_min = _smallest_eigenvalue(adaptation.Gamma)
    terms = Terms(
        c_min=min(coordinates.c),
        A_norm2=(problem.Xe**2).sum(),
        G=G,
        reference2=reference2,
        residual=residual * last**2,
        H=H,
        leak=leak,
        gains=gains,
        adaptation=adaptation,
        gamma_min=gamma_min,
    )
    sizes = (terms.A_norm2, G, H, reference2, last, leak)
    if number is decimal and not all(map(math.isfinite, sizes)):
        raise NoCertificate(OUT_OF_RANGE)
    if number is decimal and not critical and not terms.mu1(SMALL_EPS) > 0:
        raise NoCertificate(
            f"the uncertainty is too strong for the published proof: mu1 = {terms.mu1(0):.3g}; "
            "lower tau, raise c, or use fewer damping terms"
        )
    return terms


def uncertainty_terms(system: System, number: ToNumber) -> tuple[Any, Any]:
    """G and H: the damping times the squared gamma-parts and beta-parts [28], [29]."""
    if isinstance(system.law, Linear):
        raise NoCertificate("the published proof is of the recursion; a linear law has none")
    gains, u = system.law.gains(), system.plant.uncertainty
    assert gains.k is not None
    if gains.coupling is not None:
        raise NoCertificate("the published proof is of the paper's recursion, without law.coupling")
    if u.Delta is not None or u.S is not None:
        raise NoCertificate(
            "the published proof speaks of |w_k| <= gamma_k ||x|| + beta_k, without Delta and S"
        )
    G = H = number(0)
    for step in range(system.plant.n):
        for j in range(step + 1):
            for part, bound, index in (("gamma", u.gamma, 2 * j), ("beta", u.beta, 2 * j + 1)):
                strength = (number(u.tau[j]) * number(bound[j])) ** 2
                k = gains.k[step][index]
                if strength != 0 and math.isinf(k):
                    raise NoCertificate(
                        f"the published proof needs a finite k[{step}][{index}], because "
                        f"tau_{j + 1} {part}_{j + 1} is not zero; the semidefinite one does not"
                    )
                if strength != 0 and part == "gamma":
                    G += number(k) * strength
                elif strength != 0:
                    H += number(k) * strength
    return G, H


def _smallest_eigenvalue(Gamma: np.ndarray) -> Any:
    """lambda_min(Gamma); of rationals, a rational that is proven to be below it."""
    if not (Gamma != np.diag(np.diag(Gamma))).any():
        return min(np.diag(Gamma))
    least = float(np.linalg.eigvalsh(Gamma.astype(float)).min())
    if Gamma.dtype != object:
        return least
    for digits in EIGENVALUE_DIGITS:
        below = exact_float(least * (1 - 10.0**-digits), rational)
        if below > 0 and positive_definite(Gamma - below * np.eye(len(Gamma), dtype=object)):
            return below
    raise NoCertificate(
        "Gamma is too near to a singular matrix for the published proof; choose one whose "
        "eigenvalues differ less"
    )


def residual_damping(
    system: System, coordinates: ErrorCoordinates | None = None, number: ToNumber = decimal
) -> Any:
    """Sum of the p_m of the steps that the derivative not fed forward enters [29]."""
    gains = system.law.gains()
    coordinates = system.controller.coordinates if coordinates is None else coordinates
    assert gains.p is not None
    total = number(0)
    for step in range(system.plant.n - 1):
        if coordinates.R[step] and math.isinf(gains.p[step]):
            raise NoCertificate(
                f"the published proof needs a finite p[{step}], because "
                f"y_d^({coordinates.q + 1}) enters step {step + 1}; the semidefinite one does not"
            )
        total += number(gains.p[step]) if coordinates.R[step] else number(0)
    return total


def _reference_terms(system: System, AB: np.ndarray, number: ToNumber) -> tuple[Any, Any]:
    """||A^{-1} B Y||^2 and the bound on the last derivative, by D for the published law (q = 0)."""
    q = AB.shape[1] - 1
    if q == 0:
        D = exact_float(total_bound(system.reference), number)
        return (AB**2).sum() * D**2, D
    Y = np.array([exact_float(v, number) for v in system.reference.bounds(q + 1).values])
    return ((np.abs(AB) @ Y[: q + 1]) ** 2).sum(), Y[q + 1]


def best_eps(terms: Terms) -> float:
    """The eps of the best rate form."""
    return _minimise(lambda eps: 2 * terms.dbar(eps) / terms.alpha(eps), terms)


def _minimise(square: Callable[[float], float], terms: Terms) -> float:
    """Best eps > 0 among those with mu1 > 0."""
    if not terms.G:
        return 1.0
    top = terms.c_min / (terms.A_norm2 * terms.G) - 1

    def objective(log_eps: float) -> float:
        eps = math.exp(log_eps)
        return square(eps) if terms.mu1(eps) > 0 else math.inf

    low, high = EPS_RANGE
    grid = np.log(np.geomspace(low * top, high * top, EPS_POINTS))
    i = int(np.argmin([objective(v) for v in grid]))
    low, high = grid[max(0, i - 1)], grid[min(len(grid) - 1, i + 1)]
    refined = minimize_scalar(
        objective, bounds=(low, high), method="bounded", options={"xatol": 1e-10}
    )
    return math.exp(min((float(refined.x), float(grid[i])), key=objective))
