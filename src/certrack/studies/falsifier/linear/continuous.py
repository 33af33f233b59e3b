"""The continuous loop at constant parameters, as a chain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import expm

from certrack.certificates.ranges.loop import RangedLoop
from certrack.studies.falsifier.linear.chain import Chain, HeldStep
from certrack.studies.falsifier.linear.rows import OutputRow, error_row

#: Pieces of the reference.
REFERENCE_PIECES = 160

#: Length of the run, in time constants of the slowest mode: some, and some more for every state,
#: since modes that are alike fall later.
RUN_TIME_CONSTANTS, MORE_PER_STATE = 12.0, 2.0

#: A step over the fastest time constant; steps in a piece, at least and at most.
STEP_PART, LEAST_STEPS, MOST_STEPS = 0.05, 8, 64


def horizon_of(slowest: float, order: int) -> float:
    """Time after which what has happened is forgotten, s; `slowest` is a rate, 1/s."""
    return (RUN_TIME_CONSTANTS + MORE_PER_STATE * order) / slowest


def continuous_chain(
    loop: RangedLoop, point: Sequence[Any], bounds: Sequence[float], row: OutputRow | None = None
) -> Chain | None:
    """The chain of a robust law's loop.

    Parameters
    ----------
    loop : RangedLoop
        Bounded nonlinear terms are left out.
    point : values of its symbols
    bounds : Y_0 ... Y_{q+1}
    row : OutputRow, optional
        Of what is made large; the error if left out.

    Returns
    -------
    Chain, or None where the loop is not stable.
    """
    n, m, u = loop.n, len(bounds) - 1, loop.system.plant.uncertainty
    matrix = loop.unpacked(loop.entries.at(tuple(point)))[0].astype(float)
    values = np.linalg.eigvals(matrix[:, :n])
    slowest, fastest = -float(values.real.max()), float(np.abs(values).max())
    if not slowest > 0:
        return None
    acting = tuple(k for k in range(n) if u.tau[k] > 0 and u.acts(k))
    size, inputs = n + m, len(acting)
    A = np.zeros((size + inputs + 2, size + inputs + 2))  # then w, y_d^(m) and 1, all held
    A[:n, :size] = matrix[:, :size]
    A[:n, size + inputs] = matrix[:, n + m]
    A[:n, -1] = matrix[:, -1]
    for j, k in enumerate(acting):
        A[k, size + j] = u.tau[k]
    for i in range(m - 1):
        A[n + i, n + i + 1] = 1.0
    A[size - 1, size + inputs] = 1.0
    horizon = horizon_of(slowest, n)
    stride = min(
        MOST_STEPS, max(LEAST_STEPS, math.ceil(horizon * fastest / STEP_PART / REFERENCE_PIECES))
    )
    h = horizon / (stride * REFERENCE_PIECES)
    step = expm(A * h)[:size]
    cell = HeldStep(step[:, :size], step[:, size:-2], step[:, -2], step[:, -1])
    row = error_row(n, m) if row is None else row
    return Chain(
        uncertainty=u,
        states=loop.system.plant.states,
        acting=acting,
        jump=None,
        cells=(cell,),
        lengths=(h,),
        row=np.concatenate([row.of_x, row.of_Y[:m]]),
        start=np.vstack([resting_states(loop), np.eye(m)]),
        bounds=tuple(bounds),
        noise=np.zeros(0),
        pieces=np.array([stride] * REFERENCE_PIECES + [1] * bool(row.of_Y[m])),
        through=float(row.of_Y[m]),
        level=row.constant,
    )


def resting_states(loop: RangedLoop) -> np.ndarray:
    """x where the nominal error is zero, from y_d ... y_d^(q)."""
    x: np.ndarray = (loop.Xe @ loop.coordinates.B).astype(float)
    return x
