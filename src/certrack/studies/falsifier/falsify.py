"""The falsifier: hunt for the worst that the assumptions admit, to see how tight a certificate is.

A population of adversaries is evolved on the batched integrator to maximise |e_1| after the
transient; the best case is polished alone, written as a system file and replayed there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import differential_evolution, minimize

from certrack.certificates import Certificate
from certrack.certificates.methods import Methods, every_certificate
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.core.rounding import rounded_up
from certrack.integrators.base import Outcome
from certrack.integrators.registers import LANES
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.alarm import alarm
from certrack.studies.falsifier.loop import AdversarialLoop
from certrack.systems.system import System, require_system

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
    certificates : mapping of str to Certificate
        What the error is held against, by kind; not verified if a premise is contradicted.
    against : Certificate or None
        The tightest that is proven of the design, whether or not the file keeps the premises.
    alarm : {None, "premise", "defect"}
        Whether the worst case is beyond what `against` certifies from its start: then a premise is
        broken, or certrack is wrong.
    reason : str
        Of the alarm: which premise, or that none was found.
    own_run : bool
        Whether the worst case is the file's own run.
    """

    worst_error: float
    system: System
    evaluations: int
    certificates: Mapping[str, Certificate]
    against: Certificate | None
    alarm: str | None
    reason: str
    own_run: bool

    def __repr__(self) -> str:
        proven = "none" if self.against is None else rounded_up(self.against.bound, 4)
        alarm_text = "" if self.alarm is None else f", ALARM ({self.alarm})"
        runs = f"found in {self.evaluations} runs"
        return f"Falsification(|e_1| = {self.worst_error:.4g} {runs}, proven {proven}{alarm_text})"


def falsify(
    system: System,
    *,
    budget: int = 6000,
    seed: int = 0,
    progress: Progress = silent,
) -> Falsification:
    """Search the worst admissible case of `system`; its own run is always a candidate.

    Parameters
    ----------
    system : System
        Its law, ranges and uncertainty; the search replaces disturbance and reference. The
        loop is the continuous one, which certificates are of; an implementation is left out.
    budget : int
        Number of runs.
    seed : int
        Seed of the population.
    progress : callable
        Gets the runs so far, the budget and the worst error so far.

    Returns
    -------
    Falsification

    Raises
    ------
    InputError
        If a bound of the reference cannot be proven, the truth has states of its
        own, or a name of the plant is one of the search's own.

    Examples
    --------
    >>> import certrack
    >>> result = certrack.falsify(certrack.load("dual-motor-lean"), budget=200)
    >>> bool(result.worst_error <= certrack.certify(certrack.load("dual-motor-lean")).best.bound)
    True
    """
    require_system(system)
    checks.integer("budget", budget, 1, MAX_BUDGET)
    checks.integer("seed", seed, 0, 2**63 - 1)
    if system.truth.states:
        raise InputError(
            "truth.states",
            "falsify searches disturbances of the design's plant, not of one with own states",
            remedy="Give the truth in the design's form, or vary it by certrack ensemble",
        )
    progress(0, budget, None)
    methods = every_certificate(system)
    system = system.replace(implementation=None)
    search = _Search(AdversarialLoop(system), budget, progress)
    evolved = search.evolve(budget, seed)
    candidates = (evolved, search.polish(evolved, budget))
    best = min(candidates, key=lambda point: float(search.scores(point[:, None])[0]))
    cases = [search.loop.case(best), system]
    runs = [simulate(case) for case in cases]
    errors = list(map(_error, runs))
    worst = int(np.argmax(errors))
    against, stages = methods.best, methods.stages
    raised = None
    if against is not None:
        alarms = (
            alarm(system, case, run, against, stages) for case, run in zip(cases, runs, strict=True)
        )
        raised = next(filter(None, alarms), None)
    return Falsification(
        errors[worst],
        cases[worst],
        search.evaluations + 1,
        _of_this_file(system, methods),
        against,
        None if raised is None else raised.kind,
        "" if raised is None else raised.reason,
        own_run=worst == 1,
    )


def _of_this_file(system: System, methods: Methods) -> dict[str, Certificate]:
    """The certificates, none of them verified where the file's truth breaks a premise."""
    broken = contradicted(premises(system))
    entries = {kind: methods.certificates[kind] for kind in methods.kinds}
    return {
        kind: replace(entry, verified=entry.verified and not broken)
        for kind, entry in entries.items()
    }


class _Search:
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
        self._progress(self.evaluations, self._budget, self._worst)
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


def _error(run: Run) -> float:
    """Tail error of a run; inf if it escapes, 0 if it ends before the tail."""
    if run.outcome is Outcome.escaped:
        return math.inf
    error = float(run.metrics.tail_error)
    return 0.0 if math.isnan(error) else error
