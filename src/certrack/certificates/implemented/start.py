"""Bounds for all t >= 0 of |e_1|, |x_i|, |u| and the steps of u, from a start or a box of starts.

In the running period k the row of an output is at most

    |lambda M^k (chi_0 - Pi Y(0))| + its part of the reference + sums over the lags j < k of
    its gains times the inputs' bounds; w of lag j is bounded by the states of period k - 1 - j.

X(0), X(1) ... follow one after the other: an X(k) strictly above its own right-hand side bounds
period k, for the state is continuous and would have to pass it first. A finite number K of periods
says nothing of what comes later. So a last vector X_t is asked for that bounds every period from K
on, with E the largest X(k) from K1 on and P the largest of all,

    X_t > T_K + sum_{j < K-K1} D_j w(max(E, X_t)) + sum_{j >= K-K1} D_j w(max(P, X_t)) + the rest,

where the sums go on to infinity by the tail of the gains, and T_K bounds what the start adds after
K periods: |M^K z| <= d with |M^K| d <= d, so it stays below d at every later multiple of K.

All numbers are floats rounded up, from balls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.enclosed import ROUNDOFF, Enclosed, widened
from certrack.certificates.implemented.gains import largest_of_each
from certrack.certificates.implemented.lags import LagGains, lag_gains
from certrack.certificates.implemented.outputs import output_rows, steady
from certrack.certificates.implemented.period import Period

#: By how much an X(k) is widened before it is checked, and how often that is tried.
PERIOD_MARGIN, PERIOD_STEPS = 1e-9, 60

#: The same of X_t, which other checkers must find above their own right-hand sides.
LATER_MARGIN, LATER_STEPS, SMALLEST = 1e-6, 2000, 1e-280


@dataclass(frozen=True)
class Starts:
    """x(0) in a box, and the reference at t = 0.

    Attributes
    ----------
    center, half : n balls
    Y : q + 1 balls, or None
        y_d(0) ... y_d^(q)(0); None for every reference within its bounds.
    jump : rational, or None
        Size of the jumps of y_d^(q+1), if there are some.
    jumps_apart : int, or None
        Periods between two of them at least; None if there is but one.
    initial : ball
        The input before the first sample, without the constant of the law.
    """

    center: tuple[Any, ...]
    half: tuple[Any, ...]
    Y: tuple[Any, ...] | None
    initial: Any
    jump: Any | None = None
    jumps_apart: int | None = None


@dataclass(frozen=True)
class Later:
    """What bounds every period from K on: X_t and the input's, floats."""

    states: tuple[float, ...]
    input: float


@dataclass(frozen=True)
class Transient:
    """What a set of starts adds to the rows, and what they are.

    Attributes
    ----------
    of_x0 : Enclosed, (K, rows, n)
        Rows over x(0).
    fixed : Enclosed, (K, rows)
        What the reference at t = 0 and the input before the first sample add.
    free : (K, rows) array
        Bounds of what is not known: the sensors at t = 0, and every phase.
    size : (K, rows) array
        Bounds of all of it.
    later : (rows,) array
        The same of all periods from K on.
    """

    of_x0: Enclosed
    fixed: Enclosed
    free: np.ndarray
    size: np.ndarray
    later: np.ndarray


@dataclass(frozen=True)
class PeriodBounds:
    """Bounds in the periods 0 ... K-1.

    Attributes
    ----------
    bounds : (K, m + 3) array
        Of e_1, the m states and channels, u, its steps.
    forced : (K, 2) array
        What u and its steps have of it besides the start.
    """

    bounds: np.ndarray
    forced: np.ndarray


