"""The gains of :mod:`gains` period by period, and the rows themselves: for bounds from a start.

Lag 0 is the period that runs at the output's time, lag l the l-th whole period before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from certrack.certificates.implemented.enclosed import ROUNDOFF, Enclosed, widened
from certrack.certificates.implemented.gains import (
    kernel_columns,
    mean_magnitude,
    powers_of_columns,
    powers_of_rows,
    running_period,
)
from certrack.certificates.implemented.outputs import Row
from certrack.certificates.implemented.period import Period, above, identity


@dataclass(frozen=True)
class Lags:
    """Of each output row, for L = 2^doublings whole periods.

    Attributes
    ----------
    w : (rows, 1 + L, columns of W) array
        Gains from the uncertain terms of each lag, rounded up; those within the cell at the
        output's time are not among them.
    past : (rows, L, N) Enclosed
        The row over the state before the jump of the running period, of the one before it, ...
    units : (N, L, N) Enclosed
        The rows of M^0, M^1, ...
    last : (rows, N) array
        Upper bounds of the magnitudes of the rows L periods back.
    power : (N, N) array
        The same of M^L.
    """

    w: np.ndarray
    past: Enclosed
    units: Enclosed
    last: np.ndarray
    power: np.ndarray


def lags_of(period: Period, rows: Sequence[Row], doublings: int) -> Lags:
    """The lags of output rows.

    Parameters
    ----------
    period : Period
    rows : of :func:`~certrack.certificates.implemented.outputs.output_rows`
    doublings : int
    """
    nw, size, count = period.W.ncols(), period.size, len(rows)
    running, before = running_period(period, rows)
    seen = kernel_columns(period, len(period.cells), smeared=False)
    inner = doublings // 2
    columns, power = powers_of_columns(period.map, seen.all(), inner)
    table = Enclosed.of(columns)
    heads, _ = powers_of_rows(power, above(before, identity(size)), doublings - inner)
    values, error = _products(heads, table, count + size, 2**inner)
    at_rows, off = values[..., -size:], error[..., -size:]
    ends = len(seen.lengths) + 1
    lines = mean_magnitude(*_at_both_ends(values, ends, nw))
    less, more = _at_both_ends(error, ends, nw)
    area = np.einsum("c,rlcw->rlw", seen.lengths, lines + (less + more) / 2)
    w = area + (np.abs(at_rows) + off) @ seen.curvature
    entire = widened(w[:count], size + ends + 16)
    power = period.map
    for _ in range(doublings):
        power = power * power
    return Lags(
        np.concatenate([running[:, None, :nw], entire], axis=1),
        Enclosed(at_rows[:count], off[:count]),
        Enclosed(at_rows[count:], off[count:]),
        Enclosed.of(before * power).upper,
        Enclosed.of(power).upper,
    )


def _at_both_ends(values: np.ndarray, ends: int, nw: int) -> tuple[np.ndarray, np.ndarray]:
    """Kernels of w at both ends of every cell."""
    at_ends = values[:, :, : ends * (nw + 1)].reshape(*values.shape[:2], ends, nw + 1)[..., :nw]
    return at_ends[:, :, :-1], at_ends[:, :, 1:]


def _products(
    heads: Enclosed, table: Enclosed, count: int, block: int
) -> tuple[np.ndarray, np.ndarray]:
    """Heads times table, (rows, periods, columns), and what each entry is off by at most."""
    size = len(table.value)

    def arranged(products: np.ndarray) -> np.ndarray:
        blocks = products.reshape(-1, count, block, products.shape[1] // block)
        return np.swapaxes(blocks, 0, 1).reshape(count, -1, blocks.shape[-1])

    head, entry = np.abs(heads.value), np.abs(table.value)
    off = (2 * (size + 4) * ROUNDOFF * head + heads.error) @ entry
    off += (head + heads.error) @ table.error
    return arranged(heads.value @ table.value), arranged(widened(off, 4 * size))
