"""Tuning: gains that make one quantity as good as limits on the others allow.

The certificate is the objective or a limit. Its gradient comes from the program that gives its
value, the rest is SciPy's SLSQP on the logarithms of the gains, from several starts. What it finds
is certified in full at the end: the search's own numbers are floats and prove nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

from certrack.certificates.certify import EFFORTS
from certrack.certificates.scope import has_ranges
from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import Cancelled
from certrack.core.progress import Progress, silent
from certrack.systems.system import System, require_system
from certrack.tuning.candidate import Candidate
from certrack.tuning.certified import certified
from certrack.tuning.companion import with_law_of
from certrack.tuning.conflict import conflict
from certrack.tuning.exceeded import broken_limits
from certrack.tuning.fallback import best_certified
from certrack.tuning.front import limits_named, sweep
from certrack.tuning.measure import (
    MEASURING_STEPS,
    STEP_NAMES,
    UNMEASURED,
    Measured,
    alike,
    figures_of,
)
from certrack.tuning.problem import OBJECTIVES, Requirements
from certrack.tuning.result import ActiveLimit, Front, Tuned
from certrack.tuning.search import GainSearch, prices, random_starts
from certrack.tuning.stages import GainStage, searches_of

#: Starts of a search that is asked for by mistake would take days.
MAX_STARTS = 10_000

#: Starts of a search, and of one whose inputs are simulated.
LINEAR_STARTS, NONLINEAR_STARTS = 8, 2

#: Iterations by which the design of a drive is refined: each takes a fifth of a second.
REFINING_ITERATIONS = 12

#: Steps when the search is over, by name: the tuned design, another one where it has no
#: certificate, the file's, and what both have where only one is certified as the drive runs it.
FINISHING_NAMES = (
    *(f"tuned design: {name}" for name in STEP_NAMES),
    "another tuned design, with a certificate",
    *(f"design before: {name}" for name in STEP_NAMES),
    "both designs: continuous law",
)
FINISHING_STEPS = len(FINISHING_NAMES)

#: What is said where bounds of a drive with ranges are compared.
ONE_PROOF = (
    "each certified error as the drive runs it is one proof for the whole of plant.ranges; "
    "certrack certify cuts them into cells and mostly proves less"
)

#: The price of a limit is told for this ease of it.
EASED = 0.1


@one_blas_thread
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
    effort: str = "fast",
    progress: Progress = silent,
    proving: Progress = silent,
    sweeping: Progress = silent,
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
    effort : {"fast", "default", "high"}
        Of the certificates of both designs, before and after. ``fast`` proves the loop as
        implemented for all ranges at once; the others cut them into cells, which takes minutes.
    progress : callable
        Gets the starts done, their number and the best objective so far. KeyboardInterrupt, and
        :class:`~certrack.core.errors.Cancelled`, end the search and keep the best; with the
        argument :data:`~certrack.core.progress.AT_ONCE` nothing is measured either.
    proving : callable
        Gets, when the search is over, the steps done of certifying and measuring both designs,
        their number and the bound so far; :func:`finishing_step` names them.
    sweeping : callable
        Gets the points of the front done, their number and the objective of the last.

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
    checks.choice("effort", effort, EFFORTS)
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
    searches = searches_of(system, wanted, objective, law, feedforward)
    first, last = searches[0], searches[-1]
    if front is not None:
        limits_named(front, last.problem.task.limits)  # before hours of search
    count = starts or (LINEAR_STARTS if first.is_quick else NONLINEAR_STARTS)
    search = _searched(first, count, seed, progress)
    best = search.state.best
    if best is None:
        raise conflict(first.problem, first.family, search)
    used, notes = first, list(first.problem.notes)
    for stage in searches[1:]:
        if search.state.stopped:
            break
        refined = _refined(stage, best, search, lambda value: progress(count, count, value))
        if refined is not None:
            best, used = refined, stage
        elif not search.state.stopped:
            notes.append("the loop as implemented has no certificate; tuned is the continuous")
    task, hurried = used.problem.task, search.state.hurried
    programs = first.problem.error.programs
    curve: Front | None = None
    if front is not None and not hurried:
        curve = sweep(used.problem, used.family, best, front, sweeping)
    starts_box = first.problem.box
    notes += last.left_alone()

    def finished_of(candidate: Candidate) -> System:
        return with_law_of(system, last.written(candidate.v))

    def figures(of: System, begun: int, steps: int = MEASURING_STEPS) -> Measured:
        return _figures(
            partial(figures_of, of, starts_box, seed, effort),
            lambda done, _, bound: proving(begun + min(done, steps), FINISHING_STEPS, bound),
            search,
        )

    after = figures(finished_of(best), 0)
    if math.isinf(after.certified) and used is first and not search.state.stopped:
        said = partial(proving, MEASURING_STEPS, FINISHING_STEPS, None)
        other, note = _fallback(search, finished_of, effort, said)
        notes.append(note)
        if other is not None:
            best, after = other, figures(finished_of(other), MEASURING_STEPS, 0)
    before = figures(system, MEASURING_STEPS + 1)
    before, after = _compared(
        (system, before), (finished_of(best), after), seed, effort, proving, search
    )
    if effort == "fast" and has_ranges(system) and (before.of_drive or after.of_drive):
        notes.append(ONE_PROOF)
    hurried = search.state.hurried
    active = tuple(
        ActiveLimit(price.limit.name, price.limit.value, price.gain(EASED, task.sign))
        for price in ([] if hurried else prices(task, best))
    )
    return Tuned(
        system=finished_of(best),
        objective=objective,
        before=before,
        after=after,
        limits=tuple(dict.fromkeys(limit.describe() for limit in task.limits)),
        active=active,
        programs=programs,
        programs_per_start=tuple(search.state.programs_per_start),
        seed=seed,
        front=curve,
        notes=tuple(notes),
        stopped=search.state.stopped,
        broken=tuple(broken_limits(task.limits, after)),
    )


def _figures(measured: Callable[..., Measured], progress: Progress, search: GainSearch) -> Measured:
    """The figures of a design; none where the user ends that, who then has the design at least."""
    if search.state.hurried:
        return UNMEASURED
    try:
        return measured(progress=progress)
    except (KeyboardInterrupt, Cancelled) as signal:
        search.state.ended_by(signal)
        return UNMEASURED


def _compared(
    before: tuple[System, Measured],
    after: tuple[System, Measured],
    seed: int,
    effort: str,
    proving: Progress,
    search: GainSearch,
) -> tuple[Measured, Measured]:
    """Both measurements, with figures of the same loop; as they are where the user ends that."""

    def report(_: float, __: float | None, bound: float | None, /) -> None:
        proving(FINISHING_STEPS - 1, FINISHING_STEPS, bound)

    try:
        return alike(before, after, seed, effort, report)
    except (KeyboardInterrupt, Cancelled) as signal:
        search.state.ended_by(signal)
        return before[1], after[1]


def finishing_step(done: float) -> str:
    """The name of the step that :func:`tune` is at when its search is over.

    Parameters
    ----------
    done : float
        Steps done, as ``proving`` gets them.

    Returns
    -------
    str

    Examples
    --------
    >>> finishing_step(0)
    'tuned design: closed forms'
    """
    return FINISHING_NAMES[min(int(done), FINISHING_STEPS - 1)]


def _fallback(
    search: GainSearch,
    finished: Callable[[Candidate], System],
    effort: str,
    said: Callable[[], None],
) -> tuple[Candidate | None, str]:
    """The best design of the search with a certificate, where the best of all has none; a note."""

    def is_certified(candidate: Candidate) -> bool:
        said()
        return certified(finished(candidate), effort=effort, progress=lambda *_: said()).verified

    try:
        other, asked = best_certified(search.state.improvements[:-1], is_certified)
    except (KeyboardInterrupt, Cancelled) as signal:
        search.state.ended_by(signal)
        return None, "nothing is certified; the search of a design that is was interrupted"
    if other is None:
        return None, (
            f"nothing is certified of the best design, nor of {asked} others that the search went "
            "through; narrow plant.ranges, or limit the noise more"
        )
    return other, (
        "the best design of the search has no certificate; this is the best on the way to it "
        f"that has one, of {asked} asked; a lower limit of the noise may find a better one"
    )


def _refined(
    stage: GainStage, best: Candidate, search: GainSearch, report: Callable[[float | None], None]
) -> Candidate | None:
    """The best design of the loop as the drive runs it, from that of the continuous one."""
    task = stage.problem.task
    refinement = GainSearch(
        stage.problem.base,
        task,
        lambda state: report(_objective_of(state.score, task.sign)),
        REFINING_ITERATIONS,
    )
    try:
        refinement.run(stage.family, stage.family.start)
        refinement.run(stage.family, stage.beside(best.v))
    except (KeyboardInterrupt, Cancelled) as signal:
        search.state.ended_by(signal)
    return refinement.state.best


def _searched(stage: GainStage, count: int, seed: int, progress: Progress) -> GainSearch:
    """The search, from all starts or until the user ends it."""
    problem, family, done = stage.problem, stage.family, 0

    def best_of(score: float) -> float | None:
        return _objective_of(score, problem.task.sign)

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
    except (KeyboardInterrupt, Cancelled) as signal:
        if search.state.best is None:
            raise
        search.state.ended_by(signal)
    return search


def _objective_of(score: float, sign: float) -> float | None:
    """The objective of a search's score; None where nothing is found yet."""
    return math.exp(sign * score) if math.isfinite(score) else None
