"""Jitter: how far samples, and the inputs that follow from them, are from their times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from certrack.model.implementation import Implementation

#: Largest jitter, periods: samples and inputs keep their order.
MAX_JITTER = 0.5

#: How the shifts of a run go: random within the jitter, from one end to the other and back, or all
#: of them late.
RANDOM, ALTERNATING, ALL_LATE = "random", "alternating", "late"
JITTER_PATTERNS = (RANDOM, ALTERNATING, ALL_LATE)

#: By this part of them the shifts of a run stay below half a period: two samples of the same time
#: would be one event, and so one sample.
APART = 1e-7

#: Apart from the seeds of the noise.
_STREAM = 0x6A69747465


def timing_shifts(implementation: Implementation, count: int) -> np.ndarray:
    """Shifts of `count` samples and of their inputs, periods; the same for all members.

    Returns
    -------
    (2, count) array
        None larger than the jitter.
    """
    size = min(implementation.jitter, MAX_JITTER * (1 - APART))
    if not size:
        return np.zeros((2, count))
    if implementation.jitter_pattern == ALL_LATE:
        return np.full((2, count), size)
    if implementation.jitter_pattern == ALTERNATING:
        turns = np.where(np.arange(count) % 2, -1.0, 1.0)
        return size * np.array([turns, -turns])  # the input comes late where its sample is early
    seeds = [implementation.seed, _STREAM]
    return size * np.random.default_rng(seeds).uniform(-1.0, 1.0, (2, count))
