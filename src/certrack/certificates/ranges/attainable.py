"""What a linear loop with constant parameters does at worst, by linear programming.

The reference is a piecewise polynomial of order q + 1 whose derivatives keep their bounds; where
e_1 is largest at the end of a long horizon is a linear program in its pieces. Bounded inputs act
with the sign of their kernel. The result is attained but for the grid, so it is a lower estimate of
the worst case and says how much of a bound could still be gained. It proves nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from certrack.certificates.ranges.loop import RangedLoop, error_form
from certrack.certificates.worst_profile import WorstProfile, worst_profile

#: Pieces of the reference, and the horizon in slowest time constants.
PIECES, HORIZON_TIME_CONSTANTS = 160, 12.0


@dataclass(frozen=True)
class Attained:
    """The worst admissible case of one linear loop.

    Attributes
    ----------
    error : float
        |e_1| at the end of the horizon.
    by_reference : float
        The reference's part of it.
    reference : WorstProfile
    """

    error: float
    by_reference: float
    reference: WorstProfile


def attained_at(loop: RangedLoop, point: Sequence[Any], Y: Sequence[float]) -> Attained | None:
    """What a loop does at worst with these constants, its bounded uncertain terms included.

    Parameters
    ----------
    loop : RangedLoop
        Bounded nonlinear terms are left out, and what grows with the state.
    point : values of its symbols
    Y : Y_0 ... Y_{q+1}

    Returns
    -------
    Attained, or None where the loop is unstable or the program is not solved.
    """
    u, A = loop.system.plant.uncertainty, loop.coordinates.A.astype(float)
    form = error_form(loop, loop.entries.at(tuple(point)))
    acting = [k for k in range(loop.n) if u.tau[k] * u.beta[k]]
    inputs = A[:, acting] * np.array([u.tau[k] * u.beta[k] for k in acting], dtype=float)
    M, W, offset = (part.astype(float) for part in (form.M, form.W, form.offset))
    return worst_reference(M, W, inputs, offset, Y)


def worst_reference(
    M: np.ndarray, W: np.ndarray, inputs: np.ndarray, offset: np.ndarray, Y: Sequence[float]
) -> Attained | None:
    """Largest |e_1| of e' = M e + W (y ... y^(q+1)) + inputs b + offset.

    All |b_i| <= 1 and |y^(j)| <= Y_j.

    Returns
    -------
    Attained, or None where the loop is unstable or the program is not solved.
    """
    n, width = W.shape
    q = width - 2
    values = np.linalg.eigvals(M)
    slowest = -float(values.real.max())
    if not slowest > 0:
        return None
    sizes = np.maximum(np.asarray(Y, dtype=float), 1e-300)
    horizon = HORIZON_TIME_CONSTANTS / slowest
    h = horizon / PIECES
    A = np.zeros((n + width, n + width))  # states: e, y ... y^(q), and the held y^(q+1)
    A[:n, :n], A[:n, n:] = M, W * sizes
    for i in range(q + 1):
        A[n + i, n + i + 1] = sizes[i + 1] / sizes[i]
    step = expm(A * h)
    Ad, bd = step[:-1, :-1], step[:-1, -1]
    count = q + 1 + PIECES
    S = np.zeros((n + q + 1, count))
    S[n:, : q + 1] = np.eye(q + 1)
    for k in range(PIECES):
        S = Ad @ S
        S[:, q + 1 + k] += bd
    gains = S[0] / np.concatenate([sizes[:-1], np.full(PIECES, sizes[-1])])
    worst = worst_profile(gains, sizes, np.full(PIECES, h))
    if worst is None:
        return None
    reference = worst.value
    e_o = -np.linalg.solve(M, offset)[0] if offset.any() else 0.0
    error = reference + _by_inputs(M, inputs, slowest) + abs(float(e_o))
    return Attained(error, reference, worst)


def _by_inputs(M: np.ndarray, inputs: np.ndarray, slowest: float) -> float:
    """The integral of |e_1's kernels|, from below but for the quadrature."""
    if not inputs.shape[1]:
        return 0.0
    fastest = float(np.abs(np.linalg.eigvals(M)).max())
    steps = min(20_000, int(HORIZON_TIME_CONSTANTS * 2 / slowest * fastest / 0.02) + 1)
    h = HORIZON_TIME_CONSTANTS * 2 / slowest / steps
    E, X, total = expm(M * h), inputs.copy(), 0.0
    previous = X[0]
    for _ in range(steps):
        X = E @ X
        total += float(np.abs((previous + X[0]) / 2).sum()) * h
        previous = X[0]
    return total
