"""Outputs of a linear loop as rows over its states and its reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import symbol
from certrack.studies.falsifier.outputs import ERROR_NAME, INPUT_NAME, STATE, SoughtOutput
from certrack.systems.system import System


@dataclass(frozen=True)
class OutputRow:
    """of_x x + of_Y (y_d ... y_d^(m)) + constant.

    Attributes
    ----------
    of_x : (n,) array
    of_Y : (m+1,) array
    constant : float
        At least 0.
    """

    of_x: Array
    of_Y: Array
    constant: float = 0.0


def error_row(n: int, m: int) -> OutputRow:
    """The row of e_1 = x_1 - y_d."""
    return OutputRow(np.eye(n)[0], -np.eye(m + 1)[0])


def row_of(system: System, output: SoughtOutput, m: int) -> OutputRow | None:
    """The row of an output, or of its negative; None where there is none.

    Parameters
    ----------
    system : System
    output : SoughtOutput
    m : int
        The highest derivative of the reference that counts.
    """
    n = system.plant.n
    if output.kind == ERROR_NAME:
        return error_row(n, m)
    if output.kind == STATE:
        return OutputRow(np.eye(n)[output.place], np.zeros(m + 1))
    return _input_row(system, m) if output.kind == INPUT_NAME else None


def _input_row(system: System, m: int) -> OutputRow | None:
    """The law's formula of u, with its numbers; None where it is not linear."""
    controller, signals = system.controller, system.controller.signals
    numbers = dict(zip(controller.symbols, controller.values, strict=True))
    numbers |= {symbol(name): v for name, v in system.plant.constant_values.items()}
    floats = {name: sympy.Float(float(value)) for name, value in numbers.items()}
    u = sympy.expand(controller.equations.u.xreplace(floats))
    arguments = [*signals.x, *signals.Y]
    slopes = [sympy.diff(u, name) for name in arguments]
    constant = u.xreplace(dict.fromkeys(arguments, sympy.S.Zero))
    if len(signals.Y) > m + 1 or any(part.free_symbols for part in (*slopes, constant)):
        return None
    sense = -1.0 if constant < 0 else 1.0
    row = sense * np.array(slopes, dtype=float)
    of_Y = np.zeros(m + 1)
    of_Y[: len(signals.Y)] = row[system.plant.n :]
    return OutputRow(row[: system.plant.n], of_Y, sense * float(constant))
