"""The most that what comes now and then may add: at times that are so many periods apart.

Two times that are m periods apart or more lie in periods whose numbers differ by m or more, so that
the largest value of each period is enough. No fixed windows are as good, nor does their sum always
fall where the times are farther apart.
"""

from __future__ import annotations

import numpy as np


def largest_apart(values: np.ndarray, apart: int) -> np.ndarray:
    """Of each row the largest sum of entries >= 0 of which any two are `apart` places apart.

    The sum that ends at a place or before is that of the place before, or the place's entry and
    the sum `apart` places before: so many places at once.
    """
    if apart == 1:
        total: np.ndarray = values.sum(axis=1)
        return total
    last = np.zeros((len(values), 1))
    before = np.zeros((len(values), apart))
    for start in range(0, values.shape[1], apart):
        part = values[:, start : start + apart]
        sums = np.concatenate([last, part + before[:, : part.shape[1]]], axis=1)
        before = np.maximum.accumulate(sums, axis=1)[:, 1:]
        last = before[:, -1:]
    return last[:, 0]
