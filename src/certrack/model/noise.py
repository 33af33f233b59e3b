"""Measurement noise: normal numbers that are a pure function of seed, member, sample and sensor.

A member's key and a counter are hashed (SplitMix64) and turned into a normal number (Box, Muller).
There is no state, so any sample of any member can be computed alone, in any order, and by the
compiled integrator (``integrators/sampled/native.c``) as well.
"""

from __future__ import annotations

import numpy as np

#: 2^64 over the golden ratio: the step of SplitMix64's counter.
GOLDEN = np.uint64(0x9E3779B97F4A7C15)


def keys(seed: int, first: int, count: int) -> np.ndarray:
    """Keys of the members first ... first + count - 1, shape (count,), unsigned integers."""
    start = np.random.SeedSequence(seed).generate_state(1, np.uint64)
    members = np.arange(first, first + count, dtype=np.uint64)
    return _hashed(start + GOLDEN * members)


def normal(keys: np.ndarray, sample: int, sensors: int) -> np.ndarray:
    """Standard normal numbers of a sample, shape (sensors, members)."""
    counters = np.arange(sensors, dtype=np.uint64) + np.uint64(sample * sensors + 1)
    bits = _hashed(keys + GOLDEN * counters[:, None])
    high, low = bits >> np.uint64(32), bits & np.uint64(0xFFFFFFFF)
    radius = np.sqrt(-2.0 * np.log((high + 0.5) * 2.0**-32))
    numbers: np.ndarray = radius * np.cos(low * (2.0**-32 * 2.0 * np.pi))
    return numbers


def _hashed(z: np.ndarray) -> np.ndarray:
    """The output function of SplitMix64 (Steele, Lea, Flood, 2014)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
