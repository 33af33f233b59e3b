"""The bound of the implemented loop in floats: fast, for searches; nothing is verified.

The same rows, kernels and fixed point as the proof's, without the enclosures, the bends of kernels
within a cell, the tail, and partial cancellation of the reference: where that helps, the proof's
bound is smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import within_floats
from certrack.certificates.implemented.drive import drive_of
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.float_image import FloatImage
from certrack.certificates.implemented.gains import (
    PeakGains,
    gains_of,
    kernel_columns,
    largest_of_each,
    mean_magnitude,
    running_period,
)
from certrack.certificates.implemented.outputs import Row, output_rows
from certrack.certificates.implemented.period import Period, one_period
from certrack.certificates.implemented.proof import cells_of, periods_needed
from certrack.core.ball_matrices import beside
from certrack.systems.system import System

#: What may be left of the rows where the sums end, and bits of the period's balls.
LEFT_OF_ESTIMATE, ESTIMATE_BITS = 1e-5, 100


@dataclass(frozen=True)
class Estimate:
    """The bound, as far as floats tell.

    Attributes
    ----------
    bound : float
        Of limsup |e_1|.
    states : n floats
    peak_input : float
    offset : float
        What a constant of the law adds to it.
    image : FloatImage
        What they are a fixed point of.
    grid : parts and doublings
        Cells before and after the input changes, and how many periods are summed.
    """

    bound: float
    states: tuple[float, ...]
    peak_input: float
    offset: float
    image: FloatImage
    grid: tuple[tuple[int, int], int]


def estimate_implemented(system: System, delay: Any | None = None) -> Estimate:
    """The bound of the implemented loop, estimated.

    Parameters
    ----------
    system : System
        With an implementation.
    delay : rational, optional
        Periods; the first of the file if left out.

    Returns
    -------
    Estimate

    Raises
    ------
    NoCertificate
        If there is none, with the reason.

    Examples
    --------
    >>> import certrack
    >>> drive = certrack.Implementation(period=0.003, delay=0.5)
    >>> found = estimate_implemented(certrack.load("dual-motor-lean").replace(implementation=drive))
    >>> round(found.bound, 6)
    0.001279
    """
    drive = drive_of(system, delay)
    with flint.ctx.workprec(ESTIMATE_BITS), within_floats():
        period = one_period(drive, cells_of(drive))
        doublings = periods_needed(period, LEFT_OF_ESTIMATE)
        bounds = _estimated_bounds(period, doublings)
        X, U = bounds.search()
        error, *states, peak, _ = (float(v) for v in bounds.image(X, U))
    grid = cells_of(drive), doublings
    offset = abs(float(drive.offset))
    return Estimate(error, tuple(states), peak + offset, offset, bounds.in_floats(), grid)


@dataclass(frozen=True)
class Neighbour:
    """The bounds of a loop nearby, to the first order of what it differs by.

    Attributes
    ----------
    bound, peak_input : float
    """

    bound: float
    peak_input: float


def estimate_nearby(system: System, known: Estimate, delay: Any | None = None) -> Neighbour:
    """The bounds of a loop near one whose bounds are known: its fixed point is not searched.

    With v = F(v) there and F' here, an output o changes from F_o(v) to

        F_o'(v) + dF_o/dv (1 - dF/dv)^-1 (F'(v) - F(v))

    Parameters
    ----------
    system : System
    known : Estimate
        Whose grid it is estimated on.
    delay : rational, optional
        As there.

    Raises
    ------
    NoCertificate
        If a number leaves the range of floats.
    """
    drive = drive_of(system, delay)
    parts, doublings = known.grid
    with flint.ctx.workprec(ESTIMATE_BITS), within_floats():
        image = _estimated_bounds(one_period(drive, parts), doublings).in_floats()
    v = np.array([*known.states, known.peak_input - known.offset])
    rows = known.image.largest_rows(v)
    slopes = known.image.derivative(v, rows)
    after, before = image.values(v)[rows], known.image.values(v)[rows]
    moved = np.linalg.solve(np.eye(len(v)) - slopes[1:-1], (after - before)[1:-1])
    bound, *_, peak, _ = after + slopes @ moved
    return Neighbour(float(bound), float(peak) + abs(float(drive.offset)))


def _estimated_bounds(period: Period, doublings: int) -> OutputBounds:
    rows = output_rows(period)
    return OutputBounds.of(period, rows, _estimated_gains(period, rows, doublings))


def _estimated_gains(period: Period, rows: Sequence[Row], doublings: int) -> PeakGains:
    drive, nw = period.drive, period.W.ncols()
    table, before = running_period(period, rows)
    seen = kernel_columns(period, len(period.cells), smeared=drive.lipschitz is not None)
    columns = Enclosed.of(beside(seen.nodes, seen.samples)).value
    heads, power = Enclosed.of(before).value, Enclosed.of(period.map).value
    inner = doublings // 2
    for _ in range(inner):
        columns = np.hstack([columns, power @ columns])
        power = power @ power
    for _ in range(doublings - inner):
        heads = np.vstack([heads, heads @ power])
        power = power @ power
    count, block = len(rows), 2**inner
    ends = len(seen.lengths) + 1
    width = ends * (nw + 1)
    total = np.zeros((count, nw + 1 + drive.n + 2))
    samples = []
    for b in range(len(heads) // count):
        values = (heads[b * count : (b + 1) * count] @ columns).reshape(count, block, -1)
        nodes = values[:, :, :width].reshape(count, block, ends, nw + 1)
        lines = mean_magnitude(nodes[:, :, :-1], nodes[:, :, 1:]).sum(axis=1)
        total[:, : nw + 1] += np.einsum("c,rcw->rw", seen.lengths, lines)
        sizes = np.abs(values[:, :, width:])
        total[:, nw + 1 :] += sizes.sum(axis=1)
        samples.append(sizes[:, :, drive.n])
    total = total + table[:, :-1]
    jump = np.zeros(count)
    if drive.jumps is not None:
        jump = largest_of_each(np.hstack(samples), drive.periods_between_jumps)
    return gains_of(np.hstack([total, table[:, -1:]]), nw, drive.n, jump)
