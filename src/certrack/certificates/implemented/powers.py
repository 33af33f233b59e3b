"""Rows and columns times the powers of a period's map: blocks of balls, as floats with errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.outputs import Row
from certrack.certificates.implemented.period import Period
from certrack.core.ball_matrices import above, identity


@dataclass(frozen=True)
class PastRows:
    """Rows, and the unit rows below them, pushed back in time by whole blocks of periods.

    Attributes
    ----------
    heads : Enclosed
        lambda M^{bK}, one block above the other.
    last : (rows, N) array
        Magnitudes of the rows after all periods.
    """

    heads: Enclosed
    last: np.ndarray

    @classmethod
    def of(cls, period: Period, rows: flint.arb_mat, doublings: int) -> PastRows:
        """Those of 2^doublings periods; `rows` are right before a jump."""
        jumped = period.map
        for _ in range(doublings // 2):
            jumped = jumped * jumped
        return cls(*powers_of_rows(jumped, rows, doublings - doublings // 2))

    @classmethod
    def of_outputs(cls, period: Period, rows: Sequence[Row], doublings: int) -> PastRows:
        """Those of rows of outputs, and of unit rows."""
        past = above(rows_before_jump(period, rows), identity(period.size))
        return cls.of(period, past, doublings)


def rows_before_jump(period: Period, rows: Sequence[Row]) -> flint.arb_mat:
    """The rows, pushed back to before the jump of their period."""
    past: list[list[Any]] = [[] for _ in rows]
    for phase in range(len(period.cells)):
        chosen = [i for i, row in enumerate(rows) if row.phase == phase]
        if chosen:
            matrix = flint.arb_mat([list(rows[i].row) for i in chosen])
            before = (matrix * (period.since_jump(phase)[-1] * period.jump)).tolist()
            for i, entries in zip(chosen, before, strict=True):
                past[i] = entries
    return flint.arb_mat(past)


def powers_of_columns(
    M: flint.arb_mat, columns: flint.arb_mat, doublings: int
) -> tuple[Enclosed, flint.arb_mat]:
    """2^doublings of columns, M columns, M^2 columns ... side by side; and the next power of M."""
    blocks, power = _power_blocks(M, doublings, [columns], lambda power, block: power * block)
    return Enclosed.of_blocks(blocks, axis=1), power


def powers_of_rows(
    power: flint.arb_mat, rows: flint.arb_mat, doublings: int
) -> tuple[Enclosed, np.ndarray]:
    """2^doublings of rows, rows P, rows P^2 ..., one above the other; magnitudes of the next."""
    blocks, power = _power_blocks(power, doublings, [rows], lambda power, block: block * power)
    return Enclosed.of_blocks(blocks, axis=0), Enclosed.of(rows * power).upper


def _power_blocks(
    power: flint.arb_mat, doublings: int, blocks: list[flint.arb_mat], product: Any
) -> tuple[list[flint.arb_mat], flint.arb_mat]:
    """The block times P^0, P^1 ..., and the next power: to join balls costs more than products."""
    for _ in range(doublings):
        blocks = blocks + [product(power, block) for block in blocks]
        power = power * power
    return blocks, power
