"""The error system that a law states, evaluated beside what its nominal loop does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from scipy.linalg import solve_continuous_lyapunov

from certrack.core.expressions import TIME, symbol
from certrack.core.lowering import numpy_callable
from certrack.laws import EstimatedParameters, KnownParameters, OwnErrors, Signals, dot
from certrack.laws.backstepping import ErrorCoordinates
from certrack.laws.plant_coordinates import PlantCoordinates
from certrack.loops.continuous import close_loop
from certrack.model.truth import Truth
from certrack.systems.system import System
from certrack.testing.shared import skip


def nominal_system(system: System) -> System:
    """The system with a plant as the law believes it: w = 0, and its own g_n and theta if any."""
    plant, truth, settings = system.plant, system.truth, system.settings
    gain = plant.input_gain or truth.input_gain
    theta = truth.theta if plant.theta is None else plant.theta
    if gain is None or len(theta) != plant.r:
        skip("the file states no g_n and theta of the nominal plant")
    x0 = (0.0,) * plant.n if truth.states else settings.x0
    numbers: Any = tuple(
        float(value.expr.subs(truth_constants(system))) for value in (gain, *theta)
    )
    nominal = Truth(numbers[0], numbers[1:])
    return system.replace(
        truth=nominal,
        settings=replace(settings, x0=x0),
        implementation=None,
        population=None,
    )


def truth_constants(system: System) -> dict[sympy.Symbol, Any]:
    """The plant's constants, with those that the truth changes."""
    values = {**system.plant.constant_values, **dict(system.truth.constants)}
    return {symbol(name): getattr(value, "expr", value) for name, value in values.items()}


