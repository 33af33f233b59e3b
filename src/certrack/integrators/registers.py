"""How many members fill a vector register."""

from __future__ import annotations

import numpy as np

#: Members per register of 512 bits; ``vector_math.h`` has the same number. Compiled maps get a
#: multiple of it, because heyoka evaluates a remainder by scalar functions, whose last bits differ.
LANES = 8

#: Members that share their steps in ``native.c``: several registers, so that the work on one hides
#: the latency of another.
GROUP_SIZE = 4 * LANES


def whole_registers(count: int) -> np.ndarray:
    """The numbers 0 ... count - 1, the last one repeated until they fill whole registers."""
    return np.minimum(np.arange(-(-count // LANES) * LANES), count - 1)
