"""Where an adversary's numbers go: into a system's text, or into a compiled loop's parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import sympy

from certrack.laws import Law
from certrack.loops.continuous import ClosedLoop, parameter_values
from certrack.model.truth import Truth
from certrack.systems.system import Settings, System


@dataclass
class SystemDraft:
    """A system whose reference, disturbances and true parameters are being replaced.

    Attributes
    ----------
    system : System
    constants : mapping
        Added to those of the plant.
    omega : list of n formulas
    reference, input_gain, theta, law
        As in :class:`System` and :class:`Truth`.
    """

    system: System
    constants: dict[str, float] = field(init=False, default_factory=dict)
    omega: list[str] = field(init=False)
    reference: Any = field(init=False)
    input_gain: Any = field(init=False)
    theta: list[Any] = field(init=False)
    law: Law = field(init=False)

    def __post_init__(self) -> None:
        truth = self.system.truth
        self.omega = ["0"] * self.system.plant.n
        self.reference, self.law = self.system.reference, self.system.law
        self.input_gain, self.theta = truth.input_gain, list(truth.theta)

    def finish(self, settings: Settings) -> System:
        """The system as drafted; the strengths of its disturbances are the admissible ones."""
        plant: Any = self.system.plant
        if self.law is not self.system.law:  # it may have other states
            settings = replace(settings, estimates=None)
        if self.constants:
            plant = replace(plant, constants=dict(plant.constants) | self.constants)
        return System(
            plant=plant,
            law=self.law,
            reference=self.reference,
            truth=Truth(
                self.input_gain,
                tuple(self.theta),
                tuple(self.omega),  # type: ignore[arg-type]
                constants=self.system.truth.constants,
            ),
            settings=settings,
            title=f"Worst case found for: {self.system.title}",
        )


class ParameterTable:
    """Parameters of a compiled loop for several members, (P, N); at first all as in the system.

    Parameters
    ----------
    loop : ClosedLoop
    system : System
        The system of this loop.
    count : int
        Members.

    Attributes
    ----------
    written : set of symbols
        The parameters that were set.
    """

    def __init__(self, loop: ClosedLoop, system: System, count: int) -> None:
        self.values = np.repeat(parameter_values(loop, system)[:, None], count, axis=1)
        self._loop, self.written = loop, set[sympy.Symbol]()
        self._row = {symbol.name: i for i, symbol in enumerate(loop.parameters)}
        self._constants = list(system.plant.constant_values)

    def set(self, name: str, values: np.ndarray) -> None:
        """Give a parameter of the loop its values (N,)."""
        row = self._row[name]
        self.written.add(self._loop.parameters[row])
        self.values[row] = values

    def set_constant(self, name: str, values: np.ndarray) -> None:
        """Give a constant of the plant its values, the designer's and the true one."""
        self.set(name, values)
        self.set(f"true_constants_{self._constants.index(name)}", values)
