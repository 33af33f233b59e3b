"""The ascent of the falsifier: from waves and from runs found before to a case that is replayed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from certrack.core.errors import InputError
from certrack.core.progress import Progress
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.ascent.case import MEANS, SIGNS, written
from certrack.studies.falsifier.ascent.climb import Climb, climb
from certrack.studies.falsifier.ascent.loop import ControlledLoop
from certrack.studies.falsifier.ascent.seeds import joined, of_run, waves
from certrack.studies.falsifier.linear.search import LinearCase, NothingTried, tail_error
from certrack.systems.system import System

#: Members to begin with, and turns for each number of them: at most, and runs of the search for
#: each turn.
MEMBERS, MOST_TURNS, RUNS_PER_TURN = 16, 16, 300

#: Where a run has less than this part of the error that the steps promise, they are made finer, at
#: most so many times.
HONEST, MOST_FINER = 0.97, 2

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
    """

    case: LinearCase
    runs: int


def ascend(
    system: System,
    bounds: tuple[float, ...],
    found: Sequence[tuple[System, Run]],
    budget: int,
    seed: int,
    progress: Progress,
) -> Ascent:
    """Begin with waves and with the inputs of runs, and make them worse.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_{q+1}
    found : pairs of systems and runs
        Of the plant, the law and the bounds of `system`.
    budget : int
        Runs of the whole search: the more, the more turns.
    seed : int
    progress : callable

    Raises
    ------
    NothingTried
        Where the reference has no bounds, or nothing is found.
    """
    if not np.isfinite(bounds).all() or min(bounds) <= 0:
        raise NothingTried("a derivative of the reference has no bound, or stands still")
    spent, finer, best = 0, 1, None
    while True:
        loop = ControlledLoop(system, bounds, finer)
        top = _climbed(loop, found, budget, seed, progress)
        spent += top.runs
        cases = list(_cases(loop, top))
        best = max([*cases, *([best] if best else [])], key=lambda entry: entry.error, default=None)
        honest = any(entry.error >= HONEST * entry.estimate for entry in cases)
        if honest or finer == MOST_FINER:
            break
        finer *= 2
    if best is None:
        raise NothingTried("the case found cannot be written as a system")
    return Ascent(best, spent)


def _climbed(
    loop: ControlledLoop,
    found: Sequence[tuple[System, Run]],
    budget: int,
    seed: int,
    progress: Progress,
) -> Climb:
    """The last members."""
    rng = np.random.default_rng(seed)
    seeds = [of_run(loop, *pair) for pair in found]
    others = max(4, MEMBERS - len(seeds))
    members = joined([*(inputs for inputs, _ in seeds), waves(loop, others, rng)])
    senses = [sense for _, sense in seeds] + [1.0 if i % 2 else -1.0 for i in range(others)]
    turns = min(MOST_TURNS, max(1, budget // RUNS_PER_TURN))

    def tell(c: Climb) -> None:
        progress(budget, budget, max(0.0, float(c.errors.max())))

    with np.errstate(all="ignore"):
        return climb(loop, members, np.array(senses), turns, tell)


def _cases(loop: ControlledLoop, top: Climb) -> Iterator[LinearCase]:
    """What the best members are as systems, run."""
    good = np.flatnonzero(top.errors >= (1 - NEAR_BEST) * top.errors.max())
    for i in good.tolist():
        inputs, slopes = top.inputs.some(np.array([i])), top.slopes.some(np.array([i]))
        for form in (SIGNS, MEANS):
            try:
                case = written(loop, inputs, slopes, form)
                run = simulate(case)
            except InputError:
                continue
            yield LinearCase(float(top.errors[i]), case, run, tail_error(run))
