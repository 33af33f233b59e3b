"""What is gained where w changes slowly: the response to a step in the place of the kernel.

Let k be the kernel of a row for one w, over the age a of what acts, and g(a) = int_0^a k the row's
response to a step. For w = s + f, |s| <= s0, |s'| <= rho but for jumps of at most J, any two of
which are at least `dwell` apart, and for every z that is constant in each period,

    |int k s| <= s0 TV(z) + rho int |g - z| da + J times the largest sum of |g - z| at such times.

For k = z' + (g - z)' as measures where z(0-) = 0 and z is g beyond some age: the first part meets
|s| <= s0, the second one by parts the changes of s. TV(z) counts the jumps of z, the last one to g,
and int |k| beyond. z = g is the plain peak gain, z = 0 uses the rate alone. f counts by |k|.
That |s| <= s0 = (bound of w) - (that of f) is no premise: of any s and f with |s + f| within the
bound of w, s may be cut off at s0, which makes no change of it faster, and the rest stays within
the bound of f. And a steep change of s counts as a jump where all of it is at most J and it is over
at least `dwell` before the next one begins: of it, too, only the largest |g - z| counts.

In a cell |g - z| has the integral of the line between the ends and h^3/12 sup|g''| more at most,
and is at most h^2/8 sup|g''| above its ends; g'' = k' is at most |lambda| e^{|A|h} |A W|.

An estimate of w makes the step response return to nearly zero, so that a small z is enough. It is
used for |e_1| alone, once the states have bounds without it. Where rates are those of the states,
:mod:`.superposition` tells apart what sensors do to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.apart import largest_apart
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.enclosed import ROUNDOFF, Enclosed, widened
from certrack.certificates.implemented.fixed_point import OutputBounds, uncertain_size
from certrack.certificates.implemented.gains import (
    mean_magnitude,
    product_error,
    upper_number,
)
from certrack.certificates.implemented.outputs import Row
from certrack.certificates.implemented.period import Period, padded
from certrack.certificates.implemented.powers import powers_of_columns, powers_of_rows
from certrack.certificates.implemented.superposition import (
    TwoParts,
    speed_of,
    speeds_of_states,
    split_from,
)
from certrack.core.ball_matrices import absolute, beside, column, identity

#: One z: from which period on (0 is the running one), and its value there as a decimal text.
StepFunction = tuple[tuple[int, str], ...]

#: Numbers in the tables of step responses, at most: some 100 MB.
MAX_STEP_NUMBERS = 12_000_000


def slow_columns(drive: Drive) -> list[int]:
    """Columns of W of which it is known how fast they are, if that is used."""
    if drive.jitter or drive.channels:
        return []
    return [j for j, bound in enumerate(drive.uncertain) if bound.slow is not None]


def as_function(steps: StepFunction, periods: int) -> np.ndarray:
    """The values of z in all periods.

    Raises
    ------
    NoCertificate
        If the steps are not in order, or not in these periods.
    """
    first = [start for start, _ in steps]
    if first[:1] != [0] or any(a >= b for a, b in zip(first, [*first[1:], periods], strict=True)):
        raise NoCertificate("the steps of z are not in the order of their periods, from 0 on")
    values = [float(value) for _, value in steps]
    if not np.isfinite(values).all():
        raise NoCertificate("a step of z leaves the range of floating point")
    return np.repeat(values, np.diff([*first, periods]))


def needs_rates(drive: Drive) -> bool:
    """Whether how fast a w may change depends on how fast the states do."""
    bounds = (drive.uncertain[j].slow for j in slow_columns(drive))
    return any(bound is not None and any(bound.by_states) for bound in bounds)


@dataclass(frozen=True)
class StepResponses:
    """Step responses g of rows of e_1, period by period, the running one first.

    In a period the cells are in the order of their age; those of the running one that the row has
    not passed have no length.

    Attributes
    ----------
    columns : indices of the columns of W
    begin, end : (rows, periods, cells, columns) arrays
        g at the young and the old end of each cell.
    lengths : (rows, periods, cells) array
        Rounded up.
    error : (rows, columns) array
        What any g is off by.
    bend : (rows, columns) array
        Sum of h^3/12 sup|g''|.
    overshoot : (rows, periods, columns) array
        Largest h^2/8 sup|g''| of a period.
    """

    columns: list[int]
    begin: np.ndarray
    end: np.ndarray
    lengths: np.ndarray
    error: np.ndarray
    bend: np.ndarray
    overshoot: np.ndarray

    @classmethod
    def of(cls, period: Period, rows: Sequence[Row], doublings: int) -> StepResponses:
        """Of rows, over 2^doublings whole periods and the running one.

        Raises
        ------
        NoCertificate
            If there are too many numbers.
        """
        columns = slow_columns(period.drive)
        size, count, cells = period.size, len(rows), len(period.cells)
        if count * 2**doublings * max(size, cells * len(columns)) > MAX_STEP_NUMBERS:
            raise NoCertificate("the sampled loop is too large for its step responses")
        increments, error, sizes = _whole_periods(period, rows, doublings, columns)
        running, off, bends = _running_period(period, rows, columns)
        every = np.concatenate([running[:, None], increments], axis=1)
        g = np.cumsum(every.reshape(count, -1, len(columns)), axis=1).reshape(every.shape)
        flat = g.reshape(count, -1, len(columns))
        before = np.concatenate([0 * flat[:, :1], flat[:, :-1]], axis=1).reshape(g.shape)
        rounding = 2 * (every[0, :, :, 0].size + 8) * ROUNDOFF * np.abs(every).sum(axis=(1, 2))
        cubic, square = _bends(period, cells, columns)
        of_cells = np.array([upper_number(flint.arb(c.length)) for c in reversed(period.cells)])
        behind = np.array(
            [[float(p < row.phase) for p in range(cells - 1, -1, -1)] for row in rows]
        )
        periods = increments.shape[1] + 1
        lengths = np.broadcast_to(of_cells, (count, periods, cells)).copy()
        lengths[:, 0] *= behind
        return cls(
            columns=columns,
            begin=before,
            end=g,
            lengths=lengths,
            error=widened(error + off + rounding, 8),
            bend=widened(sizes.sum(axis=1) @ cubic + bends[0], periods + size + 8),
            overshoot=widened(
                np.concatenate([bends[1][:, None], sizes @ square], axis=1), size + 8
            ),
        )

    @property
    def periods(self) -> int:
        """The running one among them."""
        return self.end.shape[1]

    def measures(
        self, i: int, z: np.ndarray, old: np.ndarray, apart: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """TV(z), int |g - z| and the sum for jumps, of all rows; rounded up.

        Parameters
        ----------
        i : int
            Which of the columns.
        z : (periods,) array
        old : (rows,) array
            int |k| beyond the periods.
        apart : int
            Whole periods between two jumps; 0 where there are no jumps.
        """
        steps = np.abs(np.diff(z)).sum() + abs(z[0])
        last = np.abs(self.end[:, -1, -1, i] - z[-1]) + self.error[:, i]
        variation = widened(steps + last + old, len(z) + 8)
        a, b = (g[..., i] - z[None, :, None] for g in (self.begin, self.end))
        lines = (self.lengths * mean_magnitude(a, b)).sum(axis=(1, 2))
        time = self.lengths.sum(axis=(1, 2))
        # a difference rounds by its last digit: counted with the error of g
        off = self.error[:, i] + 4 * ROUNDOFF * (np.abs(z).max() + np.abs(self.end[..., i]).max())
        area = widened(lines + self.bend[:, i] + off * time, a[0].size + 16)
        if not apart:
            return variation, area, np.zeros(len(area))
        largest = np.maximum(np.abs(a), np.abs(b)).max(axis=2) + self.overshoot[..., i]
        largest = largest + off[:, None]
        sums = largest_apart(largest, apart)
        return variation, area, widened(sums, self.periods // apart + 10)


def _whole_periods(
    period: Period, rows: Sequence[Row], doublings: int, columns: list[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Increments (rows, periods, cells, columns), what their sums are off by, and |rows|."""
    count, inner, cells = len(rows), doublings // 2, len(period.cells)
    block, blocks = 2**inner, 2 ** (doublings - inner)
    of_period = _increments(period, cells, columns)
    width = of_period.ncols()
    past = flint.arb_mat(
        [
            (
                flint.arb_mat([list(row.row)]) * (period.since_jump(row.phase)[-1] * period.jump)
            ).entries()
            for row in rows
        ]
    )
    table, jumped = powers_of_columns(period.map, beside(of_period, identity(period.size)), inner)
    heads, _ = powers_of_rows(jumped, past, doublings - inner)
    error = product_error(heads, table, count, block)
    parts = [
        (heads.value[b * count : (b + 1) * count] @ table.value).reshape(count, block, -1)
        for b in range(blocks)
    ]
    values = np.concatenate(parts, axis=1)
    increments = values[:, :, :width].reshape(count, block * blocks, cells, len(columns))
    off = error[:, :width].reshape(count, cells, len(columns)).sum(axis=1)
    return increments, off, np.abs(values[:, :, width:]) + error[:, None, width:]