class FromStarts:
    """Right-hand sides for one period of a drive.

    Parameters
    ----------
    period : Period
    doublings : int
        K = 2^doublings.

    Raises
    ------
    NoCertificate
        If the gains' tail does not shrink.
    """

    def __init__(self, period: Period, doublings: int) -> None:
        drive, n = period.drive, period.drive.sized
        self.period, self.drive, self.rows = period, drive, output_rows(period)
        self.gains: LagGains = lag_gains(period, self.rows, doublings)
        self.count = len(self.gains.lags)
        self.outputs = np.array([row.output for row in self.rows])
        self.begins = np.searchsorted(self.outputs, np.arange(n + 3))
        nw = drive.W.ncols()
        self._w = self.gains.lags[:, :, :nw]
        self._by_lag = np.ascontiguousarray(self._w.swapaxes(0, 1).reshape(len(self.rows), -1))
        self._set_in_cells(nw)
        self._set_constants(nw)
        self._growth = tuple(
            _all_up(lists).reshape(nw, width)
            for width, lists in (
                (1, [(b.gamma,) for b in drive.uncertain]),
                (1, [(b.beta,) for b in drive.uncertain]),
                (n, [b.weights for b in drive.uncertain]),
                (n, [b.Delta for b in drive.uncertain]),
            )
        )
        self._set_affine()

    def _set_affine(self) -> None:
        """B and b, where all that depends on the states in the running period is B X + b."""
        _, beta, _, Delta = self._growth
        self._affine: tuple[np.ndarray, np.ndarray] | None = None
        if all(bound.gamma == 0 and bound.growing is None for bound in self.drive.uncertain):
            of_states = self._running_w @ Delta + self._of_x
            constant = self._running_w @ beta[:, 0]
            self._affine = widened(of_states, len(beta) + 8), widened(constant, len(beta) + 8)

    def _set_in_cells(self, nw: int) -> None:
        rows = self.rows
        of_w, of_x, of_u, of_r = (
            _all_up([[v * row.share for v in values(row)] for row in rows])
            for values in (
                lambda row: row.in_cell.w,
                lambda row: row.in_cell.x,
                lambda row: (row.in_cell.u,),
                lambda row: (row.in_cell.r,),
            )
        )
        self._running_w = widened(self.gains.running[:, :nw] + of_w.reshape(len(rows), nw))
        self._of_x, self._of_u, self._of_r = of_x, of_u[:, 0], of_r[:, 0]

    def _set_constants(self, nw: int) -> None:
        """What is added that neither the start nor the states bear on, without jumps."""
        drive, gains = self.drive, self.gains
        sample = drive.Y[-1] if drive.lipschitz is None else drive.T / 2 * drive.lipschitz
        bounds = _all_up([[drive.Y[-1], *drive.mu, sample, drive.eta, drive.Y[-1]]])[0]
        still = _all_up([steady(self.period, row) for row in self.rows])
        running = gains.running[:, nw:] @ bounds + self._of_r * bounds[0]
        running = running + still @ np.array([up(v) for v in drive.Y[:-1]])
        each = gains.lags[:, :, nw:] @ bounds
        before = np.concatenate([np.zeros((1, len(self.rows))), np.cumsum(each, axis=0)])
        K = self.count
        self._constant = widened(running + before[:K], K + 32)
        self._constant_later = widened(running + before[K] + gains.tail[:, nw:] @ bounds, K + 32)
        self._sample_column = nw + 1 + drive.n

    def _jumping(self, starts: Starts) -> np.ndarray | float:
        """What jumps of the last derivative add."""
        if starts.jump is None:
            return 0.0
        each = self.gains.lags[:, :, self._sample_column].T
        apart = min(starts.jumps_apart or self.count, self.count)
        total = largest_of_each(each, apart) + self.gains.tail[:, self._sample_column]
        return widened(total * up(starts.jump), self.count + 8)

    def transient(self, starts: Starts) -> Transient:
        """What the starts add to every row.

        Raises
        ------
        NoCertificate
            If it does not decay.
        """
        period, drive, before = self.period, self.drive, self.gains.before
        Z, of_noise = first_state(drive, period.size)
        mu = np.array([up(v) for v in drive.mu])
        fixed = flint.arb_mat(period.size, 1)
        for i in range(period.command, period.size):
            fixed[i, 0] = starts.initial
        for i in range(drive.memories):
            fixed[drive.n + i, 0] = drive.first_input[i, 0] * starts.initial
        free = _product_with(before, Enclosed.of(of_noise)).upper @ mu
        start_free = Enclosed.of(of_noise).upper @ mu
        if starts.Y is not None:
            fixed = fixed - period.Pi[-1] * flint.arb_mat([[v] for v in starts.Y])
        else:
            Y = np.array([up(v) for v in drive.Y[:-1]])
            reference = Enclosed.of(period.Pi[-1])
            free = free + _product_with(before, reference).upper @ Y
            start_free = start_free + reference.upper @ Y
        center = fixed + Z * flint.arb_mat([[v] for v in starts.center])
        half = np.array([up(v) for v in starts.half])
        of_x0 = _product_with(before, Enclosed.of(Z))
        free = widened(free, period.size + 8)
        size = _product_with(before, Enclosed.of(center)).upper[:, :, 0] + of_x0.upper @ half + free
        zeta = Enclosed.of(center).upper[:, 0] + Enclosed.of(Z).upper @ half + start_free
        into = _product_with(before, Enclosed.of(fixed))
        return Transient(
            of_x0,
            Enclosed(into.value[:, :, 0], into.error[:, :, 0]),
            free,
            widened(size, period.size + 8),
            self._later_transient(widened(zeta, period.size + 8)),
        )

    def _later_transient(self, zeta: np.ndarray) -> np.ndarray:
        """Bounds of what |zeta_0| <= zeta adds to the rows from period K on."""
        gains, size = self.gains, self.period.size
        largest = widened((gains.powers @ zeta).max(axis=0), size) + SMALLEST
        d = widened(gains.last @ largest, size)
        if not (widened(gains.last @ d, size) <= d).all():
            raise NoCertificate("the start is not forgotten in the periods that are looked at")
        magnitudes = widened(np.abs(gains.before.value) + gains.before.error)
        later: np.ndarray = widened((magnitudes @ d).max(axis=0), size)
        return later

    def sizes(self, X: np.ndarray) -> np.ndarray:
        """Bounds of w where |x| <= X."""
        gamma, beta, weights, Delta = self._growth
        if not len(gamma):
            return np.zeros(0)
        norm = np.sqrt(((weights * X) ** 2).sum(axis=1))
        values = widened(gamma[:, 0] * norm + Delta @ X + beta[:, 0], 2 * len(X) + 8)
        for j, bound in enumerate(self.drive.uncertain):
            if bound.growing is not None:
                norm_above = widened(norm[j], 2 * len(X) + 8)
                values[j] = bound.growing.largest_float(X.tolist(), float(norm_above))
        return values

    def largest(self, values: np.ndarray) -> np.ndarray:
        """The largest of the rows of each output."""
        return np.maximum.reduceat(values, self.begins)

    def run(self, starts: Starts, transient: Transient) -> PeriodBounds:
        """Bounds of all outputs in the periods 0 ... K-1.

        Raises
        ------
        NoCertificate
            If a period has no bound.
        """
        n, nw, K = self.drive.sized, self.drive.W.ncols(), self.count
        constant = widened(self._constant + self._jumping(starts), 8)
        history = np.zeros(K * nw)  # sizes of w, the newest period first
        bounds, forced = np.zeros((K, n + 3)), np.zeros((K, 2))
        center = np.array([up(v) for v in starts.center])
        X = widened(center + np.array([up(v) for v in starts.half]))
        X = np.concatenate([X, np.zeros(n - len(X))])  # channels grow to what follows
        U = up(starts.initial)
        for k in range(K):
            past = self._by_lag[:, : k * nw] @ history[(K - k) * nw :]
            base = widened(constant[k] + past, k * nw + 8)
            forced[k] = base[self.begins[n + 1] :]
            base = widened(base + transient.size[k])
            U = max(U, float(base[self.begins[n + 1]]))
            base = widened(base + self._of_u * U)
            image = self._image(base, X)
            for _ in range(PERIOD_STEPS):
                X = image[1 : n + 1] * (1 + PERIOD_MARGIN) + SMALLEST
                image = self._image(base, X)
                if (image[1 : n + 1] < X).all():
                    break
            else:
                raise NoCertificate("the states have no bound in a period: it is too long for them")
            bounds[k], bounds[k, 1 : n + 1] = image, X
            history[(K - k - 1) * nw : (K - k) * nw] = self.sizes(X)
        if not np.isfinite(bounds).all():
            raise NoCertificate("bounds from the start leave the range of floating point")
        return PeriodBounds(bounds, forced)

    def _image(self, base: np.ndarray, X: np.ndarray) -> np.ndarray:
        if self._affine is not None:
            of_states, constant = self._affine
            values = base + constant + of_states @ X
        else:
            values = base + self._running_w @ self.sizes(X) + self._of_x @ X
        return self.largest(widened(values, 2 * len(X) + 8))

    def later_image(
        self, starts: Starts, transient: Transient, run: PeriodBounds, middle: int, later: Later
    ) -> np.ndarray:
        """Bounds of all outputs in the periods from K on, if `later` bounds them.

        Parameters
        ----------
        starts : Starts
        transient : Transient
        run : PeriodBounds
        middle : int
            K1.
        later : Later

        Returns
        -------
        m + 3 floats
        """
        n, nw, bounds = self.drive.sized, self.drive.W.ncols(), run.bounds
        X = np.array(later.states)
        U = max(later.input, up(starts.initial), float(bounds[:, n + 1].max()))
        recent = np.maximum(bounds[middle:, 1 : n + 1].max(axis=0, initial=0.0), X)
        any_time = np.maximum(bounds[:, 1 : n + 1].max(axis=0), X)
        split = self.count - middle
        near = widened(self._w[:split].sum(axis=0), self.count)
        far = widened(self._w[split:].sum(axis=0) + self.gains.tail[:, :nw], self.count)
        values = (
            self._constant_later
            + transient.later
            + self._jumping(starts)
            + near @ self.sizes(recent)
            + far @ self.sizes(any_time)
            + self._running_w @ self.sizes(X)
            + self._of_x @ X
            + self._of_u * U
        )
        return self.largest(widened(values, 4 * nw + n + 16))

    def find_later(
        self, starts: Starts, transient: Transient, run: PeriodBounds, middle: int
    ) -> Later:
        """A bound of all periods from K on.

        Raises
        ------
        NoCertificate
            If none is found.
        """
        n = self.drive.sized
        later = Later((0.0,) * n, 0.0)
        for _ in range(LATER_STEPS):
            image = self.later_image(starts, transient, run, middle, later)
            if is_above(later, image):
                return later
            if not np.isfinite(image).all():
                break
            widest = image * (1 + LATER_MARGIN) + SMALLEST
            later = Later(tuple(widest[1 : n + 1].tolist()), float(widest[n + 1]))
        raise NoCertificate("no bound was found for what comes after the periods looked at")


