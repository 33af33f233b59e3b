"""Signs over time as formulas of t."""

from __future__ import annotations

import numpy as np

#: Changes of sign in a formula; the least important ones are left out.
MAX_CHANGES = 60

#: A run of signs that weighs less than this part of all is left out.
LEAST_RUN_WEIGHT = 1e-6


def sign_formula(weights: np.ndarray, edges: np.ndarray) -> str:
    """The sign of piecewise constant weights as a formula of t: 1, -1, or products of sign(t - a).

    Parameters
    ----------
    weights : (K,) array
    edges : (K + 1,) array, s
        Increasing; the first and last sign hold before and after.
    """
    runs: list[list[float]] = []  # sum of the weights, begin
    for weight, begin in zip(weights.tolist(), edges.tolist(), strict=False):
        if not weight:
            continue
        if runs and (weight > 0) == (runs[-1][0] > 0):
            runs[-1][0] += weight
        else:
            runs.append([weight, begin])
    if not runs:
        return "0"
    least = LEAST_RUN_WEIGHT * sum(abs(weight) for weight, _ in runs)
    while len(runs) > 1:
        i = min(range(len(runs)), key=lambda j: abs(runs[j][0]))
        if len(runs) <= MAX_CHANGES + 1 and abs(runs[i][0]) >= least:
            break
        _without(runs, i)
    changes = [begin for _, begin in runs[1:]]
    sign = 1 if runs[-1][0] > 0 else -1  # that after all changes
    return "*".join([str(sign), *(f"sign(t - {begin!r})" for begin in changes)])


def _without(runs: list[list[float]], i: int) -> None:
    """Leave out a run; its neighbours, which have the same sign, become one."""
    gone = runs.pop(i)
    if i == 0:
        runs[0][1] = gone[1]
    elif i < len(runs):
        following = runs.pop(i)
        runs[i - 1][0] += following[0] + gone[0]
    else:
        runs[-1][0] += gone[0]
