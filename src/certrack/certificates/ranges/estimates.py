"""Peak gains in floats, for a search: near what :mod:`kernels` proves, in a tenth of its time."""

from __future__ import annotations

import math

import numpy as np

from certrack.certificates.certificate import OUT_OF_RANGE, NoCertificate
from certrack.certificates.ranges.kernels import CELLS, FIRST_CELL, NOT_STABLE

#: Slowest time constants after which a kernel is over.
HORIZON = 20.0

#: Widest cell over the period of the fastest oscillation, in radians; and the most blocks of cells.
WIDEST_CELL, MOST_BLOCKS = 0.5, 400

#: Terms of the series of the first step's exponential.
SERIES_TERMS = 16


def estimated_peak_gains(M: np.ndarray, C: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The integrals of |c e^{Mt} b| over t >= 0, by the trapezoidal rule: no bounds.

    Parameters
    ----------
    M, C, B : (n, n), (rows, n), (n, columns) arrays of rationals

    Returns
    -------
    (rows, columns) array of floats

    Raises
    ------
    NoCertificate
        If the loop is not stable.
    """
    moved, rows, columns = (part.astype(float) for part in (M, C, B))
    if not all(np.isfinite(part).all() for part in (moved, rows, columns)):
        raise NoCertificate(OUT_OF_RANGE)
    values = np.linalg.eigvals(moved)
    slowest = -float(values.real.max())
    if not slowest > 0:
        raise NoCertificate(NOT_STABLE)
    h = FIRST_CELL / float(np.abs(values).max())
    turning = float(np.abs(values.imag).max())
    widest = WIDEST_CELL / turning if turning else math.inf
    total = np.zeros((len(rows), columns.shape[1]))
    step, t = _exponential(moved * h), 0.0
    powers = _powers(step)
    for _ in range(MOST_BLOCKS):
        sizes = np.abs(rows @ powers @ columns)
        total += h * (sizes.sum(axis=0) - (sizes[0] + sizes[-1]) / 2)
        rows, t = rows @ powers[-1], t + h * CELLS
        if t * slowest > HORIZON:
            break
        if 2 * h <= widest:
            h, step = 2 * h, step @ step
            powers = _powers(step)
    return total


def _exponential(small: np.ndarray) -> np.ndarray:
    """e to a matrix whose eigenvalues are below FIRST_CELL, by its series."""
    total = term = np.eye(len(small))
    for k in range(1, SERIES_TERMS):
        term = term @ small / k
        total = total + term
    return total


def _powers(step: np.ndarray) -> np.ndarray:
    """The powers 0 ... CELLS of a matrix."""
    powers = np.eye(len(step))[None]
    while len(powers) <= CELLS:
        step_after = powers[-1] @ step
        powers = np.concatenate([powers, powers @ step_after])
    return powers[: CELLS + 1]
