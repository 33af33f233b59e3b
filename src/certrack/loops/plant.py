"""The simulated plant as formulas: design and truth -> x' = f(t, x, u), before any controller.

Every number that a sweep may vary is a symbol with a value in a parameter vector, so whatever is
compiled from the formulas serves all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.laws.signals import dot
from certrack.model.plant import Plant
from certrack.systems.system import System

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
    """The truth of `system` as formulas.

    Without states of its own, with b_ij, g_i, tau_i, theta and constants as they really are,

        x_i' = g_i x_{i+1} + sum_j b_ij x_j + tau_i w_i,        i < n
        x_n' = g_n u + h(x) + phi(x)^T theta + tau_n w_n        [5]

    Parameters
    ----------
    system : System

    Returns
    -------
    SimulatedPlant
    """
    if system.truth.states:
        return _truth_with_states(system)
    plant, truth = system.plant, system.truth
    n, x = plant.n, plant.symbols
    present = np.argwhere((plant.b != 0) | (_plant_as_built(system).b != 0))
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


def _truth_with_states(system: System) -> SimulatedPlant:
    """A truth that has states and rates of its own, as the simulated plant."""
    truth, names = system.truth, list(true_constants(system))
    constants = tuple(symbol(f"true_constants_{i}") for i in range(len(names)))
    as_built = dict(zip(map(symbol, names), constants, strict=True))
    torques = truth.motors.torque_formulas(INPUT) if truth.motors else {}
    rates, outputs = (
        tuple(formula.expr.xreplace(torques).xreplace(as_built) for formula in formulas or ())
        for formulas in (truth.rates, truth.outputs)
    )
    states = tuple(map(symbol, truth.states or ()))
    return SimulatedPlant(states, rates, outputs, (("constants", constants),), ())


def plant_values(plant: SimulatedPlant, system: System) -> np.ndarray:
    """Values of :attr:`SimulatedPlant.parameters`.

    Parameters
    ----------
    plant : SimulatedPlant
        That of `system`, or of another system of the same structure.
    system : System

    Returns
    -------
    (P,) array
    """
    truth, built = system.truth, _plant_as_built(system)
    if truth.states:
        return np.array(list(true_constants(system).values()))
    assert truth.tau is not None and truth.input_gain is not None
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


def true_constants(system: System) -> dict[str, float]:
    """The plant's constants as they really are, then the truth's own."""
    built = {name: float(value) for name, value in _plant_as_built(system).constant_values.items()}
    added = {name: float(value.expr) for name, value in system.truth.constants if name not in built}
    return built | added


def measured(system: System, states: np.ndarray) -> np.ndarray:
    """What the controller measures: the states of the design, shape (n, N).

    Parameters
    ----------
    system : System
    states : (S, N) array
        Those of the simulated plant; what follows them is ignored.

    Returns
    -------
    (n, N) array
    """
    truth, count = system.truth, len(system.simulated_states)
    if not truth.states:
        return states[:count]
    constants = true_constants(system)
    values = _compiled_outputs(truth.states, truth.outputs, tuple(constants))
    return rows(values(states[:count], list(constants.values())), states.shape[1])


@lru_cache(maxsize=16)
def _compiled_outputs(states: Any, outputs: Any, constants: Any) -> Callable[..., list[Any]]:
    """The outputs, compiled for every value of the constants."""
    arguments = [tuple(map(symbol, states)), tuple(map(symbol, constants))]
    return numpy_callable(arguments, [formula.expr for formula in outputs])


def _plant_as_built(system: System) -> Plant:
    """The plant with the constants it really has."""
    designed = system.plant.constant_values
    real = {n: float(value.expr) for n, value in system.truth.constants if n in designed}
    return system.plant.with_constants(**real)
