"""Measurement noise: normal numbers that are a pure function of seed, member, sample and sensor."""

from __future__ import annotations

import numpy as np

#: Members whose numbers are drawn together, and samples drawn at a time.
GROUP, BLOCK = 64, 256


class Noise:
    """Standard normal numbers for some members, sample after sample.

    Parameters
    ----------
    seed : int
    first, count : int
        Members first ... first + count - 1.
    sensors : int
    """

    def __init__(self, seed: int, first: int, count: int, sensors: int) -> None:
        groups = range(first // GROUP, (first + count - 1) // GROUP + 1)
        self._generators = [
            np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, group])))
            for group in groups
        ]
        begin = first % GROUP
        self._part = slice(begin, begin + count)
        self._sensors = sensors
        self._block = np.empty((0, sensors, count))
        self._next = 0

    def draw(self) -> np.ndarray:
        """Numbers of the next sample, shape (sensors, count)."""
        if self._next == len(self._block):
            shape = (BLOCK, self._sensors, GROUP)
            drawn = [generator.standard_normal(shape) for generator in self._generators]
            self._block, self._next = np.concatenate(drawn, axis=2)[:, :, self._part], 0
        found: np.ndarray = self._block[self._next]
        self._next += 1
        return found
