"""The closed loop in continuous time: plant, law and reference as one differential equation.

State vector: plant x, controller z, then the integrals of u^2, e_1^2 and e_1 (metrics are
integrated, not summed on a grid). Every number that a sweep may vary - gains, truth, constants,
the current piece of the reference - is a symbol with a value in a parameter vector, so the loop is
compiled once per plant and law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.loops.plant import INPUT, SimulatedPlant, plant_values, simulated_plant
from certrack.systems.system import System

#: Integrals appended to the state: of u^2, e_1^2 and e_1.
INTEGRALS = ("integral_u2", "integral_e2", "integral_e")

#: They are integrated in this unit, so that a large one does not loosen the error control of x.
INTEGRAL_SCALE = 2.0**20


@dataclass(frozen=True)
class ClosedLoop:
    """The closed loop as formulas; equal for systems that one compiled integrator can serve.

    Attributes
    ----------
    plant : SimulatedPlant
    states : symbols of x, z and the integrals
    parameters : symbols
        Those of :func:`parameter_values`, then those of the reference's current piece.
    rates : formulas, one per state
    u : formula
        The control input.
    e_1 : formula
        The tracking error.
    gain_names : names of the law's gains among the parameters
    pieces : int
        Number of parameters, the last ones, that belong to the reference's piece.
    """

    plant: SimulatedPlant
    states: tuple[sympy.Symbol, ...]
    parameters: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]
    u: sympy.Expr
    e_1: sympy.Expr
    gain_names: tuple[str, ...]
    pieces: int

    @property
    def n(self) -> int:
        """Number of plant states; they come first."""
        return self.plant.n


def close_loop(system: System) -> ClosedLoop:
    """The closed loop of `system` as one ODE: its implementation, if any, is left out.

    Parameters
    ----------
    system : System

    Returns
    -------
    ClosedLoop
    """
    plant, controller = simulated_plant(system), system.controller
    Y = system.reference.formulas(len(controller.signals.Y) - 1)
    u, e_1, rates = driven_loop(system, plant, Y)
    rates += [rate / sympy.Integer(INTEGRAL_SCALE) for rate in (u**2, e_1**2, e_1)]

    designed = [symbol(name) for name in system.plant.constant_values]
    reference = system.reference.parameter_symbols
    pieces = system.reference.piece_symbols
    return ClosedLoop(
        plant=plant,
        states=(*plant.states, *controller.states, *map(symbol, INTEGRALS)),
        parameters=(*plant.parameters, *controller.symbols, *designed, *reference, *pieces),
        rates=tuple(rates),
        u=u,
        e_1=e_1,
        gain_names=tuple(controller.signals.all_parameters),
        pieces=len(pieces),
    )


def driven_loop(
    system: System, plant: SimulatedPlant, Y: Sequence[sympy.Expr]
) -> tuple[sympy.Expr, sympy.Expr, list[sympy.Expr]]:
    """u, e_1 and the rates of plant and controller, the reference given.

    Parameters
    ----------
    system : System
    plant : SimulatedPlant
        Its own.
    Y : formulas of y_d, y_d' ... as far as the law uses them
    """
    controller = system.controller
    s = controller.signals
    measured = dict(zip(s.x, plant.outputs, strict=True)) | dict(zip(s.Y, Y, strict=True))
    u = controller.equations.u.xreplace(measured)
    rates = [rate.xreplace({INPUT: u}) for rate in plant.rates]
    measured[s.applied] = u
    rates += [rate.xreplace(measured) for _, rate in controller.equations.update]
    return u, (s.x[0] - s.Y[0]).xreplace(measured), rates


def parameter_values(loop: ClosedLoop, system: System) -> np.ndarray:
    """Values of :attr:`ClosedLoop.parameters`, without those of the reference's piece.

    Parameters
    ----------
    loop : ClosedLoop
        That of `system`, or of another system of the same structure.
    system : System

    Returns
    -------
    (P,) array
    """
    return np.concatenate(
        [
            plant_values(loop.plant, system),
            system.controller.values_of(loop.gain_names),
            [float(value) for value in system.plant.constant_values.values()],
            system.reference.parameter_values,
        ]
    )
