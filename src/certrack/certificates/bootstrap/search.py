"""The iteration: box, ranges, bounds of every row, a smaller box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.forms import forms_of
from certrack.certificates.bootstrap.loop import AdaptiveLoop, adaptive_loop, formulas_of
from certrack.certificates.bootstrap.polynomial_stages import polynomial_stages, shrunk
from certrack.certificates.bootstrap.program import BootstrapProgram
from certrack.certificates.bootstrap.proof import FunctionProof, prove_function, row_over_box
from certrack.certificates.bootstrap.ranges import Ranges
from certrack.certificates.bootstrap.rates import Rate, best_of_rates
from certrack.certificates.bootstrap.regions import Reached, after, first_box, next_region, rows_of
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, from_text
from certrack.certificates.problem import ErrorProblem
from certrack.core.progress import Progress, silent
from certrack.systems.system import System

#: Stages at most; the iteration ends when no interval shrinks by more than this part, with a sweep.
MOST_STAGES, WORTH_A_STAGE = 10, 0.01

#: Programs for each row on the first box, and on the others.
FIRST_TRIES, LATER_TRIES = 4, 1

#: As many alpha are tried where the iteration has come to an end, between these parts of that of
#: the first proof and of the fastest error: a bound may have two minima, as different as these.
#: Then only e_1 is bounded anew, unless the effort is high.
SWEPT, SLOW_PART, FAST_PART = 6, 1.5, 2.0

#: Groups of rows.
MOST_GROUPS = 4

#: A bound is proven if it is better than what is known by this part of the interval.
WORTH_A_PROOF = 1e-3

#: Entries of the matrices of all corners above which it takes more than about five seconds.
MOST_DEFAULT_ENTRIES = 1200

#: Rows, each with its side, that one function bounds.
Group = tuple[tuple[int, int], ...]


def bootstrap(
    system: System,
    problem: ErrorProblem,
    first: Proof,
    effort: str = "default",
    progress: Progress = silent,
) -> tuple[BootstrapStage, ...]:
    """All stages behind the proof `first` of a bound on e_n.

    With the effort ``high`` stages with polynomials follow those with quadratic functions.

    Raises
    ------
    NoCertificate
        If drift or regressor have no bounds on the first box, or it would take too long.
    """
    loop = adaptive_loop(system, problem)
    if effort != "high" and _corner_entries(loop) > MOST_DEFAULT_ENTRIES:
        raise NoCertificate("takes more time for a plant of this size: --effort high")
    ranges = Ranges(formulas_of(system), loop)
    known = first_box(loop, first)
    rates: dict[Group, Rate] = {}
    starts = starting_rates(loop, float(from_text(first.alpha)))
    sweep, stalled = sweep_of(loop, first), False
    stages: list[BootstrapStage] = []
    for count in range(MOST_STAGES):
        tries = LATER_TRIES if count else FIRST_TRIES
        tried = sweep if stalled else ()
        groups = 1 if stalled and effort != "high" else MOST_GROUPS
        stage, later = _next_stage(loop, ranges, known, rates, starts, tries, tried, groups)
        gain = shrunk(known, later)
        if stage.functions:
            stages.append(stage)
            known = later
            progress(0, None, max(map(abs, known.box[0].astype(float))))
        if stalled and gain < WORTH_A_STAGE:
            break
        stalled = gain < WORTH_A_STAGE
    if effort == "high":
        stages += polynomial_stages(loop, ranges, known, sweep, progress)
    return tuple(stages)


def _corner_entries(loop: AdaptiveLoop) -> int:
    """Entries of the matrices of all corners, on which the time of a program depends."""
    inputs = loop.Ua.shape[1] + loop.Ub.shape[1] + len(loop.Y)
    ranged = sum(1 for radius in loop.theta_radius if radius > 0)
    scales = 2 if loop.largest_scale > 1 else 0
    width = loop.size + inputs + ranged + scales + 3 * loop.r + 2
    return 2 * width**2


def groups_of(loop: AdaptiveLoop, rows: int) -> list[Group]:
    """Rows that share a function: e_1; the others that follow e_n; e_n; the estimates and ubar.

    A function for every row and side gives bounds that are less than 1 % smaller, in three times
    the time.
    """
    n = loop.n
    parts = [[0], list(range(1, n - 1)), [n - 1], list(range(n, rows))]
    parts = parts if n > 1 else parts[2:]
    return [tuple((error, side) for error in part for side in (1, -1)) for part in parts if part]


def sweep_of(loop: AdaptiveLoop, first: Proof) -> tuple[float, ...]:
    """Some alpha from the slow one of the first proof to twice that of the fastest error."""
    slow = SLOW_PART * float(from_text(first.alpha))
    fast = FAST_PART * max(-float(loop.M[i, i]) for i in range(loop.n))
    return tuple(map(float, np.geomspace(slow, max(fast, slow), SWEPT)))


def starting_rates(loop: AdaptiveLoop, slow: float) -> list[float]:
    """An alpha for each row: e_1 ... e_{n-1} follow e_n alone, and faster than the estimates."""
    head = loop.M[:-1, :-1].astype(float)
    fast = -float(np.linalg.eigvals(head).real.max()) if len(head) else slow
    return [max(fast, slow)] * (loop.n - 1) + [slow] * (loop.r + 3)


def _next_stage(
    loop: AdaptiveLoop,
    ranges: Ranges,
    known: Reached,
    rates: dict[Group, Rate],
    starts: list[float],
    tries: int,
    sweep: Sequence[float],
    groups: int,
) -> tuple[BootstrapStage, Reached]:
    region = next_region(loop, ranges, known)
    functions, later = functions_on(loop, region, None, known, rates, starts, tries, sweep, groups)
    return BootstrapStage(region, functions), later


def functions_on(
    loop: AdaptiveLoop,
    region: Region,
    acting: np.ndarray | None,
    known: Reached,
    rates: dict[Group, Rate],
    starts: list[float],
    tries: int,
    sweep: Sequence[float],
    groups: int,
    more: Sequence[np.ndarray] = (),
) -> tuple[tuple[FunctionProof, ...], Reached]:
    """Functions that bound the rows on a region, and what is known with them.

    Parameters
    ----------
    loop : AdaptiveLoop
        In exact rationals.
    region : Region
    acting : (size,) array of rationals, or None
        What else acts on the rates, as of :func:`forms_of`.
    known : Reached
    rates : dict
        Of the groups of rows; they learn.
    starts : list of floats
        An alpha for each row to begin with.
    tries, sweep : as of :func:`best_of_rates`
    groups : int
        So many groups of rows are bounded.
    more : rows
        Over the errors; they are bounded, too, each side by a function of its own.
    """
    numbers = region.numbers()
    forms = forms_of(loop, numbers, acting)
    of_floats = None if acting is None else acting.astype(float)
    floats = forms_of(loop.in_floats(), numbers.in_floats(), of_floats)
    of_region = rows_of(loop, numbers)
    rows = [*of_region, *more]
    wanted = groups_of(loop, len(forms.sectors))[:groups]
    wanted += [((i, side),) for i in range(len(of_region), len(rows)) for side in (1, -1)]
    functions: list[FunctionProof] = []
    programs: dict[int, BootstrapProgram] = {}
    for group in wanted:
        if len(group) not in programs:
            programs[len(group)] = BootstrapProgram(floats, len(group))
        rate = rates.setdefault(group, Rate(min(starts[error] for error, _ in group)))
        asked = np.array([row_over_box(forms, side * rows[error]) for error, side in group])
        solution = best_of_rates(programs[len(group)], asked.astype(float), rate, tries, sweep)
        if solution is None or not any(
            _gain(known, rows[error], side, bound) > WORTH_A_PROOF
            for (error, side), bound in zip(group, solution.bounds * solution.sizes, strict=True)
        ):
            continue
        proof = prove_function(forms, solution, group, rows)
        functions += [] if proof is None else [proof]
    return tuple(functions), after(known, functions, of_region)


def _gain(known: Reached, row: np.ndarray, side: int, bound: float) -> float:
    """By which part of an interval a bound makes it smaller."""
    low, high = known.interval_of(row)
    best = high if side > 0 else -low
    return (float(best) - bound) / float(high - low)
