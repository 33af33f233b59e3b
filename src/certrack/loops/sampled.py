"""The closed loop with a sampled controller: what happens at and between the samples.

At a sample the controller of :mod:`certrack.loops.controller`, with the reference put in, gives the
command; between two samples the plant moves under constant input, while totals are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.kinks import along
from certrack.core.select import STEP_LENGTH
from certrack.loops.continuous import INTEGRAL_SCALE, INTEGRALS
from certrack.loops.controller import (
    SampledController,
    sampled_controller,
)
from certrack.loops.controller_values import controller_values
from certrack.loops.plant import INPUT, SimulatedPlant, plant_values, simulated_plant
from certrack.systems.system import System

#: Of a step between samples: e_1 and its rate at both ends, and the integrals of e_1^2 and e_1.
#: Formulas of what is totalled may contain them.
SIDES = tuple(symbol(f"kept_{name}") for name in ("e_begin", "e_end", "rate_begin", "rate_end"))
SQUARE, AREA = symbol("kept_square"), symbol("kept_area")

#: Pairs (symbol, formula after a step); the formula may contain its own and the other symbols.
Totals = tuple[tuple[sympy.Symbol, sympy.Expr], ...]


def run_totals() -> Totals:
    """The integrals that a single run keeps, as in :data:`certrack.loops.continuous.INTEGRALS`."""
    rises = (STEP_LENGTH * INPUT**2, SQUARE, AREA)
    names = map(symbol, INTEGRALS)
    return tuple(
        (name, name + rise / sympy.Integer(INTEGRAL_SCALE))
        for name, rise in zip(names, rises, strict=True)
    )


@dataclass(frozen=True)
class SampledLoop:
    """A sampled loop as formulas; equal for systems that one compiled integrator can serve.

    Attributes
    ----------
    plant : SimulatedPlant
    controller : SampledController
        With the reference put in for Y.
    e_1 : formula of the plant's states, time and parameters
    slope : formula
        Rate of e_1; it may contain :data:`INPUT`.
    reference_parameters : symbols
        Of the reference, that a sweep may vary.
    parameters : symbols
        All that have a value: of plant, controller and reference.
    pieces : symbols
        Whose values hold from break to break: the reference's current piece.
    totals : Totals
    """

    plant: SimulatedPlant
    controller: SampledController
    e_1: sympy.Expr
    slope: sympy.Expr
    reference_parameters: tuple[sympy.Symbol, ...]
    parameters: tuple[sympy.Symbol, ...]
    pieces: tuple[sympy.Symbol, ...]
    totals: Totals

    @property
    def formulas(self) -> tuple[sympy.Expr, ...]:
        """All formulas in which parameters may occur."""
        plant, steps = self.plant, [formula for _, formula in self.controller.steps]
        totals = [formula for _, formula in self.totals]
        of_time = (self.e_1, self.slope)
        return (*plant.rates, *plant.outputs, *steps, *self.controller.update, *of_time, *totals)

    def with_numbers(self, known: Mapping[sympy.Symbol, sympy.Expr]) -> SampledLoop:
        """The loop with numbers put in for parameters, which it then no longer has."""
        changed = self.with_formulas([formula.xreplace(known) for formula in self.formulas])
        left = tuple(name for name in self.parameters if name not in known)
        return replace(changed, parameters=left)

    def with_formulas(self, formulas: Sequence[sympy.Expr]) -> SampledLoop:
        """The loop with others in the place of :attr:`formulas`, in their order."""
        plant, c, following = self.plant, self.controller, iter(formulas)

        def as_many(old: Sequence[sympy.Expr]) -> tuple[sympy.Expr, ...]:
            return tuple(islice(following, len(old)))

        def named(pairs: Totals) -> Totals:
            return tuple((name, next(following)) for name, _ in pairs)

        return replace(
            self,
            plant=replace(plant, rates=as_many(plant.rates), outputs=as_many(plant.outputs)),
            controller=replace(c, steps=named(c.steps), update=as_many(c.update)),
            e_1=next(following),
            slope=next(following),
            totals=named(self.totals),
        )


def sample_loop(
    system: System, totals: Totals | None = None, controller: SampledController | None = None
) -> SampledLoop:
    """The closed loop of a system that has an implementation.

    Parameters
    ----------
    system : System
    totals : Totals, optional
        What is kept from step to step; by default the integrals of a single run.
    controller : SampledController, optional
        That of the system, where it has been made before.

    Returns
    -------
    SampledLoop

    Raises
    ------
    InputError
        If it has no implementation.
    """
    if system.implementation is None:
        raise InputError("implementation", "is missing", remedy="Add a table [implementation]")
    plant, reference = simulated_plant(system), system.reference
    if controller is None:
        controller = sampled_controller(system.plant, system.controller, system.implementation)
    Y = dict(zip(controller.Y, reference.formulas(len(controller.Y) - 1), strict=True))
    controller = replace(
        controller,
        steps=tuple((name, formula.xreplace(Y)) for name, formula in controller.steps),
        update=tuple(formula.xreplace(Y) for formula in controller.update),
    )
    e_1 = plant.outputs[0] - reference.formulas(0)[0]
    slope = along(e_1, dict(zip(plant.states, plant.rates, strict=True)))
    reference_parameters = tuple(reference.parameter_symbols)
    parameters = (*plant.parameters, *controller.parameters, *reference_parameters)
    return SampledLoop(
        plant=plant,
        controller=controller,
        e_1=e_1,
        slope=slope,
        reference_parameters=reference_parameters,
        parameters=tuple(dict.fromkeys(parameters)),
        pieces=tuple(reference.piece_symbols),
        totals=totals or run_totals(),
    )


def loop_values(loop: SampledLoop, system: System) -> np.ndarray:
    """Values of :attr:`SampledLoop.parameters` of a loop as :func:`sample_loop` makes it.

    Parameters
    ----------
    loop : SampledLoop
        That of `system`, or of another system of the same structure.
    system : System

    Returns
    -------
    (P,) array
    """
    assert system.implementation is not None
    law = controller_values(loop.controller, system.plant, system.law, system.implementation)
    known: dict[sympy.Symbol, float] = {}
    for names, values in (
        (loop.plant.parameters, plant_values(loop.plant, system)),
        (loop.controller.parameters, law),
        (loop.reference_parameters, system.reference.parameter_values),
    ):
        known |= dict(zip(names, values, strict=True))
    return np.array([known[name] for name in loop.parameters])
