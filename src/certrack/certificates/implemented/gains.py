"""What the inputs of all past periods add to rows over chi: peak gains, in floats rounded up.

A row is pushed back in time through a period, lambda <- lambda M, and its kernels are seen at the
cells' ends: k_w(s) = lambda e^{A s} W and k_r(s) = -lambda Pi Gamma(s) + lambda_0 R_{q+1}/T, where
lambda_0 is the row right after the period's jump. The sample r(t_k) is the mean of r over the
period that follows but for (T/2) Lipschitz, so sampled feed-forward and the reference's motion are
one kernel, and cancel as they do in the loop. Where r jumps in a period the sample differs by the
jump more, once in as many periods as the jumps are apart. Without a Lipschitz constant sample and
motion stand apart.

In a cell of length h, |k| has the integral of the line between the ends, and h^3/12 sup|k''| more
at most. The row of l periods before is lambda M^l: heads lambda M^{bK} and a table of M^j columns,
j < K, are balls, rounded to floats whose errors are counted; their products are floats, and what
they lose is counted too. The rows of the running period are balls throughout.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.enclosed import ROUNDOFF, Enclosed, widened
from certrack.certificates.implemented.outputs import Row
from certrack.certificates.implemented.period import Period, gamma, padded
from certrack.certificates.implemented.powers import (
    PastRows,
    powers_of_columns,
    rows_before_jump,
)
from certrack.core.ball_matrices import absolute, beside, column, identity

#: The weights of the tail may be any positive numbers. An entry of chi on which nothing acts has
#: this part of the largest.
SMALLEST_TAIL_WEIGHT = 1e-30

#: Nothing is divided by less.
SMALLEST_TOTAL = 1e-300


@dataclass(frozen=True)
class PeakGains:
    """Of each row: what it may add up to per unit of an input's bound; rounded up.

    Attributes
    ----------
    w : (rows, columns of W) array, s
    r : (rows,) array, s
        Of y_d^(q+1).
    noise : (rows, n) array
    sample : (rows,) array
        Of what a sample of y_d^(q+1) differs from its mean over the period that follows; without
        a Lipschitz constant of that sample itself.
    step : (rows,) array
        Of the converter.
    first : (rows,) array
        Of the sample of y_d^(q+1) of the period that runs at the output's time.
    jump : (rows,) array
        Of jumps of y_d^(q+1).
    """

    w: np.ndarray
    r: np.ndarray
    noise: np.ndarray
    sample: np.ndarray
    step: np.ndarray
    first: np.ndarray
    jump: np.ndarray
    old: np.ndarray | None = None


@dataclass(frozen=True)
class KernelColumns:
    """What is looked at in a period, linear in the row at its end.

    Attributes
    ----------
    lengths : h of the cells, newest first, rounded up
    nodes : matrices of w and r kernels at the cells' ends, newest first, side by side
    samples : matrix of noise, sample and step
    bends : matrices of the second derivatives of k_r, side by side; none if q < 2
    bend_weights : h^3/12 times what each of them counts
    curvature : (N, columns of W) array
        sum of h^3/12 |k_w''| is at most |lambda| curvature.
    """

    lengths: np.ndarray
    nodes: flint.arb_mat
    samples: flint.arb_mat
    bends: flint.arb_mat | None
    bend_weights: np.ndarray
    curvature: np.ndarray

    def all(self) -> flint.arb_mat:
        """Nodes, samples, bends and the row itself, side by side."""
        parts = [self.nodes, self.samples]
        parts += [] if self.bends is None else [self.bends]
        return beside(*parts, identity(self.nodes.nrows()))


def kernel_columns(period: Period, phase: int, smeared: bool) -> KernelColumns:
    """What rows at the beginning of cell `phase` see of their period, back to its jump.

    Parameters
    ----------
    period : Period
    phase : int
        The number of cells for an entire period.
    smeared : bool
        Whether the period's sample is spread over it.
    """
    drive, q, W = period.drive, period.drive.q, period.W
    over = period.since_jump(phase)
    to_jump = over[-1]
    last = to_jump * column(period.reference, q + 1)
    spread = last * (flint.arb(1) / drive.T) if smeared else last * flint.arb(0)
    newest = gamma(q, flint.fmpq(0))
    nodes, bends, bend_weights, lengths = [], [], [], []
    curvature = flint.arb_mat(period.size, W.ncols())
    for matrix, p in zip(over, range(phase, -1, -1), strict=True):
        nodes.append(beside(matrix * W, spread - matrix * (period.Pi[p] * newest)))
    for matrix, p in zip(over, range(phase - 1, -1, -1), strict=False):
        h = period.cells[p].length
        lengths.append(upper_number(flint.arb(h)))
        curvature = curvature + absolute(matrix) * _bend_of_w(period, h) * (flint.arb(h) ** 3 / 12)
        for j in range(q - 1):
            bends.append(matrix * column(period.Pi[p + 1], j))
            weight = h ** (q - 2 - j) / math.factorial(q - 2 - j) * h**3 / 12
            bend_weights.append(upper_number(flint.arb(weight)))
    return KernelColumns(
        np.array(lengths),
        beside(*nodes),
        beside(to_jump * period.noise, last, to_jump * period.step),
        beside(*bends) if bends else None,
        np.array(bend_weights),
        Enclosed.of(curvature).upper,
    )


def _bend_of_w(period: Period, h: Any) -> flint.arb_mat:
    """|k_w''| is at most |lambda| times this in a cell of length h."""
    A, W = period.drive.A, period.drive.W
    inner = (absolute(A) * flint.arb(h)).exp() * absolute(A * A * W)
    return padded(inner, period.size)


def upper_number(ball: Any) -> float:
    """A float not below the magnitude of a ball."""
    return float(Enclosed.of(flint.arb_mat([[ball]])).upper[0, 0])


def output_gains(
    period: Period, rows: Sequence[Row], doublings: int, past: PastRows | None = None
) -> PeakGains:
    """The gains of rows, of all the past.

    Parameters
    ----------
    period : Period
    rows : of :func:`~certrack.certificates.implemented.outputs.output_rows`
    doublings : int
        2^doublings whole periods are summed one by one; what is before them is bounded by the sums
        of the unit rows.
    past : PastRows, optional
        Those of the rows, if they are at hand.

    Raises
    ------
    NoCertificate
        If the tail does not shrink: the loop may be unstable, or needs more periods.
    """
    drive, smeared = period.drive, period.drive.lipschitz is not None
    running, _ = running_period(period, rows)
    past = past or PastRows.of_outputs(period, rows, doublings)
    of_period = kernel_columns(period, len(period.cells), smeared)
    sums, samples = sums_of_periods(period, of_period, past, doublings)
    count, last = len(rows), past.last
    of_rows, each = (
        gains_table(of_period, drive.n, sums[:count]),
        gains_table(of_period, drive.n, sums[count:]),
    )
    tail = tail_gains(last[:count], each, last[count:])
    total = widened(running + of_rows + tail, 16)
    at = drive.W.ncols() + 1 + drive.n  # the sample's column
    jump = np.zeros(count)
    if drive.jumps is not None:
        each_jump = largest_of_each(samples[:count], drive.periods_between_jumps)
        jump = widened(each_jump + tail[:, at], 2**doublings)
    gains = gains_of(total, drive.W.ncols(), drive.n, jump)
    return replace(gains, old=tail[:, : drive.W.ncols()])


def running_period(period: Period, rows: Sequence[Row]) -> tuple[np.ndarray, flint.arb_mat]:
    """PeakGains of the running period, and the rows before its jump."""
    drive, nw = period.drive, period.drive.W.ncols()
    table = np.zeros((len(rows), nw + 1 + drive.n + 3))
    for phase in range(len(period.cells)):
        chosen = [i for i, row in enumerate(rows) if row.phase == phase]
        if not chosen:
            continue
        matrix = flint.arb_mat([list(rows[i].row) for i in chosen])
        seen = kernel_columns(period, phase, smeared=False)
        values = Enclosed.of(matrix * seen.all())
        gains = gains_table(
            seen, drive.n, sums_over_time(seen, values.value[:, None], values.error)
        )
        gains[:, -1] = gains[:, nw + 1 + drive.n]  # the sample is an input by itself
        gains[:, nw + 1 + drive.n] = 0
        table[chosen] = gains
    return table, rows_before_jump(period, rows)


def sums_over_time(columns: KernelColumns, values: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Sums over periods (axis 1) of what the columns are for, with their errors summed.

    Returns
    -------
    (rows, columns of nodes at one cell end + samples + bends + N) array
        Integrals of |k| over the cells' lines; magnitudes of the others.
    """
    rows, count = values.shape[:2]
    ends = len(columns.lengths) + 1
    width = columns.nodes.ncols() // ends
    split = columns.nodes.ncols()
    at_ends = values[:, :, :split].reshape(rows, count, ends, width)
    off = error[:, :split].reshape(rows, ends, width)
    lines = mean_magnitude(at_ends[:, :, :-1], at_ends[:, :, 1:]).sum(axis=1)
    lines = lines + (off[:, :-1] + off[:, 1:]) / 2
    integrals = np.einsum("c,rcw->rw", columns.lengths, lines)
    magnitudes = np.abs(values[:, :, split:]).sum(axis=1) + error[:, split:]
    return widened(np.hstack([integrals, magnitudes]), count + ends + 16)


