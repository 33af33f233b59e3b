"""Bounds for all time from a start: of the error, of every state, and of the input.

From chi_0, zeta_0 = chi_0 - Pi Y(0), an output of the period k is at most

    X(k) = |lambda_k zeta_0| + c + sum_{l<=k} D_l wbar(X(k - l))

with lambda_k the row k periods back, D_l its gains of lag l, and c all that does not come from the
uncertain terms. X may be any sequence that is above this: nothing leaves it first. After L periods
one X_t stands for all of them. With P and E the largest X(k) of all k < L, and of the later half,

    X_t > |lambda_L| sup_j |M^j zeta_0| + c + (sum_{l<=L/2} D_l) wbar(max(E, X_t))
                                           + (sum_{l>L/2} D_l) wbar(max(P, X_t)).

If what bounds the input so is within its limits, these never act: the loop is the linear one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up
from certrack.certificates.implemented.drive import DRIVE_BITS, Drive, drive_of
from certrack.certificates.implemented.enclosed import ROUNDOFF, Enclosed, widened
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.gains import output_gains
from certrack.certificates.implemented.lags import Lags, lags_of
from certrack.certificates.implemented.outputs import Row, output_rows
from certrack.certificates.implemented.period import Period, beside, one_period
from certrack.certificates.implemented.proof import cells_of, periods_needed
from certrack.certificates.start import reference_at_start, states_at_start
from certrack.systems.system import System

#: Steps towards the implicit part of a period, and by how much each is widened.
IMPLICIT_STEPS, IMPLICIT_MARGIN = 60, 1e-9

#: Added where a number might be zero.
NEARLY_ZERO = 1e-290

#: What may be left of the rows where the bounds of single periods end.
LEFT_OF_TRANSIENT = 1e-6


@dataclass(frozen=True)
class StartBounds:
    """What holds for all time from the starts; every number is rounded up.

    Attributes
    ----------
    period : float, s
    values : (L, n + 3) array
        Of |e_1| and the states from t_k to t_{k+1}, of |u_k|, and of |u_k - u_{k-1}|; u is without
        the constant of the law.
    last : (n + 3,) array
        The same for all t >= L period.
    offset : float
        The constant of the law, as a magnitude.
    """

    period: float
    values: np.ndarray
    last: np.ndarray
    offset: float

    @property
    def error(self) -> np.ndarray:
        """Bounds of |e_1| from t_k to t_{k+1}."""
        errors: np.ndarray = self.values[:, 0]
        return errors

    @property
    def peaks(self) -> np.ndarray:
        """The largest of every column, for all time."""
        largest: np.ndarray = np.maximum(self.values.max(axis=0), self.last)
        return largest

    @property
    def peak_input(self) -> float:
        """Of |u|, for all time."""
        return float(widened(self.peaks[-2] + self.offset))

    @property
    def peak_states(self) -> tuple[float, ...]:
        """Of |x_i|, for all time."""
        return tuple(self.peaks[1:-2].tolist())


@dataclass(frozen=True)
class StartingLoop:
    """What bounds from any start are computed from; of one system and delay.

    Attributes
    ----------
    period : Period
    rows : output rows
    bounds : OutputBounds
    lags : Lags
    Z : (N, n) ball matrix
        The state of the loop before its first sample, over x(0).
    noise : (N, n) ball matrix
        The same over the sensors' errors at the first sample.
    inputs : (N, 1) ball matrix
        What waits at t = 0.
    """

    period: Period
    rows: Sequence[Row]
    bounds: OutputBounds
    lags: Lags
    Z: flint.arb_mat
    noise: flint.arb_mat
    inputs: flint.arb_mat

    @property
    def drive(self) -> Drive:
        """The loop's data."""
        return self.period.drive


def starting_loop(system: System, delay: Any | None = None) -> StartingLoop:
    """Everything that does not depend on the start.

    Parameters
    ----------
    system : System
    delay : rational, optional
        Periods; the first of the file if left out.

    Raises
    ------
    NoCertificate
        Where the loop has no certificate as implemented, or its first sample is late.
    """
    drive, implementation = drive_of(system, delay), system.implementation
    assert implementation is not None
    if implementation.offset:
        raise NoCertificate("bounds from a start need the first sample at t = 0")
    if drive.jumps_once:
        raise NoCertificate("a reference that jumps once has no bounds from a start")
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive, cells_of(drive))
        rows, doublings = output_rows(period), periods_needed(period, LEFT_OF_TRANSIENT)
        bounds = OutputBounds.of(period, rows, output_gains(period, rows, doublings))
        n, size = drive.n, period.size
        Z, noise, inputs = (flint.arb_mat(size, columns) for columns in (n, n, 1))
        for i in range(n):
            Z[i, i] = 1
        for i in range(drive.memories):
            for j in range(n):
                Z[n + i, j] = noise[n + i, j] = drive.first[i, j]
        for i in range(period.command, size):
            inputs[i, 0] = flint.arb(rational(implementation.initial_input) - drive.offset)
        lags = lags_of(period, rows, doublings)
        return StartingLoop(period, rows, bounds, lags, Z, noise, inputs)


