"""Peak gains, rounded up: the integrals of |c e^{Mt} b| over t >= 0.

The exponentials at the ends of blocks of cells are balls (python-flint), rounded to floats whose
error is known; inside a block the values c F_b E_j b are float products, with the rounding of
every product counted. In a cell of width h, k is within h^2/8 sup |k''| of the line between its
values at the ends. Where k thus keeps its sign, its integral is that of c M^-1 e^{Mt} b between the
ends; else the integral of |k| is that of the absolute line, plus h^3/12 sup |k''|. |k''| is at most
its value at the nearer end plus h/2 times the largest third derivative. That, and the tail after
the last block, come from a P > 0 with (M + mu I)^T P + P (M + mu I) < 0, verified in rationals:
|c e^{Ms} b| <= e^{-mu s} sqrt(c P^-1 c^T) sqrt(b^T P b). It also proves that M is stable.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import flint
import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from certrack.certificates.arithmetic import positive_definite, rational
from certrack.certificates.balls import ball_matrix
from certrack.certificates.certificate import OUT_OF_RANGE, NoCertificate
from certrack.core.ball_matrices import identity

#: Cells in a block; the first cells are this part of the fastest time constant; later ones are at
#: most this part of the time.
CELLS, FIRST_CELL, LATER_CELLS = 64, 0.05, 1 / 250

#: The part of the slowest decay rate that the tail is proven with, and what it may add.
DECAY_PART, TAIL_SHARE = 0.5, 1e-9

#: A state smaller than this against the first is not scaled.
LEAST_STATE_SIZE = 1e-12

#: Bits of the balls; blocks after which a loop is too stiff for this quadrature.
PRECISION, MAX_BLOCKS = 256, 2000

#: Unit roundoff of a float; part of the largest entry that counts as zero; what underflows.
UNIT, SMALL, UNDERFLOW = 2.0**-53, 1e-40, 1e-280

#: Why there is no bound.
NOT_STABLE = "the loop is not stable, or not for all constants of a cell"


@dataclass(frozen=True)
class Decay:
    """|c e^{Ms} b| <= e^{-mu s} sqrt(c P^-1 c^T) sqrt(b^T P b), for all s >= 0."""

    mu: Any
    P: flint.arb_mat
    inverse: flint.arb_mat

    def right(self, B: flint.arb_mat) -> np.ndarray:
        """sqrt(b^T P b) of each column, rounded up."""
        return _roots(B.transpose() * self.P * B)

    def left(self, C: flint.arb_mat) -> np.ndarray:
        """sqrt(c P^-1 c^T) of each row, rounded up."""
        return _roots(C * self.inverse * C.transpose())


def proven_decay(M: np.ndarray, B: np.ndarray) -> Decay:
    """A rate with which e^{Mt} decays, verified in rationals.

    P is made in units in which what the columns of B cause is of one size, so that it says the same
    in whatever units the states are.

    Raises
    ------
    NoCertificate
        If none is proven: the matrix may be unstable.
    """
    floats = M.astype(float)
    if not np.isfinite(floats).all():
        raise NoCertificate(OUT_OF_RANGE)
    slowest = -float(np.linalg.eigvals(floats).real.max())
    if not slowest > 0:
        raise NoCertificate(NOT_STABLE)
    mu = rational(Fraction(DECAY_PART * slowest))
    eye = np.eye(len(M), dtype=object)
    shifted = M + mu * eye
    scale = _sizes(floats, B.astype(float))
    moved = shifted.astype(float) / scale[:, None] * scale[None, :]
    P = _lyapunov(moved.T, -np.eye(len(M))) / np.outer(scale, scale)
    if not np.isfinite(P).all():
        raise NoCertificate(OUT_OF_RANGE)
    exact = np.vectorize(lambda v: rational(Fraction(float(v))), otypes=[object])((P + P.T) / 2)
    form = shifted.T @ exact + exact @ shifted
    if not (positive_definite(exact) and positive_definite(-form)):
        raise NoCertificate("no decay of the loop could be proven: it is not stable, or too stiff")
    balls = ball_matrix(exact)
    return Decay(mu, balls, balls.inv())


def _lyapunov(M: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """X with M X + X M^T = Q, a guess: where it is a poor one SciPy warns, and no proof follows."""
    if not (np.isfinite(M).all() and np.isfinite(Q).all()):
        raise NoCertificate(OUT_OF_RANGE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        X: np.ndarray = solve_continuous_lyapunov(M, Q)
    return X


def _sizes(M: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Sizes of the states relative to the first, under the column that makes them largest."""
    largest = np.full(len(M), LEAST_STATE_SIZE)
    for b in B.T:
        gramian = np.diag(_lyapunov(M, -np.outer(b, b)))
        if gramian[0] > 0:
            largest = np.fmax(largest, np.sqrt(np.maximum(gramian, 0) / gramian[0]))
    return np.where(largest > LEAST_STATE_SIZE, largest, 1.0)


