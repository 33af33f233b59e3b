"""A sampled controller whose steps are linear: the slopes of what it computes, as formulas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import sympy

from certrack.core.select import Select
from certrack.laws.base import Controller
from certrack.laws.equations import Equations
from certrack.loops.controller import FIRST, SampledController, resolved, sampled_controller
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant


@dataclass(frozen=True)
class LinearController:
    """The command and the next memories, from the second sample on and within all limits.

    Attributes
    ----------
    controller : SampledController
    states : symbols
        The memories that still bear on something then.
    presets : formulas, one per state
        As in :class:`~certrack.loops.controller.SampledController`.
    formulas : the command, then the next value of each state
    """

    controller: SampledController
    states: tuple[sympy.Symbol, ...]
    presets: tuple[sympy.Expr, ...]
    formulas: tuple[sympy.Expr, ...]

    def slopes(self, by: Sequence[sympy.Symbol]) -> list[list[sympy.Expr]]:
        """Of every formula, a row each."""
        return [[sympy.diff(formula, v) for v in by] for formula in self.formulas]


def linear_controller(
    plant: Plant, controller: Controller, implementation: Implementation, u: sympy.Expr
) -> LinearController:
    """The controller of an input that is linear in the states and the reference.

    Parameters
    ----------
    plant : Plant
    controller : Controller
    implementation : Implementation
        Its limits are left out.
    u : formula
        In the place of the law's.
    """
    unlimited = replace(implementation, saturation=None, rate_limit=None, projection=None)
    equations = Equations(u=u, update=controller.equations.update)
    sampled = sampled_controller(plant, replace(controller, equations=equations), unlimited)
    command, update = resolved(sampled)
    formulas = [after_first_sample(formula) for formula in (command, *update)]
    used = [i for i, formula in enumerate(formulas[1:]) if formula != 0]
    return LinearController(
        sampled,
        tuple(sampled.states[i] for i in used),
        tuple(sampled.presets[i] for i in used),
        (formulas[0], *(formulas[i + 1] for i in used)),
    )


def after_first_sample(formula: sympy.Expr) -> sympy.Expr:
    """The formula from the second sample on."""
    formula = formula.xreplace({FIRST: sympy.S.Zero})
    return formula.replace(lambda f: isinstance(f, Select) and f.args[0] == 0, lambda f: f.args[3])
