"""Simulated plant + sampled controller + reference: what happens at and between the samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, derivative, symbol
from certrack.core.select import STEP_LENGTH
from certrack.loops.continuous import INTEGRAL_SCALE, INTEGRALS
from certrack.loops.controller import (
    COMMAND,
    SampledController,
    controller_values,
    sampled_controller,
)
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
    own : symbols of the reference that a sweep may vary
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
    own: tuple[sympy.Symbol, ...]
    parameters: tuple[sympy.Symbol, ...]
    pieces: tuple[sympy.Symbol, ...]
    totals: Totals

    def with_numbers(self, known: Mapping[sympy.Symbol, sympy.Expr]) -> SampledLoop:
        """The loop with numbers for some parameters, which are none any more."""
        plant, c = self.plant, self.controller

        def put(formulas: Sequence[sympy.Expr]) -> tuple[sympy.Expr, ...]:
            return tuple(formula.xreplace(known) for formula in formulas)

        return replace(
            self,
            plant=replace(plant, rates=put(plant.rates), outputs=put(plant.outputs)),
            controller=replace(
                c,
                steps=tuple((name, formula.xreplace(known)) for name, formula in c.steps),
                update=put(c.update),
            ),
            e_1=self.e_1.xreplace(known),
            slope=self.slope.xreplace(known),
            parameters=tuple(name for name in self.parameters if name not in known),
            totals=tuple((name, formula.xreplace(known)) for name, formula in self.totals),
        )


def sample_loop(
    system: System, totals: Totals | None = None, controller: SampledController | None = None
) -> SampledLoop:
    """Join the parts of a system that has an implementation.

    `controller` is that of the system, where it has been made before.
    """
    if system.implementation is None:
        raise InputError("implementation", "is missing", remedy="Add a table [implementation]")
    plant, reference = simulated_plant(system), system.reference
    made = controller or sampled_controller(system.plant, system.controller, system.implementation)
    Y = dict(zip(made.Y, reference.formulas(len(made.Y) - 1), strict=True))
    controller = replace(
        made,
        steps=tuple((name, formula.xreplace(Y)) for name, formula in made.steps),
        update=tuple(formula.xreplace(Y) for formula in made.update),
    )
    e_1 = plant.outputs[0] - reference.formulas(0)[0]
    rates = dict(zip(plant.states, plant.rates, strict=True)) | {TIME: sympy.Integer(1)}
    present = [name for name in rates if name in e_1.free_symbols]
    slope = sympy.Add(*(derivative(e_1, name) * rates[name] for name in present))
    own = tuple(reference.parameter_symbols)
    every = dict.fromkeys((*plant.parameters, *controller.parameters, *own))
    return SampledLoop(
        plant=plant,
        controller=controller,
        e_1=e_1,
        slope=slope,
        own=own,
        parameters=tuple(every),
        pieces=tuple(reference.piece_symbols),
        totals=totals or run_totals(),
    )


def loop_values(loop: SampledLoop, system: System) -> np.ndarray:
    """Values of :attr:`SampledLoop.parameters` of a loop as :func:`sample_loop` makes it."""
    assert system.implementation is not None
    law = controller_values(loop.controller, system.plant, system.law, system.implementation)
    known: dict[sympy.Symbol, float] = {}
    for names, values in (
        (loop.plant.parameters, plant_values(loop.plant, system)),
        (loop.controller.parameters, law),
        (loop.own, system.reference.parameter_values),
    ):
        known |= dict(zip(names, values, strict=True))
    return np.array([known[name] for name in loop.parameters])


def resolved(controller: SampledController) -> tuple[sympy.Expr, tuple[sympy.Expr, ...]]:
    """The command and the next states as formulas without intermediate steps."""
    known: dict[sympy.Symbol, sympy.Expr] = {}
    for name, formula in controller.steps:
        known[name] = formula.xreplace(known)
    return known[COMMAND], tuple(formula.xreplace(known) for formula in controller.update)
