"""What the inputs of each past period add to rows over chi: the gains of :mod:`gains`, one by one.

The long run needs their sums only. From a start on there are no periods before the first one, the
start itself decays along the rows, and what grows with the state is as large as the state was in
that period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.gains import (
    KernelColumns,
    gains_table,
    kernel_columns,
    product_error,
    running_period,
    sums_over_time,
    tail_gains,
)
from certrack.certificates.implemented.outputs import Row
from certrack.certificates.implemented.period import Period
from certrack.certificates.implemented.powers import powers_of_columns, powers_of_rows
from certrack.core.ball_matrices import above, identity

#: Numbers in the tables of all lags, at most: some 300 MB.
MAX_LAG_NUMBERS = 40_000_000


@dataclass(frozen=True)
class LagGains:
    """Gains of rows by lag; lag j is the period before the running one, j periods earlier.

    The columns of a table are w, r, noise, sample, step, first, as :class:`PeakGains` has them; all
    entries are rounded up.

    Attributes
    ----------
    running : (rows, columns) array
        Of the running period.
    lags : (L, rows, columns) array
    tail : (rows, columns) array
        Of all lags from L on.
    before : Enclosed, (L, rows, N)
        The rows before the running period's jump, times M^j: over zeta of j periods before.
    powers : (L, N, N) array
        |M^j|.
    last : (N, N) array
        |M^L|.
    """

    running: np.ndarray
    lags: np.ndarray
    tail: np.ndarray
    before: Enclosed
    powers: np.ndarray
    last: np.ndarray


def lag_gains(period: Period, rows: Sequence[Row], doublings: int) -> LagGains:
    """The gains of 2^doublings periods one by one, and of what is before them.

    Parameters
    ----------
    period : Period
    rows : of :func:`~certrack.certificates.implemented.outputs.output_rows`
    doublings : int

    Raises
    ------
    NoCertificate
        If the tail does not shrink, or there are too many numbers.
    """
    drive, count, size = period.drive, len(rows), period.size
    width = drive.W.ncols() + drive.n + 4 + size
    if 2**doublings * (count + size) * width > MAX_LAG_NUMBERS:
        raise NoCertificate("the sampled loop is too large, or too slow, for bounds from a start")
    running, past = running_period(period, rows)
    columns = kernel_columns(period, len(period.cells), drive.lipschitz is not None)
    lags, entries, error, last = _by_lag(period, columns, above(past, identity(size)), doublings)
    each = widened(lags[:, count:].sum(axis=0), len(lags))
    return LagGains(
        running=running,
        lags=lags[:, :count],
        tail=tail_gains(last[:count], each, last[count:]),
        before=Enclosed(
            entries[:, :count], np.broadcast_to(error[:count], (len(lags), count, size))
        ),
        powers=widened(np.abs(entries[:, count:]) + error[count:]),
        last=last[count:],
    )


def _by_lag(
    period: Period, columns: KernelColumns, rows: flint.arb_mat, doublings: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Tables of every lag, the rows themselves with what they are off by, and the rows after.

    Returns
    -------
    lags : (L, rows, columns) array
    entries : (L, rows, N) array
    error : (rows, N) array
        Of every lag: the sum of what all of them are off by.
    last : (rows, N) array
        Magnitudes of the rows after L periods.
    """
    count, size, inner = rows.nrows(), period.size, doublings // 2
    block = 2**inner
    table, jumped = powers_of_columns(period.map, columns.all(), inner)
    heads, last = powers_of_rows(jumped, rows, doublings - inner)
    error = product_error(heads, table, count, block)
    repeated = np.repeat(error, block, axis=0)
    lags, entries = [], []
    for head in heads.value.reshape(-1, count, size):
        values = (head @ table.value).reshape(count * block, 1, -1)
        gains = gains_table(columns, period.drive.n, sums_over_time(columns, values, repeated))
        lags.append(gains.reshape(count, block, -1).swapaxes(0, 1))
        entries.append(values[:, 0, -size:].reshape(count, block, size).swapaxes(0, 1))
    return np.concatenate(lags), np.concatenate(entries), error[:, -size:], last
