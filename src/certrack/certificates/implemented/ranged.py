"""The sampled loop for all constants in a cell of their ranges: its centre, and channels.

The law, its conversion of differences too, knows the nominal constants. The plant is

    x' = (A | b | o)(p) (x, u, 1) + W w,    (A | b | o)(p) = centre + sum_k columns_k delta_k rows_k

with a delta_k in [-1, 1] for every function of the constants, as :mod:`..ranges.coefficients` has
them. Each row is an output of the loop, and each column an input that this output bounds: the
constants may vary in time within the cell. The centre of o and the constants of the rows are
bounded inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import flint
import numpy as np
import sympy

from certrack.certificates.arithmetic import as_sympy, rational
from certrack.certificates.balls import ball_matrix
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.channels import Channel
from certrack.certificates.implemented.drive import (
    DRIVE_BITS,
    Drive,
    UncertainBound,
    drive_of,
    linear_drift,
    nominal_drive,
)
from certrack.certificates.ranges.cells import Cell
from certrack.certificates.ranges.coefficients import Coefficients
from certrack.certificates.ranges.loop import RangedLoop, ranged_loop
from certrack.systems.system import System


class RangedPlant:
    """The plant of a sampled loop as a function of what has a range.

    Parameters
    ----------
    system : System
        With an implementation.

    Raises
    ------
    NoCertificate
        If the loop is not covered, with the reason.
    """

    def __init__(self, system: System) -> None:
        self._nominal = cache(partial(nominal_drive, system))
        self._nominal(None)  # refuses what is not covered whatever the ranges are
        self.system = system
        self.loop: RangedLoop = ranged_loop(system)
        if self.loop.brackets:
            raise NoCertificate(
                "only loops that are linear are covered as implemented: a nonlinear term of "
                "plant.drift is not zero everywhere in plant.ranges"
            )
        self._coefficients = Coefficients(replace(self.loop, still=_plant_matrix(self.loop)))

    @property
    def box(self) -> Cell:
        """All that the constants may be."""
        return self.loop.box

    @property
    def varies(self) -> bool:
        """Whether the constants may vary in time."""
        return bool(self.system.plant.uncertainty.constants_vary)

    def drive(self, cell: Cell, delay: Any | None = None) -> Drive:
        """The loop for constants in a cell, for one delay in periods.

        Raises
        ------
        NoCertificate
            If a denominator may vanish in the cell.
        """
        channels = self._coefficients.over(cell)
        nominal, n = self._nominal(delay), self.loop.n
        offset = abs(channels.centre[n - 1, n + 1])
        count = len(channels.rows)
        uncertain = [
            replace(bound, weights=_longer(bound.weights, count), Delta=_longer(bound.Delta, count))
            for bound in nominal.uncertain
        ]
        zero = flint.fmpq(0)
        columns = [np.array([zero] * (n - 1) + [flint.fmpq(1)], dtype=object), *channels.columns.T]
        none = (zero,) * (n + count)
        uncertain.append(UncertainBound(zero, offset, none, none))
        for k, row in enumerate(channels.rows):
            unit = (*none[: n + k], flint.fmpq(1), *none[n + k + 1 :])
            uncertain.append(UncertainBound(zero, abs(row[n + 1]), none, unit))
        with flint.ctx.workprec(DRIVE_BITS):
            wide = [
                [*nominal.W.tolist()[i], *(flint.arb(column[i]) for column in columns)]
                for i in range(n)
            ]
            return replace(
                nominal,
                A=ball_matrix(channels.centre[:, :n].tolist()),
                b=ball_matrix(channels.centre[:, n : n + 1].tolist()),
                W=flint.arb_mat(wide),
                uncertain=tuple(uncertain),
                channels=tuple(Channel(tuple(row[:n]), row[n]) for row in channels.rows),
            )


def drive_in(system: System, delay: Any, cell: Cell, plant: RangedPlant | None = None) -> Drive:
    """The loop of a system, for constants in a cell; without a cell the one that has no ranges.

    Raises
    ------
    NoCertificate
        If it is not covered.
    """
    if not cell:
        return drive_of(system, delay)
    return (plant or RangedPlant(system)).drive(cell, delay)


def refuse_in_cells(system: System, cell: Sequence[Any]) -> None:
    """Raise NoCertificate where constants have ranges and a bound is a formula, or times move."""
    drive = system.implementation
    stated = {
        "plant.uncertainty.bound": system.plant.uncertainty.bound is not None,
        "implementation.jitter": drive is not None and drive.jitter > 0,
    }
    if cell and any(stated.values()):
        what = " and ".join(name for name, is_stated in stated.items() if is_stated)
        raise NoCertificate(
            f"{what} {'is' if sum(stated.values()) == 1 else 'are'} not covered together with "
            "ranges of constants: leave it or plant.ranges out"
        )


def _plant_matrix(loop: RangedLoop) -> sympy.Matrix:
    """(A | b | o)(p): the closed loop of `loop`, opened again.

    Its last row is rho (nu_x x + nu_Y Y') + the rest of h, with rho = g_n(p)/g_n(p_0).
    """
    c, n = loop.coordinates, loop.n
    slopes, _ = linear_drift(loop.system)
    gain = rational(loop.system.plant.input_gain)
    rho = loop.gain_ratio
    matrix = sympy.zeros(n, n + 2)
    matrix[: n - 1, :n] = loop.matrix[: n - 1, :n]
    for j in range(n):
        opened = loop.matrix[n - 1, j] + rho * (as_sympy(slopes[j]) - as_sympy(c.nu_x[j]))
        matrix[n - 1, j] = sympy.cancel(sympy.together(opened))
    matrix[n - 1, n] = sympy.cancel(rho * as_sympy(gain))
    matrix[n - 1, n + 1] = loop.matrix[n - 1, n + c.q + 2]
    return matrix


def _longer(values: Sequence[Any], count: int) -> tuple[Any, ...]:
    return (*values, *(flint.fmpq(0),) * count)
