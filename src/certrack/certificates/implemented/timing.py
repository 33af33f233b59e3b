"""Jitter: samples at k T + eps_k, inputs from k T + delay T + eps'_k on, both within j T.

The loop is the one with exact times and two more bounded inputs. What a sample measures differs by
at most j T |x_i'| from x_i(k T), so n_k,i grows by that. An input that comes early or late is a
pulse b (u_k - u_{k-1}) of a length <= j T in a window of j T around its time,

    |o| <= ... + j T sum over the inputs of sup_window |lambda(s) b| DU,  |u_k - u_{k-1}| <= DU.

Of x' itself there are rows in every cell, with the input of that cell, and |b| DU for the cell in
which another one acts. X, U, DU and the bounds R of |x_i'| are one fixed point. It is causal: no
input comes before its sample, for 2 j <= delay.

The supremum of a window is at most that of its period: the largest of the values at the cells' ends
and h^2/8 |lambda| e^{|A|h} |A^2 b| more. Where a window reaches into the next period it is at most
the sum of both, so each counts twice; and then a cell that is a whole period may have two of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.channels import Channel
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.fixed_point import (
    FIXED_POINT_MARGIN,
    FIXED_POINT_STEPS,
    LARGEST_BOUND,
    SMALLEST_BOUND,
    STANDS_STILL,
    OutputBounds,
    uncertain_size,
)
from certrack.certificates.implemented.gains import (
    product_error,
    running_period,
    tail_gains,
)
from certrack.certificates.implemented.outputs import STATE_DEGREE, Row, state_rows
from certrack.certificates.implemented.period import Period, padded
from certrack.certificates.implemented.powers import powers_of_columns, powers_of_rows
from certrack.core.ball_matrices import above, absolute, beside, identity


def rate_rows(period: Period) -> list[Row]:
    """Rows of x_i' - W_i w (outputs n + 3 ... 2 n + 2), with the input of each cell."""
    drive, n = period.drive, period.drive.n
    none, rows = [flint.arb(0)] * (drive.q + 1), []
    for i in range(n):
        rate = Channel(tuple(drive.A[i, j] for j in range(n)), drive.b[i, 0])
        rows += state_rows(period, n + 3 + i, rate, none, STATE_DEGREE)
    return rows


@dataclass(frozen=True)
class TimedBounds:
    """F of v = (X, U, DU, R).

    Attributes
    ----------
    bounds : OutputBounds
        Of the rows with those of x'.
    by_step : (rows,) array of balls
        Times DU.
    by_rate : (rows, n) array of balls
        Times R.
    direct : (rows, columns of W) array of balls
        Times the bounds of w, besides what :attr:`bounds` has.
    """

    bounds: OutputBounds
    by_step: np.ndarray
    by_rate: np.ndarray
    direct: np.ndarray

    @classmethod
    def of(
        cls, period: Period, rows: Sequence[Row], bounds: OutputBounds, doublings: int
    ) -> TimedBounds:
        """From the gains of the rows, of which those of :func:`rate_rows` are the last."""
        drive, n = period.drive, period.drive.n
        shift = flint.arb(drive.jitter * drive.T)
        pulses = pulse_gains(period, rows, doublings)
        inside = {p: _in_cell_pulse(period, cell.length) for p, cell in enumerate(period.cells)}
        windows = 2 if _crosses(drive) else 1  # of two inputs, in a cell that is all of a period
        by_step, direct = [], np.zeros((len(rows), drive.W.ncols()), dtype=object)
        for i, row in enumerate(rows):
            held = flint.arb(float(pulses[i]))
            i_state = row.output - 1 if 1 <= row.output <= n else max(row.output - n - 3, 0)
            rate = row.output >= n + 3
            if rate or row.output <= n:
                held = held + windows * inside[row.phase][int(rate)][i_state]
            total = shift * held
            if rate:
                total = total + abs(drive.b[i_state, 0])
                direct[i] = [abs(drive.W[i_state, j]) for j in range(drive.W.ncols())]
            by_step.append(total)
        noise = np.vectorize(flint.arb, otypes=[object])(bounds.gains.noise)
        return cls(bounds, np.array(by_step, dtype=object), noise * shift, direct)

    @property
    def count(self) -> int:
        """Number of outputs: e_1, the states, u, its steps, the rates."""
        return 2 * self.bounds.drive.n + 3

    def image(self, X: Sequence[Any], U: Any, step: Any, rates: Sequence[Any]) -> list[Any]:
        """Upper bounds of e_1, the states, u, its steps and the rates of the states.

        Raises
        ------
        NoCertificate
            If one of them is not finite.
        """
        bounds = self.bounds
        values = bounds.constant + bounds.x @ np.array(X, dtype=object) + bounds.u * U
        for j, bound in enumerate(bounds.drive.uncertain):
            values = values + (bounds.w[:, j] + self.direct[:, j]) * uncertain_size(bound, X)
        values = values + self.by_step * step + self.by_rate @ np.array(rates, dtype=object)
        if not all(value.is_finite() for value in values):
            raise NoCertificate("a gain of the sampled loop leaves the range of floating point")
        chosen = (values[bounds.outputs == k] for k in range(self.count))
        return [max(flint.arb(v.upper()) for v in entries) for entries in chosen]

    def search(self) -> list[float]:
        """X, U, DU and R that are probably above F.

        Raises
        ------
        NoCertificate
            If there seem to be none.
        """
        n, v = self.bounds.drive.n, np.zeros(2 * self.bounds.drive.n + 2)
        for _ in range(FIXED_POINT_STEPS):
            entries = [flint.arb(value) for value in v.tolist()]
            image = self.image(entries[:n], entries[n], entries[n + 1], entries[n + 2 :])
            after = np.array([float(value) for value in image[1:]])
            if not after.max() < LARGEST_BOUND:
                break
            still = (after <= v * (1 + STANDS_STILL)).all()
            v = after
            if still:
                return (v * (1 + FIXED_POINT_MARGIN) + SMALLEST_BOUND).tolist()
        raise NoCertificate(
            "the jitter is too large for the sampled loop: what it adds by the motion of the "
            "states and the steps of the input is not less than these; lower "
            "implementation.jitter, or filter more what is differenced"
        )


