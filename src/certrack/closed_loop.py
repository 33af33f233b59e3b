"""Plant + law + reference + truth -> one ordinary differential equation.

State vector: plant x, controller z, then the integrals of u^2, e_1^2 and e_1 (metrics are
integrated, not summed on a grid). Every number that a sweep may vary - gains, truth, constants,
the current piece of the reference - is a symbol with a value in a parameter vector, so the loop is
compiled once per plant and law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy

from certrack.expressions import symbol
from certrack.laws.base import dot
from certrack.plant import Plant
from certrack.system import System

#: Integrals appended to the state: of u^2, e_1^2 and e_1.
INTEGRALS = ("integral_u2", "integral_e2", "integral_e")

#: They are integrated in this unit, so that a large one does not loosen the error control of x.
INTEGRAL_SCALE = 2.0**20


@dataclass(frozen=True)
class ClosedLoop:
    """The closed loop as formulas; equal for systems that one compiled integrator can serve.

    Attributes
    ----------
    states : symbols of x, z and the integrals
    parameters : symbols
        Those of :func:`parameter_values`, then those of the reference's current piece.
    rates : formulas, one per state
    u : formula
        The control input.
    e_1 : formula
        The tracking error.
    n : int
        Number of plant states; they come first.
    couplings : positions (i, j) of the b_ij that are not structurally zero
    gain_names : names of the law's gains among the parameters
    pieces : int
        Number of parameters, the last ones, that belong to the reference's piece.
    """

    states: tuple[sympy.Symbol, ...]
    parameters: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]
    u: sympy.Expr
    e_1: sympy.Expr
    n: int
    couplings: tuple[tuple[int, int], ...]
    gain_names: tuple[str, ...]
    pieces: int


def close_loop(system: System) -> ClosedLoop:
    """Join the parts of `system` into one ODE."""
    plant, truth, controller = system.plant, system.truth, system.controller
    s, n, x = controller.signals, plant.n, plant.symbols
    reference = dict(zip(s.Y, system.reference.formulas(len(s.Y) - 1), strict=True))
    u = controller.equations.u.xreplace(reference)
    e_1 = x[0] - reference[s.Y[0]]

    present = np.argwhere((plant.b != 0) | (_built(system).b != 0))
    couplings = tuple((int(i), int(j)) for i, j in present)
    designed = [symbol(name) for name in plant.constant_values]
    true = {
        name: [symbol(f"true_{name}_{i}") for i in range(count)]
        for name, count in {
            "g": n,
            "b": len(couplings),
            "theta": plant.r,
            "tau": n,
            "constants": len(designed),
        }.items()
    }
    as_built = dict(zip(designed, true["constants"], strict=True))
    h = plant.drift.expr.xreplace(as_built)
    phi = [value.expr.xreplace(as_built) for value in plant.regressor]
    w = [value.expr.xreplace(as_built) for value in truth.omega or ()]

    rates = [g * following for g, following in zip(true["g"], x[1:], strict=False)]
    for b, (i, j) in zip(true["b"], couplings, strict=True):
        rates[i] += b * x[j]
    rates.append(h + true["g"][-1] * u + dot(phi, true["theta"]))
    rates = [
        rate + tau * term for rate, tau, term in zip(rates, true["tau"], w, strict=True)
    ]  # [5]
    rates += [rate.xreplace(reference) for _, rate in controller.equations.update]
    rates += [rate / sympy.Integer(INTEGRAL_SCALE) for rate in (u**2, e_1**2, e_1)]

    own = system.reference.parameter_symbols
    pieces = system.reference.piece_symbols
    groups = [*true.values(), controller.symbols, designed, own, pieces]
    return ClosedLoop(
        states=(*x, *controller.states, *map(symbol, INTEGRALS)),
        parameters=tuple(parameter for group in groups for parameter in group),
        rates=tuple(rates),
        u=u,
        e_1=e_1,
        n=n,
        couplings=couplings,
        gain_names=tuple(s.all_parameters),
        pieces=len(pieces),
    )


def parameter_values(loop: ClosedLoop, system: System) -> np.ndarray:
    """Values of :attr:`ClosedLoop.parameters`, without those of the reference's piece."""
    plant, truth, built = system.plant, system.truth, _built(system)
    assert truth.tau is not None
    return np.concatenate(
        [
            built.g,
            [float(truth.input_gain.expr)],
            [built.b[i, j] for i, j in loop.couplings],
            [float(value.expr) for value in truth.theta],
            truth.tau,
            [float(value) for value in built.constant_values.values()],
            system.law.values(plant, loop.gain_names),
            [float(value) for value in plant.constant_values.values()],
            system.reference.parameter_values,
        ]
    )


def _built(system: System) -> Plant:
    """The plant with the constants it really has."""
    if not system.truth.constants:
        return system.plant
    return system.plant.with_constants(
        **{name: float(value.expr) for name, value in system.truth.constants}
    )
