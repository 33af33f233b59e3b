"""The search: SciPy's SLSQP on logarithms, from several starts, the best feasible point kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize, nnls

from certrack.core.progress import AT_ONCE
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.families import Family
from certrack.tuning.limits import Limit, Task
from certrack.tuning.quantities import NO_VALUE, log_of, slope_of

#: Limits are aimed at inside by this much, in logarithms, and kept within the second number: what
#: rounding the gains to the digits of a file does is smaller.
AIMED_INSIDE, KEPT_INSIDE = 1e-4, 1e-5

#: Iterations of one start, and the change of the logarithm that ends them.
MOST_ITERATIONS, ACCURACY = 28, 1e-5

#: A limit is active where less than this is left of it, in logarithms.
ACTIVE = 3e-3


@dataclass
class SearchState:
    """The best point so far, and what was spent.

    Attributes
    ----------
    best : Candidate or None
        The best that keeps all limits.
    score : float
        log of its objective, with the sign by which it is made small.
    nearest : Candidate or None
        The one that exceeds its limits least.
    excess : float
        By how much, in logarithms.
    improvements : list of Candidate
        All that were the best when they were found, the last of them still.
    stopped, hurried : bool
        Whether the user ended the search, and whether nothing more is to be computed.
    """

    best: Candidate | None = None
    score: float = math.inf
    nearest: Candidate | None = None
    excess: float = math.inf
    stopped: bool = False
    hurried: bool = False
    programs_per_start: list[int] = field(default_factory=list)
    improvements: list[Candidate] = field(default_factory=list)

    def ended_by(self, signal: BaseException) -> None:
        """Note that the user ended it, and in which way."""
        self.stopped = True
        self.hurried = self.hurried or AT_ONCE in signal.args


class GainSearch:
    """The search of one task, from many starts.

    Parameters
    ----------
    base : System
    task : Task
    on_better : callable
        Gets the state where the best improved.
    iterations : int
        Of one start, at most.
    """

    def __init__(
        self,
        base: System,
        task: Task,
        on_better: Callable[[SearchState], None] = lambda _: None,
        iterations: int = MOST_ITERATIONS,
    ) -> None:
        self._iterations = iterations
        self.base, self.task, self.state, self._on_better = base, task, SearchState(), on_better
        self._cache: dict[bytes, Candidate] = {}

    def run(self, family: Family, v: np.ndarray) -> None:
        """One start."""
        self._cache = {}

        def at(point: np.ndarray) -> Candidate:
            key = point.tobytes()
            if key not in self._cache:
                self._cache[key] = Candidate(family, self.base, point)
            return self._cache[key]

        def objective(point: np.ndarray) -> tuple[float, np.ndarray]:
            candidate = at(point)
            value, gradient = self._objective(candidate)
            self._consider(candidate, value)
            return value, gradient

        def margins(point: np.ndarray) -> np.ndarray:
            candidate = at(point)
            return np.array([-AIMED_INSIDE - limit.excess(candidate) for limit in self.task.limits])

        def slopes(point: np.ndarray) -> np.ndarray:
            candidate = at(point)
            return np.array([-limit.gradient(candidate) for limit in self.task.limits])

        constraints = {"type": "ineq", "fun": margins, "jac": slopes}
        minimize(
            objective,
            np.clip(v, family.low, family.high),
            jac=True,
            method="SLSQP",
            bounds=list(zip(family.low, family.high, strict=True)),
            constraints=constraints if self.task.limits else (),
            options={"maxiter": self._iterations, "ftol": ACCURACY},
        )

    def _objective(self, candidate: Candidate) -> tuple[float, np.ndarray]:
        sign, quantity = self.task.sign, self.task.objective
        return sign * log_of(quantity, candidate), sign * slope_of(quantity, candidate)

    def _consider(self, candidate: Candidate, value: float) -> None:
        state = self.state
        if value >= NO_VALUE:  # without a certificate, or a run that ends, it is no design
            return
        excess = max((limit.excess(candidate) for limit in self.task.limits), default=-math.inf)
        if excess < state.excess:
            state.nearest, state.excess = candidate, excess
        if excess <= -KEPT_INSIDE and value < state.score and self.task.accepts(candidate):
            state.best, state.score = candidate, value
            state.improvements.append(candidate)
            self._on_better(state)


def random_starts(family: Family, count: int, seed: int) -> list[np.ndarray]:
    """The family's own start, and random ones about it.

    Start i is a function of (seed, i) alone.
    """
    points = [family.start]
    for i in range(1, count):
        rng = np.random.default_rng([seed, i])
        points.append(family.random(rng))
    return points


@dataclass(frozen=True)
class Price:
    """What an active limit costs.

    Attributes
    ----------
    limit : Limit
    value : float
        Of the quantity.
    exponent : float
        The multiplier: log(objective) falls by this times what is eased of log(limit).
    """

    limit: Limit
    value: float
    exponent: float

    def gain(self, share: float, sign: float = 1.0) -> float:
        """The part of the objective that is gained where the limit is eased by this share."""
        eased = -math.log1p(-share) if self.limit.at_least else math.log1p(share)
        return -sign * math.expm1(-sign * self.exponent * eased)


def prices(task: Task, candidate: Candidate) -> list[Price]:
    """The active limits of a solution, with their multipliers; those of one name are one.

    At the optimum grad log f + sum_i m_i grad log g_i = 0 with m_i >= 0: m_i by least squares.
    """
    active: Sequence[Limit] = [limit for limit in task.limits if limit.excess(candidate) > -ACTIVE]
    if not active:
        return []
    slopes = np.array([limit.gradient(candidate) for limit in active])
    wanted = -task.sign * slope_of(task.objective, candidate)
    multipliers, _ = nnls(slopes.T, wanted)
    together: dict[str, Price] = {}
    for limit, m in zip(active, multipliers, strict=True):
        value, sum_of_them = limit.quantity.value(candidate), float(m)
        if (other := together.get(limit.name)) is not None:
            value = min(value, other.value) if limit.at_least else max(value, other.value)
            sum_of_them += other.exponent
        together[limit.name] = Price(limit, value, sum_of_them)
    return list(together.values())