def _in_cell_pulse(period: Period, h: Any) -> tuple[list[Any], list[Any]]:
    """sup |e_i e^{A s} b| and sup |e_i A e^{A s} b| over 0 <= s <= h, for each i."""
    drive, n = period.drive, period.drive.n
    growth = (absolute(drive.A) * flint.arb(h)).exp()
    still = growth * absolute(drive.b)
    moving = growth * absolute(drive.A * drive.b)
    return [still[i, 0] for i in range(n)], [moving[i, 0] for i in range(n)]


def pulse_gains(period: Period, rows: Sequence[Row], doublings: int) -> np.ndarray:
    """Sum over the inputs of the largest |lambda(s) b| where they may change; rounded up.

    Parameters
    ----------
    period : Period
    rows : of outputs
    doublings : int
        2^doublings whole periods are summed one by one.
    """
    count, inner = len(rows), doublings // 2
    _, past = running_period(period, rows)
    b = padded(period.drive.b, period.size)
    nodes, bend = _pulse_columns(period, b, len(period.cells))
    heads = above(past, identity(period.size))
    columns = beside(nodes, identity(period.size))
    table, jumped = powers_of_columns(period.map, columns, inner)
    rows_of, last = powers_of_rows(jumped, heads, doublings - inner)
    total, block, blocks = len(heads.tolist()), 2**inner, 2 ** (doublings - inner)
    error = product_error(rows_of, table, total, block)
    ends = nodes.ncols()
    sums = np.zeros(total)
    for k in range(blocks):
        head = rows_of.value[k * total : (k + 1) * total]
        values = np.abs((head @ table.value).reshape(total, block, -1))
        each = values[:, :, :ends].max(axis=2) + values[:, :, ends:] @ bend
        sums += widened(each.sum(axis=1), block + period.size + 8)
    sums += error[:, :ends].sum(axis=1) + error[:, ends:] @ bend
    sums = widened(sums, blocks + period.size + ends + 8)
    tail = tail_gains(last[:count], sums[count:, None], last[count:])[:, 0]
    gains = sums[:count] + tail + _running_pulses(period, rows, b)
    return widened(gains * (2 if _crosses(period.drive) else 1), 8)


def _crosses(drive: Drive) -> bool:
    """Whether the window of an input's change reaches into another period."""
    part = drive.delay - drive.delay.floor()
    return bool(part < drive.jitter or 1 - part < drive.jitter)


def _pulse_columns(
    period: Period, b: flint.arb_mat, phase: int
) -> tuple[flint.arb_mat, np.ndarray]:
    """What rows at the beginning of a cell see of b at the cells' ends; and what it bends by."""
    over, drive = period.since_jump(phase), period.drive
    nodes = beside(*(matrix * b for matrix in over))
    bend = np.zeros(period.size)
    second = absolute(drive.A * drive.A * drive.b)
    for matrix, p in zip(over, range(phase - 1, -1, -1), strict=False):
        h = flint.arb(period.cells[p].length)
        inner = padded((absolute(drive.A) * h).exp() * second, period.size)
        bend = np.maximum(bend, Enclosed.of(absolute(matrix) * inner * (h**2 / 8)).upper[:, 0])
    return nodes, bend


def _running_pulses(period: Period, rows: Sequence[Row], b: flint.arb_mat) -> np.ndarray:
    """The same of the period that runs, up to the beginning of the row's cell."""
    gains = np.zeros(len(rows))
    for phase in range(1, len(period.cells)):
        chosen = [i for i, row in enumerate(rows) if row.phase == phase]
        if chosen:
            nodes, bend = _pulse_columns(period, b, phase)
            matrix = flint.arb_mat([list(rows[i].row) for i in chosen])
            largest = Enclosed.of(matrix * nodes).upper.max(axis=1)
            gains[chosen] = largest + Enclosed.of(matrix).upper @ bend
    return widened(gains, period.size + 8)
