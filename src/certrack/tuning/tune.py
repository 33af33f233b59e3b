"""Tuning: gains that make one quantity as good as limits on the others allow.

The certificate is the objective or a limit. Its gradient comes from the program that gives its
value, the rest is SciPy's SLSQP on the logarithms of the gains, from several starts. What it finds
is certified in full at the end: the search's own numbers are floats and prove nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from certrack.certificates.certificate import NoCertificate
from certrack.core import checks
from certrack.core.errors import Cancelled, InputError
from certrack.core.progress import Progress, silent
from certrack.systems.system import System, require_system
from certrack.tuning.candidate import Candidate
from certrack.tuning.conflict import conflict
from certrack.tuning.exceeded import broken_limits
from certrack.tuning.families import Family
from certrack.tuning.front import limits_named, sweep
from certrack.tuning.limits import Task
from certrack.tuning.measure import figures_of
from certrack.tuning.problem import OBJECTIVES, Requirements, TuningProblem
from certrack.tuning.registry import tuning_family
from certrack.tuning.result import ActiveLimit, Front, Tuned
from certrack.tuning.search import GainSearch, prices, random_starts

#: Starts of a search that is asked for by mistake would take days.
MAX_STARTS = 10_000

#: Starts of a search, and of one whose inputs are simulated.
LINEAR_STARTS, NONLINEAR_STARTS = 8, 2

#: Iterations by which the design of a drive is refined: each takes a fifth of a second.
REFINING_ITERATIONS = 12

#: The price of a limit is told for this ease of it.
EASED = 0.1


def tune(
    system: System,
    *,
    objective: str = "error",
    error: float | None = None,
    peak_input: float | None = None,
    energy: float | None = None,
    period: float | None = None,
    delay_margin: float | None = None,
    noise: float | None = None,
    feedforward: int | None = None,
    law: str | None = None,
    box: Sequence[tuple[float, float]] | None = None,
    starts: int | None = None,
    seed: int = 0,
    front: str | None = None,
    progress: Progress = silent,
) -> Tuned:
    """Choose the gains of a system's law.

    Parameters
    ----------
    system : System
        Where the search begins.
    objective : {"error", "peak", "energy", "period"}
        What is optimised: the certified error, the peak input or the energy as small, the longest
        stable period as long as the limits allow.
    error : float, optional
        Limit of the certified error, unit of the output; for other objectives that of the system's
        own design if left out.
    peak_input : float, optional
        Limit of \\|u\\| over the box of starts.
    energy : float, optional
        Limit of the integral of u^2, from the file's start.
    period : float, optional, s
        Held at this period the loop must be stable.
    delay_margin : float, optional, s
        Delay that the held loop must bear.
    noise : float, optional
        Limit of the gain from noise on the states to the input.
    feedforward : int, optional
        q; the law's own if left out.
    law : str, optional
        Kind of the law; the system's own if left out.
    box : pairs (low, high), optional
        The box of starts; that of the population if left out.
    starts : int, optional
        Searches: the first from the system's gains, the others from random ones about them. If left
        out 8, or 2 for a nonlinear loop, whose inputs are simulated.
    seed : int
        Of these. The same seed gives the same design.
    front : str, optional
        Name of a limit to sweep: ``period``, ``peak-input``, ``energy``, ``noise`` or ``error``.
    progress : callable
        Gets the starts done, their number and the best objective so far. KeyboardInterrupt, and
        :class:`~certrack.core.errors.Cancelled`, end the search and keep the best.

    Returns
    -------
    Tuned

    Raises
    ------
    InputError
        If limits contradict each other, or an argument does not fit.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> tuned = certrack.tune(system, peak_input=39.1, period=0.087, starts=1)
    >>> tuned.after.certified <= tuned.before.certified
    True
    """
    require_system(system)
    checks.choice("objective", objective, OBJECTIVES)
    if starts is not None:
        checks.integer("starts", starts, 1, MAX_STARTS)
    checks.integer("seed", seed, 0, 2**63 - 1)
    wanted = Requirements(
        error=error,
        peak_input=peak_input,
        energy=energy,
        period=period,
        delay_margin=delay_margin,
        noise=noise,
        box=box,
    )
    family, base = _family(system, law, feedforward)
    try:
        problem = TuningProblem(base, system, wanted, objective)
    except NoCertificate as refusal:
        raise InputError("tune", f"there is no certificate to tune: {refusal}") from None
    if front is not None:
        limits_named(front, problem.task.limits)  # before hours of search
    count = starts or (LINEAR_STARTS if problem.is_linear else NONLINEAR_STARTS)
    search = _searched(problem, family, count, seed, progress)
    best = search.state.best
    if best is None:
        raise conflict(problem, family, search)
    refined = problem.refined
    task = refined or problem.task
    if refined is not None:
        best = _refined(problem, refined, family, best, search)
    tuned = base.replace(law=family.written(best.v))
    active = tuple(
        ActiveLimit(price.limit.name, price.limit.value, price.gain(EASED, task.sign))
        for price in prices(task, best)
    )
    programs = problem.error.programs
    curve: Front | None = None
    if front is not None:
        curve = sweep(problem, family, best, front, progress)
    box_used = problem.box
    finished = replace(tuned, implementation=system.implementation)
    after = figures_of(finished, box_used, seed)
    return Tuned(
        system=finished,
        objective=objective,
        before=figures_of(system, box_used, seed),
        after=after,
        limits=tuple(limit.describe() for limit in task.limits),
        active=active,
        programs=programs,
        programs_per_start=tuple(search.state.programs_per_start),
        seed=seed,
        front=curve,
        notes=tuple(problem.notes),
        stopped=search.state.stopped,
        broken=tuple(broken_limits(task.limits, after)),
    )


def _family(system: System, law: str | None, feedforward: int | None) -> tuple[Family, System]:
    """The family, and the continuous system with its first law."""
    q = system.law.order(system.plant) if feedforward is None else feedforward
    q = checks.integer("feedforward", q, 0, system.plant.n - 1)
    kind = system.law.kind if law is None else law
    family = tuning_family(system, kind, q)
    changes: dict[str, Any] = {"law": family.law(family.start), "implementation": None}
    if family.kind != system.law.kind:
        changes["settings"] = replace(system.settings, estimates=None)
    return family, system.replace(**changes)


def _refined(
    problem: TuningProblem, task: Task, family: Family, best: Candidate, search: GainSearch
) -> Candidate:
    """The best design of the loop as the drive runs it, from that of the continuous one."""
    refinement = GainSearch(problem.base, task, iterations=REFINING_ITERATIONS)
    try:
        refinement.run(family, family.start)
        refinement.run(family, best.v)
    except (KeyboardInterrupt, Cancelled):
        search.state.stopped = True
    if refinement.state.best is None:
        problem.notes.append("the loop as implemented has no certificate; tuned is the continuous")
        return best
    return refinement.state.best


def _searched(
    problem: TuningProblem, family: Family, count: int, seed: int, progress: Progress
) -> GainSearch:
    """The search, from all starts or until the user ends it."""
    done = 0

    def best_of(score: float) -> float | None:
        return math.exp(problem.task.sign * score) if math.isfinite(score) else None

    search = GainSearch(
        problem.base, problem.task, lambda state: progress(done, count, best_of(state.score))
    )
    try:
        for v in random_starts(family, count, seed):
            before = problem.error.programs
            progress(done, count, best_of(search.state.score))
            search.run(family, v)
            search.state.programs_per_start.append(problem.error.programs - before)
            done += 1
        progress(done, count, best_of(search.state.score))
    except (KeyboardInterrupt, Cancelled):
        if search.state.best is None:
            raise
        search.state.stopped = True
    return search
