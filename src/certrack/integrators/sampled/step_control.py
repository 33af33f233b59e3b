"""Which steps between two events of a sampled loop are accurate enough, how long the next is."""

from __future__ import annotations

import numpy as np

from certrack.core.arrays import Array
from certrack.integrators.sampled.maps import PAIR

#: A step's error may be this part of the tolerance, because the errors of several steps add up
#: before the first of them has died out.
ERROR_SHARE = 0.1

#: No step is shorter than this part of the time t, which is near rounding. A step that short may
#: have the whole tolerance as its error, so that it crosses a jump of the rates; where a formula
#: leaves its domain it fails, and the member is given up.
SHORTEST_STEP = 1e-15

#: A member that needs more steps for one interval is given up.
MAX_INTERVAL_STEPS = 5_000

#: A step that reaches within this part of the time of the interval's end ends there.
END_ROUNDING = 1e-15

#: The next step is SAFETY of the one whose error would be the allowed one, lest it fail at once; it
#: is no shorter than MIN_FACTOR of the last one and no longer than MAX_FACTOR of it, because an
#: error estimate says little about much longer or shorter steps. Where the one step that was to
#: cross an interval fails, FIRST_MAX_FACTOR instead: the interval needs two at least.
SAFETY, MIN_FACTOR, MAX_FACTOR, FIRST_MAX_FACTOR = 0.9, 0.1, 5.0, 0.5

#: An error that is not a number counts as this many times the allowed one: the shortest next step.
NOT_A_NUMBER = 1e9


def next_factor(error: Array, largest: float) -> Array:
    """By what the next step is longer, at most `largest`."""
    error = np.where(np.isfinite(error), error, NOT_A_NUMBER)
    with np.errstate(all="ignore"):
        factor = SAFETY * error ** (-1.0 / PAIR.order)
    return np.clip(factor, MIN_FACTOR, largest)