def mean_magnitude(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean of |line| between the values a and b, but for a few roundings."""
    total = np.abs(a) + np.abs(b)
    # (|a| + |b|)/2, and where the line crosses zero less |a b|/(|a| + |b|), without a square
    with np.errstate(all="ignore"):
        crossed = a * (b / np.maximum(total, SMALLEST_TOTAL))
    return 0.5 * total + np.minimum(crossed, 0.0)


def gains_table(columns: KernelColumns, n: int, sums: np.ndarray) -> np.ndarray:
    """Columns w, r, noise, sample, step, first from the sums of :func:`sums_over_time`."""
    size = columns.nodes.nrows()
    width = columns.nodes.ncols() // (len(columns.lengths) + 1)
    lines = sums[:, :width]
    samples, others = sums[:, width : width + n + 2], sums[:, width + n + 2 :]
    bends, of_row = others[:, :-size], others[:, -size:]
    w = lines[:, :-1] + of_row @ columns.curvature
    r = lines[:, -1:] + (bends @ columns.bend_weights)[:, None]
    first = np.zeros((len(sums), 1))
    return widened(np.hstack([w, r, samples, first]), size + len(columns.bend_weights) + 8)


def sums_of_periods(
    period: Period, of_period: KernelColumns, past: PastRows, doublings: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of :func:`sums_over_time` over whole periods, and what each sample adds.

    Returns
    -------
    sums : (rows, columns) array
    samples : (rows, periods) array
        Magnitudes in the column of the sample, the newest period first.
    """
    heads, count, inner = past.heads, len(past.last), doublings // 2
    block, blocks = 2**inner, 2 ** (doublings - inner)
    table, _ = powers_of_columns(period.map, of_period.all(), inner)
    error = product_error(heads, table, count, block)
    total: np.ndarray | float = 0.0
    at, samples = of_period.nodes.ncols() + period.drive.n, []
    for b in range(blocks):
        values = (heads.value[b * count : (b + 1) * count] @ table.value).reshape(count, block, -1)
        total = total + sums_over_time(of_period, values, 0 * error)
        samples.append(np.abs(values[:, :, at]))
    each = np.hstack(samples)
    each[np.arange(len(each)), each.argmax(axis=1)] += error[:, at]  # of all of them
    return widened(total + _sums_of_errors(of_period, error), blocks + 8), each


def largest_of_each(samples: np.ndarray, apart: int) -> np.ndarray:
    """Sums of the largest sample of each `apart` periods in a row.

    The errors of all samples stand in the largest of all, which is the largest of its periods.
    """
    starts = np.arange(0, samples.shape[1], apart)
    largest: np.ndarray = np.maximum.reduceat(samples, starts, axis=1).sum(axis=1)
    return largest


def _sums_of_errors(columns: KernelColumns, error: np.ndarray) -> np.ndarray:
    """What errors of the columns add to the sums."""
    return sums_over_time(columns, np.zeros((len(error), 1, error.shape[1])), error)


def product_error(heads: Enclosed, table: Enclosed, count: int, block: int) -> np.ndarray:
    """Sum over all periods of what the products of heads and table are off by at most."""
    size = len(table.value)
    blocks = len(heads.value) // count
    head, head_error = (
        np.abs(v).reshape(blocks, count, size).sum(axis=0) for v in (heads.value, heads.error)
    )
    entry, entry_error = (
        np.abs(v).reshape(size, block, -1).sum(axis=1) for v in (table.value, table.error)
    )
    rounding = 2 * (size + 4) * ROUNDOFF * (head @ entry)
    off = head @ entry_error + head_error @ (entry + entry_error)
    return widened(rounding + off, 4 * blocks + 2 * block + 4 * size)


def tail_gains(last: np.ndarray, each: np.ndarray, power: np.ndarray) -> np.ndarray:
    """What is before the periods that were summed.

    Parameters
    ----------
    last : (rows, N) array
        |lambda M^L|.
    each : (N, columns) array
        Sums S of the unit rows over L periods.
    power : (N, N) array
        |M^L|.

    The sums over all time are at most S + |M^L| S + |M^L|^2 S + ... With |M^L| d <= nu d, nu < 1,
    and |M^L| S <= nu sigma d for S <= sigma d, that is at most S + sigma nu/(1 - nu) d.
    """
    size = len(power)
    largest = each.max(axis=0, initial=0.0)
    d = (each[:, largest > 0] / largest[largest > 0]).max(axis=1, initial=0.0)
    d = np.maximum(d, SMALLEST_TAIL_WEIGHT)
    nu = float(widened((power @ d) / d, size + 4).max())
    if not nu < 1:
        raise NoCertificate(
            "the tail of the sums does not shrink: the sampled loop is unstable, or so slow that "
            "more periods than allowed are needed"
        )
    sigma = widened((each / d[:, None]).max(axis=0))
    # 1 - nu is exact for nu >= 1/2 and rounds by one unit below
    beyond = widened(np.outer(d, sigma * nu / (1 - nu)), 8)
    return widened(last @ (each + beyond), size + 8)


def gains_of(table: np.ndarray, nw: int, n: int, jump: np.ndarray) -> PeakGains:
    """The columns of a table by their names; see :func:`gains_table`."""
    return PeakGains(
        w=table[:, :nw],
        r=table[:, nw],
        noise=table[:, nw + 1 : nw + 1 + n],
        sample=table[:, nw + 1 + n],
        step=table[:, nw + 2 + n],
        first=table[:, nw + 3 + n],
        jump=jump,
    )
