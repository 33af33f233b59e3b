"""The front: the best objective against one of the limits, each point from the one before."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from certrack.core.errors import Cancelled, InputError
from certrack.core.progress import Progress
from certrack.tuning.candidate import Candidate
from certrack.tuning.families import Family
from certrack.tuning.limits import Limit
from certrack.tuning.problem import TuningProblem
from certrack.tuning.result import Front, FrontPoint
from certrack.tuning.search import GainSearch

#: Points of a front, and how far it goes to either side of the limit.
FRONT_POINTS, FRONT_REACH = 9, 4.0


def sweep(
    problem: TuningProblem, family: Family, best: Candidate, name: str, progress: Progress
) -> Front:
    """The front over the limit of this name, as an option spells it."""
    limits = problem.task.limits
    swept = limits_named(name, limits)
    wanted = swept[0].name
    middle = swept[0].value
    if not swept[0].option:  # one that is always in force, and mostly far away
        middle = swept[0].quantity.value(best)
    steps = FRONT_REACH ** (np.arange(1, FRONT_POINTS // 2 + 1) / (FRONT_POINTS // 2))
    others = tuple(limit for limit in limits if limit.name != wanted)
    points: dict[float, float | None] = {}
    last: float | None = None
    with suppress(KeyboardInterrupt, Cancelled):
        for branch in ((middle, *(middle * steps)), tuple(middle / steps)):
            start = best.v
            for value in map(float, branch):
                progress(len(points), FRONT_POINTS, last)
                moved = tuple(replace(limit, value=value) for limit in swept)
                task = replace(problem.task, limits=(*others, *moved), accepts=_always_kept)
                search = GainSearch(problem.base, task)
                search.run(family, start)
                best_here = search.state.best
                last = None if best_here is None else problem.objective.value(best_here)
                points[value] = last
                if best_here is None:  # nor will anything beyond
                    break
                start = best_here.v
    ordered = tuple(FrontPoint(value, points[value]) for value in sorted(points))
    return Front(wanted, problem.objective.name, ordered)


def limits_named(name: str, limits: Sequence[Limit]) -> list[Limit]:
    """The limits of a name as an option spells it: one, or one for each corner of the box.

    Raises
    ------
    InputError
        If there is none.
    """
    wanted = name.replace("-", " ").replace("_", " ")
    named = [limit for limit in limits if limit.name == wanted]
    if not named:
        known = ", ".join(dict.fromkeys(limit.name.replace(" ", "-") for limit in limits))
        raise InputError("front", f"must be one of the limits in force: {known}", name)
    return named


def _always_kept(_: object) -> bool:
    return True
