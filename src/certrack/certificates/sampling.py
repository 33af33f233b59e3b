"""Points at which formulas of t and the states are tried, and the nearest point that fails.

Random states of all magnitudes and directions, states on an axis, and the origin. What fails is
shown at the smallest ||x|| found: a witness that a reader can put into the formula.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

#: Random points per formula; they take about 0.05 s, and a fault on a thousandth of them is missed
#: with a probability of 1e-17.
RANDOM_POINTS = 40_000

#: Powers of ten between which the random states lie; part of them that lies on an axis, where a
#: term of one state is largest against the norm; part of the times at 0, where a transient starts.
RANDOM_MAGNITUDES, AXIS_SHARE, START_SHARE = (-3, 4), 0.3, 0.05

#: Part of the points with no state but zero, each at a time of its own.
ORIGIN_SHARE = 0.01

#: Points tried on the ray to one that fails, from the smallest random state on (and zero itself);
#: and bisections after that.
RAY_POINTS, RAY_BISECTIONS = 400, 40

#: Part of the times beyond the run, and how many times its length they reach: a certificate is of
#: all t >= 0.
LATE_SHARE, LATEST = 0.05, 1e4


@dataclass(frozen=True)
class Points:
    """Times (N,) and states (n, N)."""

    t: np.ndarray
    x: np.ndarray

    @property
    def norm(self) -> np.ndarray:
        """||x|| of every point."""
        sizes: np.ndarray = np.linalg.norm(self.x, axis=0)
        return sizes

    def __getitem__(self, i: int | np.ndarray) -> Points:
        """Some of the points."""
        chosen = np.atleast_1d(i)
        return Points(self.t[chosen], self.x[:, chosen])


@lru_cache(maxsize=2)
def random_points(n: int, duration: float, seed: int) -> Points:
    """Times of the run, and states of all magnitudes, in random directions and along the axes.

    Parameters
    ----------
    n : int
        Number of states.
    duration : float, s
    seed : int
    """
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, RANDOM_POINTS))
    axes = rng.random(RANDOM_POINTS) < AXIS_SHARE
    x[:, axes] *= np.arange(n)[:, None] == rng.integers(0, n, RANDOM_POINTS)[axes]
    x *= 10.0 ** rng.uniform(*RANDOM_MAGNITUDES, RANDOM_POINTS) / np.linalg.norm(x, axis=0)
    t = rng.uniform(0, duration, RANDOM_POINTS)
    start, late = int(START_SHARE * RANDOM_POINTS), int(LATE_SHARE * RANDOM_POINTS)
    t[:start] = 0.0
    t[start : start + late] = duration * np.geomspace(1.0, LATEST, late)
    x[:, :: int(1 / ORIGIN_SHARE)] = 0.0
    t.flags.writeable = x.flags.writeable = False  # the next one with this seed gets the same
    return Points(t, x)


def nearest_failure(points: Points, fails: Callable[[Points], np.ndarray]) -> Points | None:
    """The point of the smallest ||x|| that fails, of those given and of the ray to the smallest.

    Parameters
    ----------
    points : Points
    fails : callable
        Which of some points fail, as booleans.

    Returns
    -------
    Points or None
        One point; None if none of those given fails.
    """
    bad = np.flatnonzero(fails(points))
    if not len(bad):
        return None
    first = points[int(bad[np.argmin(points.norm[bad])])]
    nearest = 10.0 ** RANDOM_MAGNITUDES[0] / max(float(first.norm[0]), 10.0 ** RANDOM_MAGNITUDES[0])
    scales = np.concatenate([[0.0], np.geomspace(nearest, 1.0, RAY_POINTS)])
    failing = np.flatnonzero(fails(_scaled(first, scales)))
    if not len(failing):
        return first
    i = int(failing[0])
    if i < 2:  # zero, or the smallest that is tried
        return _scaled(first, scales[i : i + 1])
    low, high = scales[i - 1], scales[i]
    for _ in range(RAY_BISECTIONS):
        middle = (low + high) / 2
        if fails(_scaled(first, np.array([middle])))[0]:
            high = middle
        else:
            low = middle
    return _scaled(first, np.array([high]))


def _scaled(point: Points, scales: np.ndarray) -> Points:
    return Points(np.repeat(point.t, len(scales)), point.x * scales)
