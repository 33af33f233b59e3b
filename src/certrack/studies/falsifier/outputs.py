"""What of a run the falsifier makes large: the error, the input, a state or an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.integrators.base import Outcome
from certrack.loops.continuous import ClosedLoop
from certrack.simulation.run import Run
from certrack.systems.system import System

#: Names of the two outputs that no system names.
ERROR_NAME, INPUT_NAME = "error", "input"

#: Kinds of those that a system does name.
STATE, ESTIMATE = "state", "estimate"


@dataclass(frozen=True)
class SoughtOutput:
    """A signal whose largest magnitude is sought.

    Attributes
    ----------
    name : str
        ``"error"``, ``"input"``, or the name of a state of the plant or of an estimate.
    kind : {"error", "input", "state", "estimate"}
    place : int
        Number of the state or of the estimate, from 0.
    """

    name: str = ERROR_NAME
    kind: str = ERROR_NAME
    place: int = 0

    @property
    def symbol_text(self) -> str:
        """As tables and sentences write it."""
        return {ERROR_NAME: "e_1", INPUT_NAME: "u"}.get(self.kind, self.name)

    def values(self, run: Run) -> Array:
        """The signal at the times of a run."""
        if self.kind == ERROR_NAME:
            return run.e[0]
        if self.kind == INPUT_NAME:
            return run.u
        rows: Array = run.x if self.kind == STATE else run.z
        return rows[self.place]

    def tail(self, run: Run) -> float:
        """Largest magnitude after the transient.

        inf for a run that escapes, 0 for one that ends before its tail.
        """
        if run.outcome is Outcome.escaped:
            return math.inf
        if self.kind == ERROR_NAME:
            largest = float(run.metrics.tail_error)
            return 0.0 if math.isnan(largest) else largest
        late = run.t >= run.system.settings.tail_start
        seen = np.nan_to_num(np.abs(self.values(run)[late]), nan=0.0)
        return float(seen.max(initial=0.0))

    def formula(self, loop: ClosedLoop) -> sympy.Expr:
        """The signal as a formula of the states of a closed loop and of time."""
        if self.kind == ERROR_NAME:
            return loop.e_1
        if self.kind == INPUT_NAME:
            return loop.u
        return loop.states[self.place] if self.kind == STATE else symbol(self.name)


#: The output that certificates are about.
ERROR = SoughtOutput()


def output_named(system: System, name: str) -> SoughtOutput:
    """The output of a system that has this name.

    Parameters
    ----------
    system : System
    name : str

    Raises
    ------
    InputError
        If there is none.
    """
    if name in (ERROR_NAME, INPUT_NAME):
        return SoughtOutput(name, name)
    states, estimates = system.plant.states, [z.name for z in system.controller.states]
    if name in states:
        return SoughtOutput(name, STATE, states.index(name))
    if name in estimates:
        return SoughtOutput(name, ESTIMATE, estimates.index(name))
    known = ", ".join((ERROR_NAME, INPUT_NAME, *states, *estimates))
    raise InputError("of", "must be an output of the system", name, f"Choose one of {known}")


def tail_error(run: Run) -> float:
    """Tail error of a run; inf if it escapes, 0 if it ends before the tail."""
    return ERROR.tail(run)
