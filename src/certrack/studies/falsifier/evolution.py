"""The search of the falsifier: a population of adversaries, evolved, and a polish of its best."""

from __future__ import annotations

import numpy as np
from scipy.optimize import differential_evolution, minimize

from certrack.core.progress import Progress
from certrack.integrators.registers import LANES
from certrack.studies.falsifier.loop import AdversarialLoop

#: Adversaries in a population: at least and at most. In between about four per searched number, a
#: multiple of what the integrator runs side by side.
MIN_POPULATION, MAX_POPULATION = 32, 96

#: Numbers of differential evolution, within the usual ranges: a difference is scaled by a random
#: factor of this interval and added, and a candidate takes this share of its numbers from the sum.
DIFFERENCE_SCALE, CROSSOVER = (0.4, 0.9), 0.8

#: Runs of the polish at least, and runs of the evolution for each of them.
MIN_POLISH_RUNS, RUNS_PER_POLISH_RUN = 50, 20

#: The polish ends where numbers and error move less than this.
POLISHED_POINT, POLISHED_ERROR = 1e-6, 1e-9


class Search:
    """Maximise the error over an adversary's numbers; counts the runs and reports them."""

    def __init__(self, loop: AdversarialLoop, budget: int, progress: Progress) -> None:
        self.loop, self._progress, self.evaluations = loop, progress, 0
        self._budget, self._worst = budget, 0.0
        self._bounds = [(v.low, v.high) for v in loop.adversary.variables]
        self._low, self._high = np.array(self._bounds).T

    def scores(self, points: np.ndarray) -> np.ndarray:
        """Errors with a minus, of the points (G, N)."""
        points = points.reshape(len(self._bounds), -1)
        self.evaluations += points.shape[1]
        errors = self.loop.errors(points)
        self._worst = max(self._worst, float(errors.max()))
        self._progress(min(self.evaluations, self._budget), self._budget, self._worst)
        return -errors

    def evolve(self, budget: int, seed: int) -> np.ndarray:
        """The best point of a population, by differential evolution."""
        count = len(self._bounds)
        size = max(MIN_POPULATION, min(MAX_POPULATION, LANES * (count // 2)))
        rng = np.random.default_rng(seed)
        start = rng.uniform(self._low, self._high, (size, count))
        plausible = self.loop.adversary.plausible_starts()
        start[: len(plausible)] = plausible
        point: np.ndarray = differential_evolution(
            self.scores,
            self._bounds,
            vectorized=True,
            updating="deferred",
            init=start,
            maxiter=max(1, budget // size - 1),
            polish=False,
            rng=rng,
            tol=0.0,
            atol=0.0,
            mutation=DIFFERENCE_SCALE,
            recombination=CROSSOVER,
        ).x
        return point

    def polish(self, point: np.ndarray, budget: int) -> np.ndarray:
        """The point after a search around it, by Nelder and Mead's simplex."""
        polished = minimize(
            lambda p: float(self.scores(self._clipped(p)[:, None])[0]),
            point,
            method="Nelder-Mead",
            options={
                "maxfev": max(MIN_POLISH_RUNS, budget // RUNS_PER_POLISH_RUN),
                "xatol": POLISHED_POINT,
                "fatol": POLISHED_ERROR,
            },
        )
        return self._clipped(polished.x)

    def _clipped(self, point: np.ndarray) -> np.ndarray:
        return np.clip(point, self._low, self._high)