def _running_period(
    period: Period, rows: Sequence[Row], columns: list[int]
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """The same of the running period, of the cells behind the rows; and its bends."""
    cells, count, width = len(period.cells), len(rows), len(columns)
    increments, off = np.zeros((count, cells, width)), np.zeros((count, width))
    bend, overshoot = np.zeros((count, width)), np.zeros((count, width))
    for i, row in enumerate(rows):
        if not row.phase:
            continue
        matrix = flint.arb_mat([list(row.row)])
        seen = Enclosed.of(matrix * _increments(period, row.phase, columns))
        increments[i, cells - row.phase :] = seen.value.reshape(row.phase, width)
        off[i] = seen.error.reshape(row.phase, width).sum(axis=0)
        size = Enclosed.of(matrix).upper[0]
        bend[i], overshoot[i] = (size @ table for table in _bends(period, row.phase, columns))
    return increments, off, (bend, overshoot)


def _increments(period: Period, phase: int, columns: list[int]) -> flint.arb_mat:
    """int of k_w over each cell, newest first, over rows at the beginning of cell `phase`."""
    over = period.since_jump(phase)
    parts = []
    for matrix, p in zip(over, range(phase - 1, -1, -1), strict=False):
        parts.append(
            matrix * padded(_integral(period, period.cells[p].length, columns), period.size)
        )
    return beside(*parts)


def _integral(period: Period, h: Any, columns: list[int]) -> flint.arb_mat:
    """int_0^h e^{A s} ds W."""
    n, W = period.drive.n, _chosen(period.drive.W, columns)
    block = flint.arb_mat(n + W.ncols(), n + W.ncols())
    for i in range(n):
        for j in range(n):
            block[i, j] = period.drive.A[i, j] * flint.arb(h)
        for j in range(W.ncols()):
            block[i, n + j] = W[i, j] * flint.arb(h)
    over = block.exp()
    return flint.arb_mat([[over[i, n + j] for j in range(W.ncols())] for i in range(n)])


def _bends(period: Period, phase: int, columns: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Sum of h^3/12 sup|k'| and largest h^2/8 sup|k'| of the cells, over |rows|."""
    drive, size = period.drive, period.size
    cubic = np.zeros((size, len(columns)))
    square = np.zeros((size, len(columns)))
    second = absolute(drive.A * _chosen(drive.W, columns))
    for matrix, p in zip(period.since_jump(phase), range(phase - 1, -1, -1), strict=False):
        h = flint.arb(period.cells[p].length)
        inner = absolute(matrix) * padded((absolute(drive.A) * h).exp() * second, size)
        cubic = cubic + Enclosed.of(inner * (h**3 / 12)).upper
        square = np.maximum(square, Enclosed.of(inner * (h**2 / 8)).upper)
    return widened(cubic, phase + 8), square


def _chosen(matrix: flint.arb_mat, columns: list[int]) -> flint.arb_mat:
    return beside(*(column(matrix, j) for j in columns))


@dataclass(frozen=True)
class SlowTerms:
    """What the bounds of |e_1| need of slow terms, where |x| <= X and |u| <= U.

    Attributes
    ----------
    bounds : OutputBounds
    chosen : indices of the rows of e_1
    responses : StepResponses
        Of these rows.
    sizes, speeds : one ball for each column of the responses
        Bounds of w and of the slow part's rate.
    values : (rows,) array of balls
        The bounds of the rows without what these columns add by their kernels.
    parts : mapping of columns of W to TwoParts
        Other bounds of w in two parts, where they are known.
    """

    bounds: OutputBounds
    chosen: np.ndarray
    responses: StepResponses
    sizes: list[Any]
    speeds: list[Any]
    values: np.ndarray
    parts: Mapping[int, TwoParts]

    @classmethod
    def of(
        cls,
        period: Period,
        bounds: OutputBounds,
        doublings: int,
        X: Sequence[Any],
        U: Any,
        split: Sequence[Sequence[str]] = (),
    ) -> SlowTerms:
        """From the bounds of all rows, with those of x' behind the others where they are needed.

        Raises
        ------
        NoCertificate
            If there are too many numbers, or the bounds of a split are not proven.
        """
        drive, gains = bounds.drive, bounds.gains
        chosen = np.flatnonzero(bounds.outputs == 0)
        responses = StepResponses.of(period, [bounds.rows[i] for i in chosen], doublings)
        of_w = [uncertain_size(bound, X) for bound in drive.uncertain]
        values = bounds.values(bounds.constant, of_w, X, U)
        rates = speeds_of_states(bounds, values, of_w) if needs_rates(drive) else []
        speeds = [speed_of(drive.uncertain[j], rates) for j in responses.columns]
        remaining = values[chosen]
        for j in responses.columns:
            kernels = np.array([flint.arb(float(v)) for v in gains.w[chosen, j]], dtype=object)
            remaining = remaining - kernels * of_w[j]
        sizes = [of_w[j] for j in responses.columns]
        parts = split_from(bounds, X, split) if split else {}
        return cls(bounds, chosen, responses, sizes, speeds, remaining, parts)

    def apart(self, i: int) -> int:
        """Whole periods between two jumps at least; 0 without jumps.

        Raises
        ------
        NoCertificate
            If jumps are closer than a period.
        """
        drive = self.bounds.drive
        slow = drive.uncertain[self.responses.columns[i]].slow
        assert slow is not None
        if slow.dwell is None:
            return 0
        count = int((slow.dwell / drive.T).floor())
        if count < 1:
            raise NoCertificate("plant.uncertainty.dwell is shorter than a period")
        return count

    def bound(self, steps: Sequence[StepFunction]) -> Any:
        """Upper bound of limsup |e_1|, with one z for each column.

        Raises
        ------
        NoCertificate
            If there are not so many z, or one is no function of the periods.
        """
        gains, total = self.bounds.gains, self.values
        assert gains.old is not None
        if len(steps) != len(self.responses.columns):
            raise NoCertificate("there is not one z for each uncertain term with a rate")
        for i, j in enumerate(self.responses.columns):
            z = as_function(steps[i], self.responses.periods)
            slow = self.bounds.drive.uncertain[j].slow
            assert slow is not None
            measured = self.responses.measures(i, z, gains.old[self.chosen, j], self.apart(i))
            added = []
            for row, tv, area, jumps in zip(self.chosen, *measured, strict=True):
                kernel = flint.arb(float(gains.w[row, j]))
                by_steps = (self.sizes[i] - slow.fast) * float(tv) + self.speeds[i] * float(area)
                by_steps = by_steps + flint.arb(slow.jump) * float(jumps) + slow.fast * kernel
                bounds_of_part = [by_steps, self.sizes[i] * kernel]
                if (parts := self.parts.get(j)) is not None:
                    of_slow = parts.size * float(tv) + parts.speed * float(area)
                    bounds_of_part.append(of_slow + parts.remainder * kernel)
                added.append(min(flint.arb(bound.upper()) for bound in bounds_of_part))
            total = total + np.array(added, dtype=object)
        if not all(value.is_finite() for value in total):
            raise NoCertificate("a gain of the sampled loop leaves the range of floating point")
        return max(flint.arb(value.upper()) for value in total)