def peak_gains(M: np.ndarray, C: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Upper bounds of int_0^inf |c e^{Mt} b| dt.

    Parameters
    ----------
    M, C, B : (n, n), (rows, n), (n, columns) arrays of rationals

    Returns
    -------
    (rows, columns) array of floats

    Raises
    ------
    NoCertificate
        If M is not proven stable, or too stiff.
    """
    with flint.ctx.workprec(PRECISION):
        decay = proven_decay(M, B)  # also where nothing acts: what begins must end
        if not B.shape[1]:
            return np.zeros((len(C), 0))
        return _integrals(decay, M, ball_matrix(C), ball_matrix(B))


def _integrals(decay: Decay, exact: np.ndarray, C: flint.arb_mat, B: flint.arb_mat) -> np.ndarray:
    M = ball_matrix(exact)
    eigenvalues = np.linalg.eigvals(exact.astype(float))
    first = FIRST_CELL / float(np.abs(eigenvalues).max())
    columns, right = rounded(B), decay.right(B)
    total = np.zeros((C.nrows(), B.ncols()))
    M2 = M * M
    M3, integrated = M2 * M, C * M.inv()
    stacks: dict[int, np.ndarray] = {}
    t = flint.fmpq(0)
    for _ in range(MAX_BLOCKS):
        level = _doublings(float(t), first)
        h = rational(Fraction(first)) * 2**level
        if level not in stacks:
            stacks[level] = _steps(M, h)
        F = (M * flint.arb(t)).exp()
        rows = C * F
        k, error = _values(rounded(rows), stacks[level], columns)
        area, area_error = _values(rounded(integrated * F), stacks[level], columns)
        bend, bend_error = _values(rounded(rows * M2), stacks[level], columns)
        bend = np.abs(bend) + bend_error
        jerk = np.outer(decay.left(rows * M3), right)
        curvature = np.maximum(bend[:-1], bend[1:]) + float(h) / 2 * jerk
        areas = np.abs(np.diff(area, axis=0)) + area_error[:-1] + area_error[1:]
        total += _block(float(h), k, error, areas, curvature)
        t += h * CELLS
        tail = np.outer(decay.left(C * (M * flint.arb(t)).exp()), right) / float(decay.mu)
        if (tail <= TAIL_SHARE * total + UNDERFLOW).all():
            return (total + tail * (1 + 4 * UNIT)) * (1 + 1e4 * UNIT)
    raise NoCertificate("the loop is too stiff for its peak gains to be enclosed")


def _doublings(t: float, first: float) -> int:
    """Doublings of the first cell width at the time t."""
    return max(0, math.floor(math.log2(max(t * LATER_CELLS / first, 1.0))))


def _steps(M: flint.arb_mat, h: Any) -> np.ndarray:
    """e^{M h j}, j = 0 ... CELLS, as floats."""
    one = (M * flint.arb(h)).exp()
    power, powers = identity(M.nrows()), []
    for _ in range(CELLS + 1):
        powers.append(rounded(power))
        power = power * one
    return np.array(powers)


def rounded(balls: flint.arb_mat) -> np.ndarray:
    """Floats of a ball matrix, each within 2 units of roundoff of what is in the ball.

    Where that is (nearly) zero: within SMALL times the largest entry.

    Raises
    ------
    NoCertificate
        If a ball is too wide for that.
    """
    floats = np.empty((balls.nrows(), balls.ncols()))
    for i, ball in enumerate(balls.entries()):
        floats.flat[i] = float(ball.mid())
    allowed = np.maximum(UNIT * np.abs(floats), SMALL * np.abs(floats).max(initial=0.0) + UNDERFLOW)
    for ball, most in zip(balls.entries(), allowed.flat, strict=True):
        if not ball.rad() <= most:
            raise NoCertificate("the loop is too stiff for its peak gains to be enclosed")
    return floats


def _values(
    rows: np.ndarray, steps: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """c F E_j b for all j, and what their roundings are below. Shapes (j, rows, columns).

    Each factor is within 2 units of its exact value and each of the two products rounds n times.
    """
    n = steps.shape[1]
    size = np.abs(rows) @ np.abs(steps) @ np.abs(columns)
    largest = np.abs(rows).max() * np.abs(steps).max() * np.abs(columns).max()
    rounding = (4 * n + 20) * UNIT * size + 4 * n * n * SMALL * largest + UNDERFLOW
    return rows @ steps @ columns, rounding


def _block(
    h: float, k: np.ndarray, error: np.ndarray, areas: np.ndarray, curvature: np.ndarray
) -> np.ndarray:
    """Integral of |k| over a block, rounded up but for the roundings of the sums."""
    size = np.abs(k) + error
    low, high = size[:-1], size[1:]
    least = np.minimum(np.abs(k) - error, 1e300)
    apart = np.minimum(least[:-1], least[1:]) - h**2 / 8 * curvature * (1 + 8 * UNIT)
    one_sign = (k[:-1] * k[1:] > 0) & (apart > 0)
    opposite = (k[:-1] * k[1:] < 0) & (least[:-1] > 0) & (least[1:] > 0)
    steep = np.where(opposite, least[:-1] + least[1:], 1.0)
    line = np.where(opposite, (low**2 + high**2) / steep, low + high)
    bent = h * line / 2 + h**3 / 12 * curvature
    total: np.ndarray = np.where(one_sign, areas, bent).sum(axis=0)
    return total


def _roots(square: flint.arb_mat) -> np.ndarray:
    """Roots of the diagonal, rounded up."""
    return np.array(
        [
            math.sqrt(float(square[i, i].abs_upper()) * (1 + 8 * UNIT)) * (1 + 4 * UNIT)
            for i in range(square.nrows())
        ]
    )
