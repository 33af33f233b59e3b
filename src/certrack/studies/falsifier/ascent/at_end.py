"""What is sought of a controlled loop, at the end of its run, and its slopes there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.kinks import derivative
from certrack.core.lowering import numpy_callable
from certrack.integrators.controlled import ControlledFlow


class EndSlopes(NamedTuple):
    """Derivatives of what is sought.

    Attributes
    ----------
    by_states : (S, N) array
    by_controls : (C, N) array
    by_parameters : (P, N) array
    """

    by_states: Array
    by_controls: Array
    by_parameters: Array


class SoughtAtEnd:
    """A formula of states, controls and parameters.

    Parameters
    ----------
    flow : ControlledFlow
    formula : formula

    Attributes
    ----------
    is_linear : bool
        Whether its derivatives are numbers.
    """

    def __init__(self, flow: ControlledFlow, formula: sympy.Expr) -> None:
        groups = (flow.states, flow.controls, flow.parameters)
        slopes = [derivative(formula, by) for group in groups for by in group]
        self._sizes = [len(group) for group in groups]
        self._value = numpy_callable(groups, [formula])
        self._slopes = numpy_callable(groups, slopes)
        self.is_linear = not any(slope.free_symbols for slope in slopes)

    def values(self, x: Array, c: Array, p: Array) -> Array:
        """Of every member, from (S, N) states, (C, N) controls and (P, N) parameters."""
        with np.errstate(all="ignore"):
            (value,) = self._value(x, c, p)
        return np.array(np.broadcast_to(value, x.shape[1:]), dtype=float)

    def slopes(self, x: Array | None, c: Array, p: Array) -> EndSlopes:
        """The derivatives at these; of a linear formula the states are not needed."""
        count = c.shape[1]
        at = np.zeros((self._sizes[0], count)) if x is None else x
        with np.errstate(all="ignore"):
            rows = self._slopes(at, c, p)
        table = np.array([np.broadcast_to(row, (count,)) for row in rows], dtype=float)
        return EndSlopes(*np.split(table, np.cumsum(self._sizes)[:-1]))
