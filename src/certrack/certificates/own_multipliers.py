"""The design's own Lyapunov function and multipliers: P = I, and the recursion's damping terms.

They are a point of the semidefinite program wherever the rate form is a bound, as Young's
inequality in the published proof shows. So there is a proof also where the solver finds none, such
as for damping terms of 1e30.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.published import best_eps, collect, residual_damping
from certrack.certificates.semidefinite import Solution
from certrack.systems.system import System


def own_multipliers(system: System, exact: ErrorProblem, part: str = "gamma") -> list[Any]:
    """sum_l k_{l,2j-1} tau_j^2 gamma_j^2 of the a-inputs j; k_{l,2j} and beta of the b-inputs."""
    k, u = system.law.gains().k, system.plant.uncertainty
    assert k is not None
    second = part == "beta"
    bounds, states = (u.beta, exact.states[1]) if second else (u.gamma, exact.states[0])
    return [
        (rational(u.tau[j]) * rational(bounds[j])) ** 2
        * sum(rational(row[2 * j + second]) for row in k[j:] if math.isfinite(row[2 * j + second]))
        for j in states
    ]


def own_solution(system: System, exact: ErrorProblem) -> Solution | None:
    """The point of the program that the published proof takes, with its best eps; None without.

    The reference enters x with a_i = ||A^{-1} B_i|| Y_i, and (sum a_i y_i)^2 <= sum a_j sum a_i
    y_i^2.
    """
    try:
        with within_floats():
            terms = collect(system)
            eps = best_eps(terms)
            weight = (1 + 1 / eps) * terms.G
            problem = exact.in_floats()
            through_x = np.linalg.norm(problem.Xy, axis=0)
            k = weight * through_x * through_x.sum()
            if problem.derivatives and problem.Uy[:, -1].any():
                bounds = system.reference.bounds(problem.derivatives[-1]).values
                k[-1] += residual_damping(system) * bounds[-1] ** 2
            lam, nu = (
                np.array([float(v) for v in own_multipliers(system, exact, part)])
                for part in ("gamma", "beta")
            )
            alpha = terms.alpha(eps)
            leak = problem.leakage(alpha)
            delta = float(nu.sum() + k.sum() + (leak or 0.0))
            slowest = float(np.abs(np.diag(problem.M)).min())
            return Solution(alpha, np.eye(problem.n), lam, nu, k, delta, slowest)
    except NoCertificate:
        return None
