"""Plant + truth -> x' = f(t, x, u): what is simulated, before any controller is joined to it.

Every number that a sweep may vary is a symbol with a value in a parameter vector, so whatever is
compiled from the formulas serves all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy

from certrack.expressions import symbol
from certrack.laws.base import dot
from certrack.plant import Plant
from certrack.system import System

#: The input in the rates.
INPUT = symbol("u")


@dataclass(frozen=True)
class SimulatedPlant:
    """The plant as it is simulated.

    Attributes
    ----------
    states : symbols
    rates : formulas in time, states, :data:`INPUT` and parameters; one per state
    outputs : formulas, one per state of the design
        What the controller measures.
    groups : pairs (name, symbols)
        Parameters, in the order of :func:`plant_values`.
    couplings : positions (i, j) of the b_ij that are not structurally zero
    """

    states: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]
    outputs: tuple[sympy.Expr, ...]
    groups: tuple[tuple[str, tuple[sympy.Symbol, ...]], ...]
    couplings: tuple[tuple[int, int], ...]

    @cached_property
    def parameters(self) -> tuple[sympy.Symbol, ...]:
        """All symbols that have a value."""
        return tuple(parameter for _, group in self.groups for parameter in group)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)


def simulated_plant(system: System) -> SimulatedPlant:
    """The truth of `system` as formulas."""
    plant, truth = system.plant, system.truth
    n, x = plant.n, plant.symbols
    present = np.argwhere((plant.b != 0) | (_built(system).b != 0))
    couplings = tuple((int(i), int(j)) for i, j in present)
    designed = [symbol(name) for name in plant.constant_values]
    true = {
        name: tuple(symbol(f"true_{name}_{i}") for i in range(count))
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
    rates.append(h + true["g"][-1] * INPUT + dot(phi, true["theta"]))
    rates = [
        rate + tau * term for rate, tau, term in zip(rates, true["tau"], w, strict=True)
    ]  # [5]
    return SimulatedPlant(x, tuple(rates), x, tuple(true.items()), couplings)


def plant_values(plant: SimulatedPlant, system: System) -> np.ndarray:
    """Values of :attr:`SimulatedPlant.parameters`."""
    truth, built = system.truth, _built(system)
    assert truth.tau is not None
    return np.concatenate(
        [
            built.g,
            [float(truth.input_gain.expr)],
            [built.b[i, j] for i, j in plant.couplings],
            [float(value.expr) for value in truth.theta],
            truth.tau,
            [float(value) for value in built.constant_values.values()],
        ]
    )


def _built(system: System) -> Plant:
    """The plant with the constants it really has."""
    if not system.truth.constants:
        return system.plant
    return system.plant.with_constants(
        **{name: float(value.expr) for name, value in system.truth.constants}
    )
