"""The falsifier: hunt for the worst that the assumptions admit, to see how tight a certificate is.

A population of adversaries is evolved on the batched integrator to maximise |e_1| after the
transient; the best case is polished alone, written as a system file and replayed there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution, minimize

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.integrators.single.taylor import available
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.loop import AdversarialLoop
from certrack.systems.system import System

#: Adversaries in a population: at least and at most.
MIN_POPULATION, MAX_POPULATION = 32, 96

#: Runs of a search that is asked for by mistake would take years.
MAX_BUDGET = 10**9


@dataclass(frozen=True)
class Falsification:
    """The worst case found.

    Attributes
    ----------
    worst_error : float
        Largest |e_1| after the transient, replayed by the ordinary simulation; inf if it escapes.
    system : System
        Replays it.
    evaluations : int
        Runs spent.
    """

    worst_error: float
    system: System
    evaluations: int


def falsify(
    system: System,
    *,
    budget: int = 6000,
    seed: int = 0,
    progress: Callable[[int, float], None] = lambda _n, _worst: None,
) -> Falsification:
    """Search the worst admissible case of `system`.

    Parameters
    ----------
    system : System
        Its law, ranges and uncertainty; the search replaces disturbance, reference and start. The
        loop is the continuous one, which certificates are of; an implementation is left out.
    budget : int
        Number of runs.
    seed : int
        Of the population.
    progress : callable
        Gets the runs so far and the worst error so far.

    Raises
    ------
    InputError
        If heyoka is missing, a bound of the reference cannot be proven, or the truth has states
        of its own.
    """
    checks.integer("budget", budget, 1, MAX_BUDGET)
    checks.integer("seed", seed, 0, 2**63 - 1)
    if system.truth.states:
        raise InputError(
            "truth.states",
            "falsify searches disturbances of the design's plant, not of one with own states",
            remedy="Give the truth in the design's form, or vary it by certrack ensemble",
        )
    if not available():
        raise InputError(
            "falsify", "needs heyoka, which is not installed", remedy="conda-forge has it"
        )
    search = _Search(AdversarialLoop(system.replace(implementation=None)), progress)
    evolved = search.evolve(budget, seed)
    candidates = (evolved, search.polish(evolved, budget))
    best = min(candidates, key=lambda genes: float(search.scores(genes[:, None])[0]))
    case = search.loop.case(best)
    return Falsification(_replayed_error(case), case, search.evaluations)


class _Search:
    """Maximise the error over an adversary's genes; counts the runs and reports them."""

    def __init__(self, loop: AdversarialLoop, progress: Callable[[int, float], None]) -> None:
        self.loop, self._progress, self.evaluations = loop, progress, 0
        self._bounds = [(gene.low, gene.high) for gene in loop.adversary.genes]
        self._low, self._high = np.array(self._bounds).T

    def scores(self, points: np.ndarray) -> np.ndarray:
        """Errors with a minus, of the genes (G, N)."""
        genes = points.reshape(len(self._bounds), -1)
        self.evaluations += genes.shape[1]
        errors = self.loop.errors(genes)
        self._progress(self.evaluations, float(errors.max()))
        return -errors

    def evolve(self, budget: int, seed: int) -> np.ndarray:
        """The best genes of a population, by differential evolution."""
        count = len(self._bounds)
        size = max(MIN_POPULATION, min(MAX_POPULATION, 8 * (count // 2)))
        rng = np.random.default_rng(seed)
        start = rng.uniform(self._low, self._high, (size, count))
        plausible = self.loop.adversary.plausible_starts()
        start[: len(plausible)] = plausible
        genes: np.ndarray = differential_evolution(
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
            mutation=(0.4, 0.9),
            recombination=0.8,
        ).x
        return genes

    def polish(self, genes: np.ndarray, budget: int) -> np.ndarray:
        """The genes after a search around them, by Nelder and Mead's simplex."""
        polished = minimize(
            lambda p: float(self.scores(self._clipped(p)[:, None])[0]),
            genes,
            method="Nelder-Mead",
            options={"maxfev": max(50, budget // 20), "xatol": 1e-6, "fatol": 1e-9},
        )
        return self._clipped(polished.x)

    def _clipped(self, genes: np.ndarray) -> np.ndarray:
        return np.clip(genes, self._low, self._high)


def _replayed_error(case: System) -> float:
    """Tail error of the ordinary simulation; inf if it escapes, 0 if it ends before the tail."""
    replayed = simulate(case)
    if replayed.outcome is Outcome.escaped:
        return math.inf
    error = float(replayed.metrics.tail_error)
    return 0.0 if math.isnan(error) else error
