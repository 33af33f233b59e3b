"""Partial cancellation of the reference's derivatives: the smallest of several bounds counts.

Let chi = Pi Y + zeta with any Pi at the beginning of cell p and any Pi' at its end. Then

    zeta <- E_p zeta + D Y(t_p) + int (e^{A(h-s)} W w - Pi' Gamma(h-s) r) ds,
    D = E_p Pi - Pi' Phi(h),

so what Pi does not follow of the loop's own motion acts as D Y, at most |lambda D| (Y_0 ... Y_q) on
a row. :mod:`.period` takes the Pi with D = 0: all derivatives below y_d^(q+1) are cancelled. That
is not good where the plant differs from the law's, or a filter lags: what is cancelled and what
y_d^(q+1) drives then have opposite signs, and are counted apart. The other end is e = 0: the states
are what the law wants them to be, x_d = A^-1 B Y, the memories and inputs what the controller makes
of that, and D is what the loop does not obey of it. Level s cancels the derivatives below y_d^(s)
and is like e = 0 in the others, column by column of Pi; a jump leaves nothing in either, so only
cells have a D. The kernel of w is that of every level: only the reference's part of a row differs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import flint
import numpy as np

from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.gains import (
    KernelColumns,
    sums_of_periods,
    sums_over_time,
    tail_gains,
    upper_number,
)
from certrack.certificates.implemented.outputs import Row
from certrack.certificates.implemented.period import Period, gamma, shift
from certrack.certificates.implemented.powers import PastRows
from certrack.core.ball_matrices import above, beside, column, identity


@dataclass(frozen=True)
class Level:
    """A motion of the loop with the reference that it need not obey.

    Attributes
    ----------
    Pi : J + 1 ball matrices (N, q + 1)
        At the beginning of cell p, after the jump; entry J is at the period's end.
    residual : J ball matrices (N, q + 1)
        D of every cell.
    """

    Pi: tuple[flint.arb_mat, ...]
    residual: tuple[flint.arb_mat, ...]


def levels_of(period: Period) -> list[Level]:
    """Levels 0 ... q; none where it is not known what the law wants, or a memory never forgets."""
    wanted = _where_the_error_is_zero(period)
    if wanted is None:
        return []
    return [_level_of(period, wanted, s) for s in range(period.drive.q + 1)]


def _level_of(period: Period, wanted: Sequence[flint.arb_mat], s: int) -> Level:
    orders = range(period.drive.q + 1)
    Pi = tuple(
        beside(*(column(obeyed if j < s else ideal, j) for j in orders))
        for obeyed, ideal in zip(period.Pi, wanted, strict=True)
    )
    residual = []
    for p, cell in enumerate(period.cells):
        D = cell.transition * Pi[p] - Pi[p + 1] * shift(period.drive.q, cell.length)
        for j in range(s):  # exactly: these columns are those of D = 0
            for i in range(period.size):
                D[i, j] = 0
        residual.append(D)
    return Level(Pi, tuple(residual))


def _where_the_error_is_zero(period: Period) -> list[flint.arb_mat] | None:
    """Pi of x = x_d at the beginnings of the cells, and at the period's end."""
    drive, q = period.drive, period.drive.q
    if drive.desired is None:
        return None
    n, first, before = drive.n, drive.n + drive.memories, shift(q, -drive.T)
    Ly = beside(*(column(drive.Ly, j) for j in range(q + 1)))
    u, s = drive.Lx * drive.desired + Ly, flint.arb_mat(0, q + 1)
    if drive.memories:
        try:
            s = _memories(drive, before)
        except ZeroDivisionError:
            return None
        u = u + drive.Ls * (s * before)
    rows = [drive.desired, s] if drive.memories else [drive.desired]
    for i in range(period.size - first):
        rows.append(u * shift(q, -i * drive.T))
    Pi = [above(*rows)]
    for cell in period.cells:
        after = Pi[-1] * shift(q, -cell.length)
        for i in range(n):
            for j in range(q + 1):
                after[i, j] = drive.desired[i, j]
        Pi.append(after)
    return Pi


def _memories(drive: Drive, before: flint.arb_mat) -> flint.arb_mat:
    """The memories of samples of x_d: s_{k+1} = Sx x_d + Ss s_k + Sy Y', over Y."""
    columns: list[flint.arb_mat] = []
    less = identity(drive.memories) - drive.Ss
    forced = drive.Sx * drive.desired
    for j in range(drive.q + 1):
        right = column(forced, j) + column(drive.Sy, j)
        for k in range(j):
            right = right + drive.Ss * columns[k] * before[k, j]
        columns.append(less.solve(right))
    return beside(*columns)


