"""Peak gains, rounded up: the integrals of |c e^{Mt} b| over t >= 0.

The exponentials at the ends of blocks of cells are balls (python-flint), rounded to floats whose
error is known; inside a block the values c F_b E_j b are float products, with the rounding of every
product counted. In a cell of width h

    int |k| <= h/2 (|k_i| + |k_{i+1}|) + h^3/12 sup |k''|

and |k''| is at most its value at the nearer end plus h/2 sup |k'''|. That, and the tail after the
last block, come from a P > 0 with (M + mu I)^T P + P (M + mu I) < 0, verified in rationals:
|c e^{Ms} b| <= e^{-mu s} sqrt(c P^-1 c^T) sqrt(b^T P b). It also proves that M is stable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import flint
import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from certrack.certificates.arithmetic import positive_definite, rational
from certrack.certificates.certificate import NoCertificate

#: Cells in a block; the first cells are this part of the fastest time constant; later ones are at
#: most this part of the time.
CELLS, FIRST_CELL, LATER_CELLS = 64, 0.05, 1 / 250

#: The part of the slowest decay rate that the tail is proven with, and what it may add.
DECAY_PART, TAIL = 0.5, 1e-9

#: Bits of the balls; blocks after which a loop is too stiff for this quadrature.
PRECISION, MAX_BLOCKS = 256, 2000

#: Unit roundoff of a float, and a bound for what underflows.
UNIT, TINY = 2.0**-53, 1e-280


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


def proven_decay(M: np.ndarray) -> Decay:
    """A rate with which e^{Mt} decays, verified in rationals.

    Raises
    ------
    NoCertificate
        If none is proven: the matrix may be unstable.
    """
    floats = M.astype(float)
    slowest = -float(np.linalg.eigvals(floats).real.max())
    if not slowest > 0:
        raise NoCertificate("the loop is not stable for all constants of a cell")
    mu = rational(Fraction(DECAY_PART * slowest))
    eye = np.eye(len(M), dtype=object)
    shifted = M + mu * eye
    # scaled so that the states are of one size, or the floats of P would not do
    scale = np.sqrt(np.diag(solve_continuous_lyapunov(floats, -np.diag(np.diag(floats) ** 2 + 1))))
    moved = shifted.astype(float) / scale[:, None] * scale[None, :]
    P = solve_continuous_lyapunov(moved.T, -np.eye(len(M))) / np.outer(scale, scale)
    exact = np.vectorize(lambda v: rational(Fraction(float(v))), otypes=[object])((P + P.T) / 2)
    form = shifted.T @ exact + exact @ shifted
    if not (positive_definite(exact) and positive_definite(-form)):
        raise NoCertificate("no decay of the loop could be proven for all constants of a cell")
    balls = balls_of(exact)
    return Decay(mu, balls, balls.inv())


def balls_of(matrix: np.ndarray) -> flint.arb_mat:
    """Ball matrix of rationals."""
    return flint.arb_mat(flint.fmpq_mat([[flint.fmpq(v) for v in row] for row in matrix]))


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
    if not B.shape[1]:
        return np.zeros((len(C), 0))
    with flint.ctx.workprec(PRECISION):
        return _integrals(M, balls_of(M), balls_of(C), balls_of(B))


def _integrals(
    exact: np.ndarray, M: flint.arb_mat, C: flint.arb_mat, B: flint.arb_mat
) -> np.ndarray:
    decay = proven_decay(exact)
    eigenvalues = np.linalg.eigvals(exact.astype(float))
    first = FIRST_CELL / float(np.abs(eigenvalues).max())
    columns, right = rounded(B), decay.right(B)
    total = np.zeros((C.nrows(), B.ncols()))
    M2 = M * M
    M3 = M2 * M
    stacks: dict[int, np.ndarray] = {}
    t = flint.fmpq(0)
    for _ in range(MAX_BLOCKS):
        level = _level(float(t), first)
        h = rational(Fraction(first)) * 2**level
        if level not in stacks:
            stacks[level] = _steps(M, h)
        F = (M * flint.arb(t)).exp()
        rows = C * F
        k = _values(rounded(rows), stacks[level], columns)
        bend = _values(rounded(rows * M2), stacks[level], columns)
        jerk = np.outer(decay.left(rows * M3), right)
        total += _block(float(h), *k, *bend, jerk)
        t += h * CELLS
        tail = np.outer(decay.left(C * (M * flint.arb(t)).exp()), right) / float(decay.mu)
        if (tail <= TAIL * total + TINY).all():
            return (total + tail * (1 + 4 * UNIT)) * (1 + 1e4 * UNIT)
    raise NoCertificate("the loop is too stiff for its peak gains to be enclosed")


def _level(t: float, first: float) -> int:
    """Doublings of the first cell width at the time t."""
    return max(0, math.floor(math.log2(max(t * LATER_CELLS / first, 1.0))))


def _steps(M: flint.arb_mat, h: Any) -> np.ndarray:
    """e^{M h j}, j = 0 ... CELLS, as floats."""
    one = (M * flint.arb(h)).exp()
    power, found = flint.arb_mat(M.nrows(), M.nrows(), [int(i == j) for i in range(M.nrows()) for j in range(M.nrows())]), []
    for _ in range(CELLS + 1):
        found.append(rounded(power))
        power = power * one
    return np.array(found)


def rounded(balls: flint.arb_mat) -> np.ndarray:
    """Floats of a ball matrix, each within 2 units of roundoff of what is in the ball.

    Raises
    ------
    NoCertificate
        If a ball is too wide for that.
    """
    found = np.empty((balls.nrows(), balls.ncols()))
    flat = balls.entries()
    for i, ball in enumerate(flat):
        mid = float(ball.mid())
        if not ball.rad() <= UNIT * abs(ball.mid()) + TINY:
            raise NoCertificate("the loop is too stiff for its peak gains to be enclosed")
        found.flat[i] = mid
    return found


def _values(rows: np.ndarray, steps: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|c F E_j b| for all j, rounded up; and the values with sign. Shapes (j, rows, columns).

    Each factor is within 2 units of its exact value and each of the two products rounds n times.
    """
    n = steps.shape[1]
    value = rows @ steps @ columns
    size = np.abs(rows) @ np.abs(steps) @ np.abs(columns)
    return np.abs(value) + (4 * n + 20) * UNIT * size + TINY, value


def _block(
    h: float,
    k: np.ndarray,
    _k: np.ndarray,
    bend: np.ndarray,
    _bend: np.ndarray,
    jerk: np.ndarray,
) -> np.ndarray:
    """Integral over a block, rounded up but for the roundings of the sums."""
    curvature = np.maximum(bend[:-1], bend[1:]) + h / 2 * jerk
    cells = h * (k[:-1] + k[1:]) / 2 + h**3 / 12 * curvature
    total: np.ndarray = cells.sum(axis=0)
    return total


def _roots(square: flint.arb_mat) -> np.ndarray:
    """Roots of the diagonal, rounded up."""
    return np.array(
        [
            math.sqrt(float(square[i, i].abs_upper()) * (1 + 8 * UNIT)) * (1 + 4 * UNIT)
            for i in range(square.nrows())
        ]
    )
