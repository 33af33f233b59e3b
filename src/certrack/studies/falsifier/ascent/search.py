"""The ascent of the falsifier: from waves and from runs found before to a case that is replayed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import InputError
from certrack.core.progress import Progress
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.ascent.case import MEANS, SIGNS, written
from certrack.studies.falsifier.ascent.climb import Climb, climb
from certrack.studies.falsifier.ascent.loop import AdversaryInputs, ControlledLoop
from certrack.studies.falsifier.ascent.seeds import all_members, of_run, waves
from certrack.studies.falsifier.linear.search import LinearCase, NothingTried
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
from certrack.systems.system import System

#: Members to begin with, and turns for each number of them: at most, and runs of the search for
#: each turn.
CLIMBERS, MOST_CLIMB_TURNS, RUNS_PER_TURN = 16, 16, 300

#: Twice as many steps must not change the errors to begin with by more than this part of the
#: largest; nor may the run of what was found have less than the rest of what the steps promise.
STEP_ERROR = 0.03

#: Steps are so many times as many as usual at most.
MOST_FINER = 8

#: A member that ends within this part of the best one is written and run, too.
NEAR_BEST = 0.02


@dataclass(frozen=True)
class Ascent:
    """What an ascent found.

    Attributes
    ----------
    case : LinearCase
        The worst of what was written and run.
    runs : int
        Runs that were spent.
    last_gain : float
        By what part the last turn made the best member worse.
    """

    case: LinearCase
    runs: int
    last_gain: float


def ascend(
    system: System,
    bounds: tuple[float, ...],
    earlier: Sequence[tuple[System, Run]],
    budget: int,
    seed: int,
    progress: Progress,
    output: SoughtOutput = ERROR,
) -> Ascent:
    """Begin with waves and with the inputs of runs, and make them worse.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_{q+1}
    earlier : pairs of systems and runs
        Of the plant, the law and the bounds of `system`.
    budget : int
        Runs of the whole search: the more, the more turns.
    seed : int
    progress : callable
    output : SoughtOutput
        What is made worse.

    Raises
    ------
    NothingTried
        Where the reference has no bounds, or nothing is found.
    """
    if not np.isfinite(bounds).all() or min(bounds) <= 0:
        raise NothingTried("a derivative of the reference has no bound, or stands still")
    first = ControlledLoop(system, bounds, sought=output)
    if not first.forgets_start:
        raise NothingTried("the slowest mode, or leak of an estimate, outlasts the longest run")
    finer, members, senses = _begun(first, earlier, np.random.default_rng(seed))
    loop = first.with_steps(finer)
    turns = min(MOST_CLIMB_TURNS, max(1, budget // RUNS_PER_TURN))

    def tell(c: Climb) -> None:
        progress(budget, budget, max(0.0, float(c.errors.max())))

    with np.errstate(all="ignore"):
        top = climb(loop, members, senses, turns, tell)
        spent, cases = top.runs, list(_cases(loop, top))
        while finer < MOST_FINER and not any(map(_is_honest, cases)):
            finer *= 2
            loop = first.with_steps(finer)
            half = np.arange(min(CLIMBERS // 2, len(senses)))  # not those that lived of wrong steps
            members, senses = members.finer(2).subset(half), senses[half]
            top = climb(loop, members, senses, turns, tell)
            spent, cases = spent + top.runs, [*cases, *_cases(loop, top)]
    if not cases:
        raise NothingTried("the case found cannot be written as a system")
    return Ascent(max(cases, key=lambda entry: entry.error), spent, top.last_gain)


def _is_honest(case: LinearCase) -> bool:
    """Whether the run of a case has the error that the steps promise."""
    return case.error >= (1 - STEP_ERROR) * case.estimate


def _begun(
    loop: ControlledLoop, earlier: Sequence[tuple[System, Run]], rng: np.random.Generator
) -> tuple[int, AdversaryInputs, Array]:
    """How fine the steps must be, the members to begin with, and which side each is to make worse.

    The members are those of runs, and waves.
    """
    seeds = [of_run(loop, *pair) for pair in earlier]
    others = max(4, CLIMBERS - len(seeds))
    members = all_members([*(inputs for inputs, _ in seeds), waves(loop, others, rng)])
    senses = [sense for _, sense in seeds] + [1.0 if i % 2 else -1.0 for i in range(others)]
    finer, ends = 1, loop.errors(members)
    while finer < MOST_FINER:
        members = members.finer(2)
        closer = loop.with_steps(2 * finer).errors(members)
        off, size = np.abs(closer - ends).max(), np.abs(closer).max()
        if off <= STEP_ERROR * size:  # not so where one is no number
            return finer, members.coarser(2), np.array(senses)
        finer, ends = 2 * finer, closer
    return finer, members, np.array(senses)


def _cases(loop: ControlledLoop, top: Climb) -> Iterator[LinearCase]:
    """What the best members are as systems, run."""
    good = np.flatnonzero(top.errors >= (1 - NEAR_BEST) * top.errors.max())
    for i in good.tolist():
        inputs, slopes = top.inputs.subset(np.array([i])), top.slopes.subset(np.array([i]))
        for form in (SIGNS, MEANS):
            try:
                case = written(loop, inputs, slopes, form)
                run = simulate(case)
            except InputError:
                continue
            yield LinearCase(float(top.errors[i]), case, run, loop.sought.tail(run))
