"""Nothing feasible: which limit conflicts with the others, and what is the best achievable."""

from __future__ import annotations

from dataclasses import replace

from certrack.core.errors import InputError
from certrack.tuning.families import Family
from certrack.tuning.limits import Limit
from certrack.tuning.problem import TuningProblem
from certrack.tuning.quantities import NO_VALUE, Largest, log_of
from certrack.tuning.search import GainSearch


def conflict(problem: TuningProblem, family: Family, search: GainSearch) -> InputError:
    """The refusal: the limit that cannot be kept, and how far it can."""
    nearest = search.state.nearest
    limits = problem.task.limits
    if nearest is None:
        what = "a certificate" if problem.objective is problem.error else problem.objective.name
        return InputError("tune", f"no design near the system's own gains has {what}")
    exceeded = [limit for limit in limits if limit.excess(nearest) > 0]
    if not exceeded:
        return InputError(
            "tune",
            "no design was found that keeps all limits and works when it is held at "
            f"{problem.held_period:.4g} s and at shorter periods (without a limit of the period "
            "three times implementation.period, or 3 ms)",
            remedy="Shorten implementation.period, limit the period or the noise lower, or leave a "
            "resonance for which the drive is too slow out of the model",
        )
    options = [limit for limit in limits if limit.option] or exceeded
    best = None
    for limit in sorted(options, key=lambda entry: -entry.excess(nearest)):
        value = _best_achievable(problem, family, limit)
        if value is not None:
            best = limit, value
            break
    if best is None:
        worst = max(exceeded, key=lambda entry: entry.excess(nearest))
        return InputError(
            _key(worst),
            f"no design was found that keeps {', '.join(limit.describe() for limit in limits)} "
            f"together; nearest comes one with {worst.name} "
            f"{worst.quantity.value(nearest):.4g}",
            remedy="Ease two of these limits",
        )
    limit, value = best
    others = [entry.describe() for entry in limits if entry.name != limit.name]
    return InputError(
        _key(limit),
        f"{limit.describe()} conflicts with {', '.join(dict.fromkeys(others))}: with these the "
        f"best {limit.name} found is {value:.4g}",
        remedy="Ease one of them, or try a higher law.feedforward",
    )


def _best_achievable(problem: TuningProblem, family: Family, limit: Limit) -> float | None:
    """The best of a limited quantity within the other limits; None if these conflict, too."""
    others = tuple(entry for entry in problem.task.limits if entry.name != limit.name)
    named = [entry.quantity for entry in problem.task.limits if entry.name == limit.name]
    quantity = named[0] if len(named) == 1 else Largest(named)  # corners of a box have one each
    task = replace(
        problem.task,
        objective=quantity,
        smallest=not limit.at_least,
        limits=others,
        accepts=lambda candidate: log_of(problem.error, candidate) < NO_VALUE,
    )
    search = GainSearch(problem.base, task)
    search.run(family, family.start)
    best = search.state.best
    return None if best is None else quantity.value(best)


def _key(limit: Limit) -> str:
    return limit.option.removeprefix("--").replace("-", "_") or limit.name.replace(" ", "_")
