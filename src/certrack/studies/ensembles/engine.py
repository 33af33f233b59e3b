"""From a range of member numbers to their statistics: what every worker does."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from certrack.core.memo import remembered
from certrack.integrators.base import MethodUnavailable, Outcome
from certrack.integrators.pairs import DOP853
from certrack.simulation.run import Run
from certrack.studies.ensembles.error_limit import is_certified
from certrack.studies.ensembles.methods.choice import create_method
from certrack.studies.ensembles.methods.native_continuous import NativeContinuous
from certrack.studies.ensembles.plan import METHODS, METRICS, Plan, signals_of
from certrack.studies.ensembles.problem import EnsembleProblem, is_clearly_after
from certrack.studies.ensembles.statistics import Bands, Statistics

#: A group with fewer steps is fast enough, stiff or not.
FEW_STEPS = 400

#: Steps of order 8 that are bound by accuracy grow with the 8th root of the tolerance. Where one
#: that is so much looser, but leaves the states two digits, needs more than this part of what that
#: says, steps may be bound by stability.
LOOSENED, LOOSEST, STILL_AS_MANY = 1e4, 1e-2, 0.8

#: An implicit step costs 0.6 to 1.4 explicit ones; it must save more.
STEPS_PER_IMPLICIT = 1.7

#: Numbers of the outcomes.
OUTCOME_CODES = {outcome: code for code, outcome in enumerate(Outcome)}


class Engine:
    """A plan whose method is compiled.

    Parameters
    ----------
    plan : Plan
    threads : int
        Cores to use.

    Raises
    ------
    MethodUnavailable
        If this machine does not have the plan's method.
    """

    def __init__(self, plan: Plan, threads: int = 1) -> None:
        self.plan = plan
        self._problem = EnsembleProblem(plan.system, plan.seed, plan.tolerance)
        self.method = create_method(plan.method, self._problem, threads)
        self._spare_bands: list[Bands] = []

    def compute(
        self,
        begin: int,
        end: int,
        total: Statistics | None = None,
        ran: Callable[[int], None] | None = None,
    ) -> Statistics:
        """Statistics of the members begin ... end-1; added to those of others, if given.

        Members that are run one by one, which may take a second each, are told to `ran`: it gets
        how many of the range are done.
        A fresh table of counts costs as much as a thousand members.
        """
        statistics = self.plan.empty() if total is None else total
        metrics, outcomes = self.metrics_and_outcomes(begin, end, statistics.bands, ran)
        statistics.members += end - begin
        for outcome, count in zip(OUTCOME_CODES, np.bincount(outcomes).tolist(), strict=False):
            if count:
                statistics.outcomes[outcome.name] += count
        for name, values in zip(METRICS, metrics, strict=True):
            statistics.metrics[name].observe(values)
        tail = metrics[METRICS.index("tail_error")]
        tail = np.where(np.isnan(tail), np.inf, tail)
        statistics.observe_worst(tail, begin)
        if statistics.table is not None:
            statistics.table.add(begin, metrics, outcomes)
        if self.plan.limit is not None:
            statistics.violations += int((tail > self.plan.limit).sum())
        return statistics

    def packed(
        self, begin: int, end: int, ran: Callable[[int], None] | None = None
    ) -> dict[str, np.ndarray]:
        """Statistics of a chunk by itself, for a file or a network.

        They are counted in a table of an earlier chunk, if no other thread has it.
        """
        try:
            bands: Bands | None = self._spare_bands.pop()  # not asked first: threads take turns
        except IndexError:
            bands = None
        statistics = self.compute(begin, end, self.plan.empty(bands), ran)
        arrays = statistics.packed()
        statistics.bands.clear(np.cumsum(arrays["bins"], dtype=np.int64))
        self._spare_bands.append(statistics.bands)
        return arrays

    def metrics_and_outcomes(
        self,
        begin: int,
        end: int,
        bands: Bands,
        ran: Callable[[int], None] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute members and count their signals in the bands.

        Returns
        -------
        metrics : (M, N) array
            In the order of METRICS; NaN for a member that did not finish.
        outcomes : (N,) array
            By their numbers in :data:`OUTCOME_CODES`.
        """
        results = self.method.compute(begin, end, bands)
        metrics = results.metrics
        outcomes = np.full(end - begin, OUTCOME_CODES[Outcome.finished])
        early = results.ends < self._problem.end
        metrics[:, early] = np.nan
        outcomes[early & ~results.run_alone] = OUTCOME_CODES[Outcome.escaped]
        alone = np.flatnonzero(results.run_alone).tolist()
        for count, i in enumerate(alone):
            if ran is not None:
                ran(end - begin - len(alone) + count)
            run = self._problem.members.run(begin + i)
            outcomes[i] = OUTCOME_CODES[run.outcome]
            if run.outcome is Outcome.finished:
                metrics[:, i] = [getattr(run.metrics, name) for name in METRICS]
            self._count_single_run(run, float(results.ends[i]), bands)
        return metrics, outcomes

    def _count_single_run(self, run: Run, after: float, bands: Bands) -> None:
        """Count a run of its own at the times where the method did not."""
        late = np.flatnonzero(is_clearly_after(self._problem.times, after))
        signals = signals_of(run, self._problem.times[late])
        for signal, values in enumerate(signals):
            for k, value in zip(late.tolist(), values, strict=True):
                bands.observe(signal, k, np.array([value]))


