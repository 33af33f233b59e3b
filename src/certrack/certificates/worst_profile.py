"""The reference that is worst for a linear functional, by linear programming.

The reference is a motion profile: y_d^(m) is constant on pieces, and the functional is linear in
y_d ... y_d^(m-1) at the start and in the pieces. It is maximised while |y_d^(i)| <= Y_i for
i = 0 ... m holds between all pieces; what passes the bounds inside of one is scaled away. The
result is admissible, and so is its negative: it is a lower estimate of the worst and no proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

#: Points within a piece at which the derivatives are looked at, to scale the reference down.
LOOKS_PER_PIECE = 8

#: The time to come to rest, over the largest Y_i/Y_{i+1}; a larger ratio is one by a bound of zero.
STOPPING_TIMES, LARGEST_RATIO = 4.0, 1e100

#: Corrections of the last pieces: the first leaves its own rounding, the second nothing to see.
REST_CORRECTIONS = 2

#: The program is given up after this time, s: it takes less than one but for absurd orders.
TIME_LIMIT = 60.0

#: A bound of zero is as good as this for the scaling.
LEAST_BOUND = 1e-300


@dataclass(frozen=True)
class WorstProfile:
    """A reference whose highest derivative is constant on pieces.

    Attributes
    ----------
    value : float
        Of the functional.
    start : (m,) array
        y_d, y_d' ... y_d^(m-1) at the beginning.
    pieces : (K,) array
        y_d^(m) on each piece.
    widths : (K,) array, s
    """

    value: float
    start: np.ndarray
    pieces: np.ndarray
    widths: np.ndarray


def worst_profile(
    gains: np.ndarray, bounds: Sequence[float] | np.ndarray, widths: np.ndarray, stopping: int = 0
) -> WorstProfile | None:
    """The profile with the largest gains @ (start, pieces).

    Parameters
    ----------
    gains : (m + K,) array
        Of y_d ... y_d^(m-1) at the start, and of y_d^(m) on each piece.
    bounds : Y_0 ... Y_m
    widths : (K,) array, s
        Of the pieces.
    stopping : int
        So many further pieces bring the reference to rest; they have no gain.

    Returns
    -------
    WorstProfile, or None where the program is not solved.
    """
    if not np.isfinite(gains).all():
        return None
    sizes = np.maximum(np.asarray(bounds, dtype=float), LEAST_BOUND)
    m, every = len(sizes) - 1, np.concatenate([widths, stopping_widths(sizes, stopping)])
    count = m + len(every)
    S, held = np.zeros((m, count)), np.zeros((1, count))
    S[:, :m] = np.eye(m)
    rows, looked_at = [], []
    for k, width in enumerate(every):
        rows.append(S)
        held[:] = 0.0
        held[0, m + k] = 1.0
        state = np.vstack([S, held])
        parts = [
            _one_step_later(sizes, width * (j + 1) / LOOKS_PER_PIECE)
            for j in range(LOOKS_PER_PIECE)
        ]
        looked_at += [part @ state for part in parts]
        S = parts[-1] @ state
    table = np.vstack([*rows, S])
    scale = np.concatenate([sizes[:-1], np.full(len(every), sizes[-1])])
    objective = np.concatenate([gains, np.zeros(len(every) - len(widths))]) * scale
    at_rest = S[1:] if stopping else None
    optimum = linprog(
        -objective / max(np.abs(objective).max(), LEAST_BOUND),
        A_ub=np.vstack([table, -table]),
        b_ub=np.ones(2 * len(table)),
        A_eq=at_rest,
        b_eq=None if at_rest is None else np.zeros(len(at_rest)),
        bounds=[(-1, 1)] * count,
        method="highs",
        options={"time_limit": TIME_LIMIT},
    )
    if optimum.status != 0:
        return None
    x = optimum.x
    if at_rest is not None and len(at_rest):  # the program ends at rest but for its tolerance
        for _ in range(REST_CORRECTIONS):
            x = x - np.linalg.lstsq(at_rest, at_rest @ x, rcond=None)[0]
    reached = max(np.abs(np.vstack(looked_at) @ x).max(initial=0.0), np.abs(x).max())
    x = x / max(1.0, float(reached))
    return WorstProfile(float(objective @ x), x[:m] * sizes[:-1], x[m:] * sizes[-1], every)


def stopping_widths(sizes: np.ndarray, count: int) -> np.ndarray:
    """Widths of pieces that suffice to come to rest."""
    if not count:
        return np.empty(0)
    return np.full(count, STOPPING_TIMES * turning_time(sizes) / count)


def turning_time(sizes: np.ndarray) -> float:
    """About the longest time from zero to its bound of a derivative, s; 1 where none is bound."""
    reached = _reached(sizes)
    ratios = [below / above for below, above in zip(reached, sizes[1:], strict=False)]
    return float(max((ratio for ratio in ratios if ratio < LARGEST_RATIO), default=1.0))


def _reached(sizes: np.ndarray) -> np.ndarray:
    """About what the derivatives reach for long: Y_i, or less where its neighbours say so.

    Landau: |y^(i)| stays below sqrt(2 Y_{i-1} Y_{i+1}) in the long run.
    """
    reached = np.array(sizes, dtype=float)
    for _ in sizes:
        inner = np.sqrt(2 * reached[:-2] * reached[2:])
        reached[1:-1] = np.minimum(reached[1:-1], inner)
    return reached


def _one_step_later(sizes: np.ndarray, width: float) -> np.ndarray:
    """(y_d ... y_d^(m-1)) a time later from (y_d ... y_d^(m)), all over their sizes."""
    m = len(sizes) - 1
    step = np.zeros((m, m + 1))
    for i in range(m):
        for j in range(i, m + 1):
            step[i, j] = width ** (j - i) / math.factorial(j - i) * (sizes[j] / sizes[i])
    return step
