"""What a design is optimal for, and its margins, as :func:`certrack.design` shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from certrack.laws.cost import Cost, freed_loop, optimal_cost
from certrack.laws.error_system import EstimatedParameters, KnownParameters
from certrack.laws.integral import of_the_chain
from certrack.laws.loop_margins import LoopMargins, loop_margins
from certrack.model.linear_drift import linear_parts, total_drift

if TYPE_CHECKING:
    from certrack.systems.system import System

#: Significant digits of weights and margins in a text.
SHOWN_DIGITS = 4


@dataclass(frozen=True)
class Optimality:
    """Cost and margins of a design, for known g_n and theta and without uncertain terms.

    Attributes
    ----------
    cost : Cost or None
        None for a linear law whose K was given, and for one that states no error system.
    at_v : LoopMargins or None
        At v, what the law adds to the terms that it cancels; None for a law that states no error
        system with known or estimated parameters.
    at_u : LoopMargins or None
        At the input of the plant; None where h + phi^T theta is not linear in x.
    has_integral : bool
        Whether the errors begin with e_0, the integral of the tracking error.
    sampled : bool
        Whether a drive runs the law sampled, of which the margins, in continuous time, say nothing.
    """

    cost: Cost | None
    at_v: LoopMargins | None
    at_u: LoopMargins | None
    has_integral: bool = False
    sampled: bool = False

    def record(self) -> dict[str, Any]:
        """Ready for JSON, but for arrays."""
        cost = self.cost
        return {
            "cost": None
            if cost is None
            else {"state": cost.state, "input": cost.input, "of_states": cost.of_states},
            "margins_at_v": None if self.at_v is None else _record(self.at_v),
            "margins_at_u": None if self.at_u is None else _record(self.at_u),
        }

    def lines(self) -> list[str]:
        """Sentences for a reader."""
        shown, of = [], " (of the continuous law)" if self.sampled else ""
        if self.cost is not None:
            weights = self.cost.state
            first = 0 if self.has_integral else 1
            terms = [f"{_short(v)} e_{i}^2" for i, v in enumerate(weights, first) if v]
            integrand = " + ".join([*terms, f"{_short(self.cost.input)} v^2"])
            states = "(e_0, x - x_d)" if self.has_integral else "x - x_d"
            shown += [
                f"with known parameters and w = 0 it minimises int ({integrand}) dt,",
                f"where v is what the law adds to e_{first + len(weights) - 1}' besides cancelling "
                f"terms of the plant; in {states} the weights of e are",
                *(f"  [{', '.join(map(_short, row))}]" for row in self.cost.of_states.tolist()),
            ]
        if self.at_v is not None:
            shown.append(f"margins at v, what the law adds to the last e': {_words(self.at_v)}{of}")
        if self.at_u is not None:
            shown.append(f"margins at u, the input of the plant: {_words(self.at_u)}{of}")
        return shown


def optimality(system: System) -> Optimality:
    """Cost and margins of a system's design."""
    stated = system.law.error_system(system.controller.signals)
    if not isinstance(stated, KnownParameters | EstimatedParameters):
        return Optimality(None, None, None)
    has_integral = system.controller.coordinates.integral is not None
    coordinates = of_the_chain(system.controller.coordinates)
    M, k = freed_loop(coordinates)
    last = np.eye(coordinates.n)[-1]
    slopes = _linear_part(system)
    at_u = None
    if slopes is not None:
        slopes = np.append(np.zeros(coordinates.n - len(slopes)), slopes)
        plant = np.vstack([coordinates.F, slopes])
        at_u = loop_margins(plant, last, slopes - coordinates.nu_x)
    cost = optimal_cost(system.law, system.plant, coordinates)
    sampled = system.implementation is not None
    return Optimality(cost, loop_margins(M, last, k), at_u, has_integral, sampled)


def _linear_part(system: System) -> np.ndarray | None:
    """The slopes of h + phi^T theta in x; None where it is not linear, or theta is not known."""
    plant = system.plant
    known = plant.theta or system.truth.theta
    if len(known or ()) != plant.r:
        return None
    parts = linear_parts(plant, total_drift(plant, known or ()))
    return None if parts is None else np.array([float(slope) for slope in parts[0]])


def _record(margins: LoopMargins) -> dict[str, Any]:
    return {
        "lowest_gain": margins.lowest_gain,
        "highest_gain": margins.highest_gain,
        "phase": margins.phase,
    }


def _words(margins: LoopMargins) -> str:
    low, high, phase = map(_short, (margins.lowest_gain, margins.highest_gain, margins.phase))
    return f"gain {low} to {high}, phase {phase} degrees"


def _short(value: float) -> str:
    return f"{value + 0.0:.{SHOWN_DIGITS}g}"  # -0 is 0