def bounds_from_start(
    system: System,
    box: Sequence[tuple[float, float]] | None = None,
    *,
    any_reference: bool = False,
    loop: StartingLoop | None = None,
) -> StartBounds:
    """Bounds for all time from the system's own start, or from a box of starts.

    Parameters
    ----------
    system : System
    box : n pairs (low, high), optional
    any_reference : bool
        Whether the reference may begin anywhere within its bounds, and not only as the file's.
    loop : StartingLoop, optional
        Of the system, where it has been made before.

    Returns
    -------
    StartBounds
        Of the linear loop: they hold for the one with limits if the input stays within them.

    Raises
    ------
    NoCertificate
        If there are none.
    """
    loop = starting_loop(system) if loop is None else loop
    with flint.ctx.workprec(DRIVE_BITS):
        spread = zeta_at_start(system, loop, box, any_reference)
        return _volterra(loop, *_transient(loop, spread))


def zeta_at_start(
    system: System,
    loop: StartingLoop,
    box: Sequence[tuple[float, float]] | None,
    any_reference: bool,
) -> Enclosed:
    """The starts as columns: |lambda zeta_0| <= sum over the columns of |lambda column|."""
    drive = loop.drive
    if box is None:
        ends, proven = states_at_start(system)
        if not proven:
            raise NoCertificate("the start is not known exactly")
        centre = [flint.arb(v.mid()) for v in ends]
        half = [flint.arb(v.rad()) for v in ends]
    else:
        pairs = [tuple(map(rational, pair)) for pair in box]
        centre = [flint.arb((low + high) / 2) for low, high in pairs]
        half = [flint.arb((high - low) / 2) for low, high in pairs]
    middle = loop.Z * flint.arb_mat([[v] for v in centre]) + loop.inputs
    scaled = [
        _columns_times(loop.Z, half),
        _columns_times(loop.noise, [flint.arb(v) for v in drive.mu]),
    ]
    if any_reference:
        scaled.append(_columns_times(loop.period.Pi[-1], [flint.arb(v) for v in drive.Y[:-1]]))
    else:
        Y, proven = reference_at_start(system, drive.q)
        if not proven:
            raise NoCertificate("the reference is not known exactly where it begins")
        middle = middle - loop.period.Pi[-1] * flint.arb_mat([[v] for v in Y])
    return Enclosed.of(beside(middle, *scaled))


def _columns_times(matrix: flint.arb_mat, factors: Sequence[Any]) -> flint.arb_mat:
    """The columns times factors."""
    rows = [[v * f for v, f in zip(row, factors, strict=True)] for row in matrix.tolist()]
    return flint.arb_mat(rows)


def _transient(loop: StartingLoop, zeta: Enclosed) -> tuple[np.ndarray, np.ndarray]:
    """|lambda_k zeta_0| of every row, (rows, L), and a bound of it for all later k, (rows,)."""
    of_rows = products_above(loop.lags.past, zeta).sum(axis=2)
    units = products_above(loop.lags.units, zeta).sum(axis=2)
    size = len(units)
    power = loop.lags.power
    start = units.max(axis=1)
    d = np.maximum(start, NEARLY_ZERO + 1e-30 * start.max())
    nu = float(widened((power @ d) / d, size + 4).max())
    if not nu < 1:
        raise NoCertificate("the transient of the sampled loop does not shrink in time")
    largest = widened(start + nu * d, 4)  # of |M^j zeta_0|, for all j
    columns = zeta.value.shape[1]
    return widened(of_rows, columns), widened(loop.lags.last @ largest, size + 4)


def products_above(rows: Enclosed, columns: Enclosed) -> np.ndarray:
    """Upper bounds of |row column|, (..., columns)."""
    size = rows.value.shape[-1]
    at = np.abs(rows.value @ columns.value)
    magnitude = np.abs(rows.value) + rows.error
    off = rows.error @ np.abs(columns.value) + magnitude @ columns.error
    off += 2 * (size + 4) * ROUNDOFF * (np.abs(rows.value) @ np.abs(columns.value))
    return widened(at + off, 4 * size)