def reference_columns(period: Period, levels: Sequence[Level], phase: int) -> KernelColumns:
    """What rows at the beginning of cell `phase` see of the reference, level by level.

    Where D is not zero the kernel of r jumps between two cells: the ends of each cell stand apart,
    with a cell of no length between them.
    """
    drive, q = period.drive, period.drive.q
    over = period.since_jump(phase)
    entire = phase == len(period.cells)
    spread = over[-1] * column(period.reference, q + 1) * (flint.arb(1) / drive.T)
    if not entire or drive.lipschitz is None:
        spread = spread * flint.arb(0)
    nodes, lengths, samples, bends, bend_weights = [], [], [], [], []
    for matrix, p in zip(over, range(phase - 1, -1, -1), strict=False):
        h = period.cells[p].length
        for age in (flint.fmpq(0), h):
            tip = gamma(q, age)
            nodes += [spread - matrix * (level.Pi[p + 1] * tip) for level in levels]
        lengths += [upper_number(flint.arb(h)), 0.0]
        samples += [matrix * level.residual[p] for level in levels]
        for level in levels:
            for j in range(q - 1):
                bends.append(matrix * column(level.Pi[p + 1], j))
                weight = h ** (q - 2 - j) / math.factorial(q - 2 - j) * h**3 / 12
                bend_weights.append(upper_number(flint.arb(weight)))
    size = period.size
    return KernelColumns(
        np.array(lengths[:-1]),
        beside(*nodes),
        beside(*samples),
        beside(*bends) if bends else None,
        np.array(bend_weights),
        np.zeros((size, 0)),
    )


def partly_cancelled(
    period: Period, rows: Sequence[Row], doublings: int, past: PastRows | None = None
) -> np.ndarray | None:
    """The smallest bound of the reference's part of every row, over the levels; rounded up.

    Without what a sample of y_d^(q+1) differs from its mean by, which is the same in all of them.

    Returns
    -------
    (rows,) array, or None where there are no levels
    """
    levels = levels_of(period)
    if not levels:
        return None
    count, cells = len(rows), len(period.cells)
    past = past or PastRows.of_outputs(period, rows, doublings)
    running, last = _running(period, levels, rows), past.last
    columns = reference_columns(period, levels, cells)
    sums, _ = sums_of_periods(period, columns, past, doublings)
    sized = _sized(period, levels, columns, cells, sums)
    total = running + sized[:count] + tail_gains(last[:count], sized[count:], last[count:])
    return widened(total + _still(period, levels, rows), 8).min(axis=1)


def _running(period: Period, levels: Sequence[Level], rows: Sequence[Row]) -> np.ndarray:
    """What the running period adds, level by level."""
    table = np.zeros((len(rows), len(levels)))
    for phase in range(1, len(period.cells)):
        chosen = [i for i, row in enumerate(rows) if row.phase == phase]
        if chosen:
            matrix = flint.arb_mat([list(rows[i].row) for i in chosen])
            seen = reference_columns(period, levels, phase)
            values = Enclosed.of(matrix * seen.all())
            sums = sums_over_time(seen, values.value[:, None], values.error)
            table[chosen] = _sized(period, levels, seen, phase, sums)
    return table


def _sized(
    period: Period, levels: Sequence[Level], columns: KernelColumns, cells: int, sums: np.ndarray
) -> np.ndarray:
    """The reference's part of rows, level by level, from the sums of :func:`sums_over_time`."""
    q, count = period.drive.q, len(levels)
    Y = np.array([upper_number(flint.arb(v)) for v in period.drive.Y])
    bends = max(q - 1, 0)
    ends = np.cumsum([count, cells * count * (q + 1), cells * count * bends])
    lines, residual, bent = np.split(sums[:, : ends[-1]], ends[:-1], axis=1)
    rows = len(sums)
    r = lines + (bent * columns.bend_weights).reshape(rows, cells, count, bends).sum(axis=(1, 3))
    of_Y = residual.reshape(rows, cells, count, q + 1).sum(axis=1) @ Y[:-1]
    return widened(r * Y[-1] + of_Y, cells * (q + 1) + 16)


def _still(period: Period, levels: Sequence[Level], rows: Sequence[Row]) -> np.ndarray:
    """|row Pi_p - of_Y| Y, level by level."""
    Y = np.array([upper_number(flint.arb(v)) for v in period.drive.Y[:-1]])
    result = np.zeros((len(rows), len(levels)))
    for phase in {row.phase for row in rows}:
        chosen = [i for i, row in enumerate(rows) if row.phase == phase]
        matrix = flint.arb_mat([list(rows[i].row) for i in chosen])
        of_Y = flint.arb_mat([list(rows[i].of_Y) for i in chosen])
        for s, level in enumerate(levels):
            result[chosen, s] = Enclosed.of(matrix * level.Pi[phase] - of_Y).upper @ Y
    return widened(result, len(Y) + 4)