def is_above(later: Later, image: np.ndarray) -> bool:
    """Whether X_t is strictly above what follows from it."""
    n = len(later.states)
    states = bool((np.array(later.states) > image[1 : n + 1]).all())
    return states and later.input > image[n + 1]


def first_state(drive: Drive, size: int) -> tuple[flint.arb_mat, flint.arb_mat]:
    """chi before the first sample over x(0), and over the sensors' errors at it.

    The first memories are what is measured at the first sample: there is no difference yet.
    """
    n = drive.n
    Z, of_noise = flint.arb_mat(size, n), flint.arb_mat(size, n)
    for j in range(n):
        Z[j, j] = 1
        for i in range(drive.memories):
            Z[n + i, j] = of_noise[n + i, j] = drive.first[i, j]
    return Z, of_noise


def _product_with(a: Enclosed, b: Enclosed) -> Enclosed:
    """The product of stacks of matrices with a matrix."""
    size = b.value.shape[0]
    p, q = np.abs(a.value), np.abs(b.value)
    rounding = 2 * (size + 4) * ROUNDOFF * (p @ q)
    error = rounding + p @ b.error + a.error @ (q + b.error)
    return Enclosed(a.value @ b.value, widened(error, 2 * size + 8))


def _all_up(table: Sequence[Sequence[Any]]) -> np.ndarray:
    """:func:`up` of every entry of a table."""
    width = len(table[0]) if table else 0
    entries = [flint.arb(value) for row in table for value in row]
    return Enclosed.of(flint.arb_mat(len(table), width, entries)).upper


def up(value: Any) -> float:
    """A float not below the magnitude of a rational or a ball."""
    return float(Enclosed.of(flint.arb_mat([[flint.arb(value)]])).upper[0, 0])