def fastest(plan: Plan, threads: int) -> Engine:
    """The plan by the first method that this machine has, whatever the plan's is.

    Implicit steps take the place of explicit ones where the loop is stiff (:func:`is_stiff`).
    """
    for name in METHODS:
        if name == "implicit":
            continue
        chosen = replace(plan, method=name)
        try:
            if name == "native" and is_stiff(chosen, chosen.registered):
                chosen = replace(plan, method="implicit")
            return Engine(chosen, threads)
        except MethodUnavailable:
            continue
    raise AssertionError("members can always be run alone")


@remembered
def is_stiff(plan: Plan, _registered: tuple[object, ...]) -> bool:
    """Whether implicit steps are so much fewer than explicit ones that they cost less, and safe.

    Long steps damp what is fast, and might damp what runs away as well: a certificate must cover
    all members. They also pass over short events whose times are drawn, which short ones may not;
    those at fixed times are known.

    What counts are the steps that the first group of members takes. Where the explicit steps are
    bound by accuracy, fewer do at a looser tolerance, and nothing else has to be compiled.
    """
    population = plan.system.varied
    if plan.system.implementation is not None or population.constants or population.frequency:
        return False
    explicit = Engine(plan).method
    assert isinstance(explicit, NativeContinuous)
    steps, given_up = explicit.first_group(plan.tolerance)
    if steps < FEW_STEPS:
        return False
    loose = max(min(LOOSENED * plan.tolerance, LOOSEST), plan.tolerance)
    loose_steps, _ = explicit.first_group(loose)
    if steps * STILL_AS_MANY > loose_steps * (loose / plan.tolerance) ** (1 / DOP853.order):
        return False
    try:
        implicit = Engine(replace(plan, method="implicit")).method
    except MethodUnavailable:
        return False
    assert isinstance(implicit, NativeContinuous)
    fewer, lost = implicit.first_group(plan.tolerance)
    worth = lost <= given_up and STEPS_PER_IMPLICIT * fewer < steps
    return worth and is_certified(plan.system)


@remembered
def _engine_of(plan: Plan, _registered: tuple[object, ...]) -> Engine:
    """The compiled plan of a worker process."""
    return Engine(plan)


def compute_chunk(plan: Plan, begin: int, end: int) -> tuple[dict[str, np.ndarray], float]:
    """What a worker process runs: packed statistics, and the seconds without compilation."""
    engine = _engine_of(plan, plan.registered)
    clock = time.perf_counter()
    return engine.packed(begin, end), time.perf_counter() - clock