def _volterra(loop: StartingLoop, transient: np.ndarray, later: np.ndarray) -> StartBounds:
    bounds, drive = loop.bounds, loop.drive
    n, outputs = drive.n, bounds.outputs
    groups = [np.flatnonzero(outputs == k) for k in range(n + 3)]
    share = _uppers([row.share for row in loop.rows])
    in_cell = _uppers([row.in_cell.w for row in loop.rows]).reshape(len(outputs), -1)
    w = loop.lags.w.copy()
    w[:, 0] += share[:, None] * in_cell
    w = widened(w)
    D = _per_output(w, groups)
    constant = _per_output(_uppers(bounds.constant), groups)
    x, u = _per_output(_uppers(bounds.x), groups), _per_output(_uppers(bounds.u), groups)
    free = _per_output(transient, groups) + constant[:, None]
    size = _Size(drive)
    count = free.shape[1]
    v, sizes = np.zeros((count, n + 3)), np.zeros((count, D.shape[2]))

    def image(past: np.ndarray, largest: float, value: np.ndarray) -> np.ndarray:
        added = D[:, 0] @ size(value[1:-2]) + x @ value[1:-2] + u * max(largest, value[-2])
        return widened(past + added, count + 64)

    waiting = float(Enclosed.of(loop.inputs).upper.max())  # inputs that may act still

    for k in range(count):
        past = free[:, k].copy()
        if k:
            past += np.tensordot(D[:, 1 : k + 1], sizes[k - 1 :: -1], axes=([1, 2], [0, 1]))
        v[k] = _implicit(partial(image, past, waiting), v[k - 1] if k else past)
        sizes[k] = size(v[k][1:-2])
        waiting = max(waiting, v[k][-2])
    half = count // 2
    recent, ever = v[half:].max(axis=0), v.max(axis=0)
    ever[-2] = max(ever[-2], waiting)
    near = _per_output(widened(w[:, : half + 1].sum(axis=1), count), groups)
    far = widened(w[:, half + 1 :].sum(axis=1) + bounds.gains.older, count)
    far, remaining = _per_output(far, groups), _per_output(later, groups)

    def at_last(value: np.ndarray) -> np.ndarray:
        late, early = np.maximum(recent, value), np.maximum(ever, value)
        past = constant + remaining + near @ size(late[1:-2]) + far @ size(early[1:-2])
        return widened(past + x @ early[1:-2] + u * early[-2], count + 64)

    last = _implicit(at_last, recent)
    return StartBounds(float(drive.T), v, last, float_up(abs(drive.offset)))


def _implicit(image: Any, guess: np.ndarray) -> np.ndarray:
    """A value above its image.

    Raises
    ------
    NoCertificate
        If none is found.
    """
    value = guess
    for _ in range(IMPLICIT_STEPS):
        after = image(value)
        if (after[1:] < value[1:]).all():
            after[1:] = value[1:]
            return after
        value = np.maximum(after, value * 0) * (1 + IMPLICIT_MARGIN) + NEARLY_ZERO
    raise NoCertificate("the uncertain terms grow faster than the sampled loop can hold them")


class _Size:
    """Upper bounds of |w| where |x| <= X, in floats."""

    def __init__(self, drive: Drive) -> None:
        uncertain = drive.uncertain
        self.gamma = np.array([float_up(b.gamma) for b in uncertain])
        self.beta = np.array([float_up(b.beta) for b in uncertain])
        weights, Delta = (
            np.array([[float_up(v) for v in row] for row in rows]).reshape(-1, drive.n)
            for rows in ([b.weights for b in uncertain], [b.Delta for b in uncertain])
        )
        self.weights, self.Delta = weights, Delta

    def __call__(self, X: np.ndarray) -> np.ndarray:
        norm = np.sqrt(((self.weights * X) ** 2).sum(axis=1))
        return widened(self.gamma * norm + self.Delta @ X + self.beta, 2 * len(X) + 8)


def _uppers(balls: Any) -> np.ndarray:
    """Floats not below balls or rationals that are not negative."""
    array = np.array(balls, dtype=object)
    entries = [flint.arb(v) for v in array.ravel()]
    if not entries:
        return np.zeros(array.shape)
    return Enclosed.of(flint.arb_mat([entries])).upper.reshape(array.shape)


def _per_output(values: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """The largest of the rows of each output."""
    return np.array([values[rows].max(axis=0) for rows in groups])
