"""The one search of a comparison: differential evolution over logarithms of gains, and a polish."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution, minimize

from certrack.core.errors import CertrackError
from certrack.laws.base import Law
from certrack.tuning.comparison.trials import LOST_SCORE, Score, SharedLimits, Trials, score
from certrack.tuning.families import PositiveGains

#: The first gains are those of loops so many times as fast as that of the start, and about them,
#: with this standard deviation in logarithms.
SLOWEST_FIRST, FASTEST_FIRST, FIRST_SPREAD = 1 / 3, 10.0, 1.0

#: Sets of gains in a population, over the number of gains; numbers of differential evolution.
POPULATION_PER_GAIN, GAIN_DIFFERENCE_SCALE, GAIN_CROSSOVER = 4, (0.4, 0.9), 0.8

#: The part of the evaluations that polish the best.
POLISH_PART = 0.3

#: Edges of the first simplex, in logarithms of gains.
SIMPLEX_EDGE = 0.3


@dataclass(frozen=True)
class FoundGains:
    """The best of a search.

    Attributes
    ----------
    law : Law
    score : Score
    evaluations : int
    """

    law: Law
    score: Score
    evaluations: int


class _Best:
    """Scores of points, and the best of them."""

    def __init__(
        self, trials: Trials, family: PositiveGains, limits: SharedLimits, resting: float
    ) -> None:
        self._trials, self._family, self._limits = trials, family, limits
        self._resting = resting
        self.evaluations = 0
        self.law: Law = family.written(family.start)
        self.score = Score(np.inf, (), works=False)
        self.v = family.start

    def __call__(self, v: np.ndarray) -> float:
        self.evaluations += 1
        try:
            law = self._family.written(np.clip(v, self._family.low, self._family.high))
        except CertrackError:
            return LOST_SCORE
        result = score(self._trials, law, self._limits, self._resting)
        if result.value < self.score.value:
            self.law, self.score, self.v = law, result, v
        return result.value


def search_gains(
    trials: Trials,
    family: PositiveGains,
    limits: SharedLimits,
    resting: float,
    budget: int,
    seed: int,
) -> FoundGains:
    """Gains with the smallest tail error within the limits, by about `budget` evaluations.

    Every law gets the same: a population of loops slower and faster than its own start, evolved,
    and a simplex from the best.
    """
    best = _Best(trials, family, limits, resting)
    rng = np.random.default_rng(seed)
    count = len(family.start)
    size = max(6, min(POPULATION_PER_GAIN * count, budget // 3))
    speeds = np.exp(rng.uniform(np.log(SLOWEST_FIRST), np.log(FASTEST_FIRST), size))
    first = np.array([family.at_speed(factor) for factor in speeds])
    first += FIRST_SPREAD * rng.standard_normal((size, count))
    first[0] = family.start
    evolved = max(1, round((1 - POLISH_PART) * budget / size) - 1)
    differential_evolution(
        best,
        list(zip(family.low, family.high, strict=True)),
        init=np.clip(first, family.low, family.high),
        maxiter=evolved,
        polish=False,
        rng=rng,
        tol=0.0,
        atol=0.0,
        mutation=GAIN_DIFFERENCE_SCALE,
        recombination=GAIN_CROSSOVER,
    )
    if best.score.value < LOST_SCORE:
        minimize(
            best,
            best.v,
            method="Nelder-Mead",
            options={
                "maxfev": max(count + 2, round(POLISH_PART * budget)),
                "xatol": 1e-3,
                "initial_simplex": best.v + SIMPLEX_EDGE * np.eye(count + 1, count, -1),
            },
        )
    return FoundGains(best.law, best.score, best.evaluations)