@dataclass(frozen=True)
class TestedClaim:
    """The claim of a law, as numbers at a time, states and parameters of the nominal loop.

    Parameters
    ----------
    system : System
        As :func:`nominal_system` returns it.
    """

    __test__ = False

    system: System

    @cached_property
    def formulas(self) -> OwnErrors:
        """Errors, their rates, V and V' as stated; skips the test if the law states nothing."""
        system, truth = self.system, self.system.truth
        s = system.controller.signals
        stated = system.law.error_system(s)
        if stated is None:
            skip(f"the {system.law.kind} law states no error system")
        if isinstance(stated, OwnErrors):
            return stated
        coordinates = system.controller.coordinates
        if isinstance(coordinates, PlantCoordinates):
            return linear_errors(s, coordinates)
        recursive = recursion_errors(s, coordinates)
        if isinstance(stated, KnownParameters):
            return recursive
        assert truth.input_gain is not None
        theta = [value.expr for value in truth.theta]
        return with_estimates(recursive, stated, s, truth.input_gain.expr, theta)

    @cached_property
    def _loop(self) -> Callable[..., Any]:
        loop = close_loop(self.system)
        return numpy_callable([TIME, loop.states, loop.parameters], loop.rates)

    def compare(
        self, of: Sequence[sympy.Expr], claimed: Sequence[sympy.Expr]
    ) -> Callable[..., tuple[np.ndarray, np.ndarray, float]]:
        """Derivatives of formulas along the loop, what is claimed of them, and their rounding."""
        system, controller = self.system, self.system.controller
        s, states = controller.signals, (*controller.signals.x, *controller.states)
        known = dict(zip(controller.symbols, controller.values.tolist(), strict=True))
        known |= {symbol(k): float(v) for k, v in system.plant.constant_values.items()}
        exact = [sympy.sympify(formula).xreplace(known) for formula in (*of, *claimed)]
        variables = (TIME, *states, *s.Y)
        for formula in exact:
            foreign = formula.free_symbols - set(variables)
            assert not foreign, f"unknown symbols {foreign} in the claim"
        of, claimed = exact[: len(of)], exact[len(of) :]
        assert not any(f.has(s.Y[-1]) for f in of), f"an error may not contain {s.Y[-1]}"
        slopes = [f.diff(v) for f in of for v in variables[:-1]]
        evaluate = numpy_callable([TIME, states, s.Y], [*slopes, *claimed])
        nu_x = np.abs(controller.coordinates.nu_x)

        def at(t: float, y: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
            Y = system.reference.values(np.array([t]), len(s.Y) - 1)[:, 0]
            rates = np.array(self._loop(t, y, p), dtype=float)[: len(states)]
            values = np.array(evaluate(t, y[: len(states)], Y), dtype=float)
            gradient = values[: len(slopes)].reshape(len(of), len(variables) - 1)
            flow = np.concatenate([[1.0], rates, Y[1:]])
            size = np.abs(gradient) @ (np.abs(flow) + nu_x @ np.abs(y[: len(nu_x)])) + 1
            return gradient @ flow, values[len(slopes) :], float(size.max(initial=1))

        return at

    def value(self, formula: sympy.Expr) -> Callable[..., float]:
        """A formula of the claim at a time, states and parameters."""
        compared = self.compare((), (formula,))
        return lambda t, y, p: float(compared(t, y, p)[1][0])


def recursion_errors(s: Signals, design: ErrorCoordinates) -> OwnErrors:
    """e = A x - B Y with e' = (S - C - K) e - R y_d^(q+1), and V = |e|^2/2.

    So it is where g_n u + phi^T theta = nu. S is skew: it has no part in V'.
    """
    n, q = design.n, design.q
    A, B, M, R = (m.tolist() for m in (design.A, design.B, design.error_matrix, design.R))
    errors = tuple(dot(A[m], s.x) - dot(B[m], s.Y[: q + 1]) for m in range(n))
    rates = tuple(dot(M[m], errors) - R[m] * s.Y[q + 1] for m in range(n))
    decay = (design.c + design.kappa).tolist()
    V_rate = -dot(decay, [e**2 for e in errors]) - dot(R, errors) * s.Y[q + 1]
    return OwnErrors(errors, rates, dot(errors, errors) / 2, V_rate)


def linear_errors(s: Signals, design: PlantCoordinates) -> OwnErrors:
    """xi = x - Pi Y with xi' = M xi - R y_d^(q+1), and V = xi^T P xi/2, M^T P + P M = -2 I."""
    n, q = design.n, design.q
    B, M, R = (m.tolist() for m in (design.B, design.error_matrix, design.R))
    P = solve_continuous_lyapunov(design.error_matrix.T, -2 * np.eye(n)).tolist()
    errors = tuple(s.x[m] - dot(B[m], s.Y[: q + 1]) for m in range(n))
    rates = tuple(dot(M[m], errors) - R[m] * s.Y[q + 1] for m in range(n))
    weighted = [dot(row, errors) for row in P]
    V_rate = -dot(errors, errors) - dot(R, weighted) * s.Y[q + 1]
    return OwnErrors(errors, rates, dot(errors, weighted) / 2, V_rate)


def with_estimates(
    recursive: OwnErrors,
    stated: EstimatedParameters,
    s: Signals,
    g_n: sympy.Expr,
    theta: Sequence[sympy.Expr],
) -> OwnErrors:
    """The same with estimates of 1/g_n and theta: the mismatch, and the leakage in V'."""
    assert recursive.V is not None and recursive.V_rate is not None
    pairs = zip(theta, stated.theta_hat, strict=True)
    delta_error, theta_error = 1 / g_n - stated.delta_hat, [true - hat for true, hat in pairs]
    ubar = s.nu - dot(s.phi, stated.theta_hat)
    mismatch = dot(s.phi, theta_error) - g_n * delta_error * ubar
    energy = abs(g_n) * delta_error**2 / (2 * stated.gain_rate)
    if s.r:
        Gamma = sympy.Matrix([list(row) for row in stated.Gamma])
        errors = sympy.Matrix(theta_error)
        energy += (errors.T * Gamma.inv() * errors)[0] / 2
    apart = [hat - guess for hat, guess in zip(stated.theta_hat, stated.theta0, strict=True)]
    leakage = abs(g_n) * stated.leak_gain * delta_error * (stated.delta_hat - stated.delta0)
    leakage += stated.leak_theta * dot(theta_error, apart)
    return OwnErrors(
        errors=recursive.errors,
        rates=(*recursive.rates[:-1], recursive.rates[-1] + mismatch),
        V=recursive.V + energy,
        V_rate=recursive.V_rate + leakage,
    )
