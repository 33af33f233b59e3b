"""The cascade in floats: with its best rates, and with given ones and their gradient.

The first program bounds e_n by E, and E is a datum of the second (:mod:`..cascade`). A designer
needs the best of all stages at once, each begun where it ended before: :func:`best_cascade`. A
search needs value and gradient at rates that are among its unknowns: where a gain changes, the
head's problem changes by the gain and by what E moves, and its dual tells of both:
:func:`cascade_estimate`, and with a centred stage between :func:`centred_cascade_estimate`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from certrack.certificates.arithmetic import decimal, rational
from certrack.certificates.cascade import SHIFT_DIGITS, head_problem
from certrack.certificates.centred import CentredProblems
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.estimates.centred_stage import CentredStage, ReachedSet, StageDesign
from certrack.certificates.estimates.dual import SemidefiniteEstimate, semidefinite_estimate
from certrack.certificates.estimates.known_stage import KnownStage, sizes_of_gains
from certrack.certificates.estimates.riccati import riccati_estimate
from certrack.certificates.exact import Proof
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.search.decay_rate import (
    NEARBY_SLOPE_ACCURACY,
    SLOPE_ACCURACY,
    best_by_slope,
)
from certrack.certificates.search.riccati import RiccatiState
from certrack.certificates.search.shift import best_shift_nearby, best_shifts
from certrack.certificates.semidefinite import SemidefiniteProgram, Solution, fastest_rate
from certrack.systems.system import System

#: Beside a shift from nearby, one so much smaller and larger is tried where it ends at a kink.
SHIFT_RATIO = 1.06

#: Step in logarithms of rates, centre and E where no other is asked for.
LOG_STEP = 1e-5

#: Digits of the floats that stand for a proof.
STAGE_DIGITS = 13


@dataclass(frozen=True)
class BestCascade:
    """The cascade as far as floats tell.

    Attributes
    ----------
    last : Solution
        Of e_n.
    centred : Solution or None
        Of e_n, with V centred elsewhere; None where that is no better.
    head : Solution
        Of e_1.
    problems : pair of ErrorProblem
        That of e_n which counts, and that of e_1.
    stage : KnownStage
        What a quick look nearby needs of the centred one.
    shift : float
        kappa of the centred stage; 0 without.
    state : RiccatiState or None
        What a warm start of the head needs.
    """

    last: Solution
    centred: Solution | None
    head: Solution
    problems: tuple[ErrorProblem, ErrorProblem]
    stage: KnownStage
    shift: float = 0.0
    state: RiccatiState | None = None

    @property
    def of_last(self) -> Solution:
        """The solution that bounds e_n."""
        return self.last if self.centred is None else self.centred

    def in_vain(self) -> BestCascade:
        """The same where another method has a smaller bound: its centred stage helps no one."""
        return replace(self, stage=replace(self.stage, worth=0.0))


def best_cascade(
    system: System,
    program: SemidefiniteProgram,
    near: BestCascade | None,
    accuracy: float,
) -> BestCascade | None:
    """The stages of the cascade; None where one of them has no solution.

    Parameters
    ----------
    system : System
    program : SemidefiniteProgram
        Of the adaptive law and order 2 or more.
    near : BestCascade or None
        Of a system nearby.
    accuracy : float
        Beside it, what log bound^2 of a stage may be above the lowest.
    """
    problem = program.problem
    last_alpha = None if near is None else near.last.alpha
    last = rate_nearby(program.aimed_at(problem.n - 1), last_alpha, accuracy)
    if last is None:
        return None
    quick = near is not None and accuracy > NEARBY_SLOPE_ACCURACY
    of_last, shift, centred = problem, 0.0, None
    stage, sizes = None if near is None else near.stage, sizes_of_gains(problem)
    anew = stage is None or stage.is_far(sizes, quick)
    if stage is None or anew:
        stage = KnownStage(0.0, last.alpha, 0.0, last.bound, sizes)
    if anew or not quick or stage.is_followed(last):
        beside = stage if stage.shift else None
        best_centred = _centred(system, program, last, beside, accuracy, quick)
        if best_centred is not None and best_centred[0].bound < last.bound:
            centred, shift, of_last = best_centred
            worth = 1 - centred.bound / last.bound
            stage = replace(
                stage, shift=shift, alpha=centred.alpha, worth=worth, without=last.bound
            )
        else:  # an accurate look begins from nothing next time, a quick one from here
            shift_nearby = stage.shift if quick else 0.0
            stage = replace(stage, shift=shift_nearby, worth=0.0, without=last.bound)
    limit = last.bound if centred is None else centred.bound
    inner = head_problem(problem, limit)
    known, alpha = (None, None) if near is None else (near.state, near.head.alpha)
    head, state = solution_nearby(inner, known, alpha, accuracy)
    if head is None:
        return None
    return BestCascade(last, centred, head, (of_last, inner), stage, shift, state)


def rate_nearby(
    program: SemidefiniteProgram, near: float | None, accuracy: float
) -> Solution | None:
    """The solution of least bound over alpha, from what is known of a program nearby, if anything.

    Parameters
    ----------
    program : SemidefiniteProgram
    near : float or None, 1/s
    accuracy : float
        Beside it, what log bound^2 may be above the lowest.
    """
    return best_by_slope(program, near, SLOPE_ACCURACY if near is None else accuracy)


def solution_nearby(
    problem: ErrorProblem,
    state: RiccatiState | None,
    alpha: float | None,
    accuracy: float,
) -> tuple[Solution | None, RiccatiState | None]:
    """The same of a problem without estimates: by its Riccati equation, and its state.

    Parameters
    ----------
    problem : ErrorProblem
    state : RiccatiState or None
        Of a problem nearby.
    alpha : float or None, 1/s
        The same where that had no Riccati equation.
    accuracy : float
        There, what log bound^2 may be above the lowest.
    """
    quick = riccati_estimate(problem, state)
    if quick is not None:
        return quick.solution, quick.state
    return rate_nearby(SemidefiniteProgram(problem), alpha, accuracy), None


def _centred(
    system: System,
    program: SemidefiniteProgram,
    reached: Solution,
    known: KnownStage | None,
    accuracy: float,
    quick: bool,
) -> tuple[Solution, float, ErrorProblem] | None:
    """The centred stage: by a full search, or beside the one that is known from nearby."""
    problem, target = program.problem, program.problem.n - 1
    try:
        if quick:
            design = problem, error_coordinates(system, decimal)
            problems = CentredStage.of(system).problems(design, reached.P, reached.bound)
        else:  # the exact enclosure knows fewer formulas: what it does not know is not proven
            exact = error_problem(system, rational)
            problems = CentredProblems.of(system, exact, _as_proof(reached)).in_floats()
    except NoCertificate:
        return None
    if not math.isfinite(problems.remainder):
        return None
    if known is not None:
        near = known.shift, known.alpha
        nearby = best_shift_nearby(problems, *near, target, accuracy, program.scaling)
        if nearby is not None:
            kappa, solution = nearby
            return solution, kappa, problems.at(kappa)
        ratios = (1.0,) if quick else (1.0, SHIFT_RATIO, 1 / SHIFT_RATIO)
        pairs = [(known.shift * ratio, known.alpha) for ratio in ratios]
    else:
        pairs = best_shifts(problems, reached.alpha, target, reached.bound)[:1]
    entries = []
    for kappa, alpha in pairs:
        shift = float(f"{kappa:.{SHIFT_DIGITS}g}")
        centred = problems.at(shift)
        best = best_by_slope(
            SemidefiniteProgram(centred, target), alpha, accuracy if quick else SLOPE_ACCURACY
        )
        if best is not None:
            entries.append((best, shift, centred))
    return min(entries, key=lambda entry: entry[0].bound, default=None)


def _as_proof(solution: Solution) -> Proof:
    """Floats in the form of a proof, which they are none of."""

    def text(value: float) -> str:
        return f"{float(value):.{STAGE_DIGITS}g}"

    rows = tuple(tuple(map(text, row)) for row in np.asarray(solution.P))
    lam, nu, k = (tuple(map(text, v)) for v in (solution.lam, solution.nu, solution.k))
    return Proof(text(solution.alpha), rows, lam, nu, k, text(solution.bound))


@dataclass(frozen=True)
class CascadeEstimate:
    """The bound of the stages for given rates, and its gradient.

    Attributes
    ----------
    bound : float
        Of limsup |e_1|.
    last : float
        Of limsup |e_n|.
    log_gradient : array
        Derivatives of log bound, one for each pair of changed problems.
    by_log_shares : tuple of float
        Its derivatives by the logarithms of the shares.
    by_log_shift : float
        The same of the centre's shift kappa; 0 without a centred stage.
    """

    bound: float
    last: float
    log_gradient: np.ndarray
    by_log_shares: tuple[float, ...]
    by_log_shift: float = 0.0


def cascade_estimate(
    problem: ErrorProblem,
    shares: tuple[float, float],
    changed: Sequence[tuple[ErrorProblem, ErrorProblem]] = (),
    step: float = LOG_STEP,
) -> CascadeEstimate | None:
    """The bound with each stage's alpha a share of its fastest rate; None if there is none.

    Parameters
    ----------
    problem : ErrorProblem
        In floats, with estimates, n >= 2.
    shares : pair of floats
        Below 1.
    changed : pairs of ErrorProblem
        With each parameter a step above and below.
    step : float
        Of these.
    """
    first = semidefinite_estimate(problem, shares[0], changed, step, problem.n - 1)
    if first is None:
        return None
    slopes = np.append(first.log_gradient, first.by_log_share)
    head = _head(problem, first.bound, slopes, shares[1], [*changed, (problem, problem)], step)
    if head is None:
        return None
    *gradient, by_first = head.log_gradient
    by_shares = float(by_first), head.by_log_share
    return CascadeEstimate(head.bound, first.bound, np.array(gradient), by_shares)


def centred_cascade_estimate(
    stage: CentredStage,
    design: StageDesign,
    shares: tuple[float, float, float],
    shift: float,
    changed: Sequence[tuple[StageDesign, StageDesign]] = (),
    step: float = LOG_STEP,
) -> CascadeEstimate | None:
    """The same with a centred stage between the two; None if one of the three has no solution.

    Nor if the first has no P that is larger than its others (:class:`.centred_stage.ReachedSet`):
    there the set that the second begins with is none that could be differentiated.

    Parameters
    ----------
    stage : CentredStage
        Of the plant and the reference.
    design : StageDesign
        In floats, with estimates, n >= 2.
    shares : three floats
        Below 1, of the stages in their order.
    shift : float
        kappa of the centred one.
    changed : pairs of StageDesign
        With each parameter a step above and below.
    step : float
        Of these, in logarithms.
    """
    problem, ratio = design[0], math.exp(step)
    target, pairs = problem.n - 1, [(above[0], below[0]) for above, below in changed]
    fastest = fastest_rate(problem)
    if not fastest > 0:
        return None

    def rated(of: ErrorProblem, by: float = 1.0) -> tuple[ErrorProblem, float]:
        return of, shares[0] * fastest_rate(of) * by

    each = [(rated(above), rated(below)) for above, below in pairs]
    by_share = rated(problem, ratio), rated(problem, 1 / ratio)
    first = ReachedSet.of(rated(problem), [*each, by_share], step)
    if first is None:
        return None
    centred = stage.problems(design, first.P, first.bound)
    if not math.isfinite(centred.remainder):
        return None
    moved = [
        (stage.problems(above, *higher).at(shift), stage.problems(below, *lower).at(shift))
        for (above, below), (higher, lower) in zip(
            [*changed, (design, design)], first.moved, strict=True
        )
    ]
    moved.append((centred.at(shift * ratio), centred.at(shift / ratio)))
    second = semidefinite_estimate(centred.at(shift), shares[1], moved, step, target)
    if second is None:
        return None
    slopes = np.append(second.log_gradient, second.by_log_share)
    inner = [*pairs, *[(problem, problem)] * 3]
    head = _head(problem, second.bound, slopes, shares[2], inner, step)
    if head is None:
        return None
    *gradient, by_first, by_shift, by_second = head.log_gradient
    by_shares = float(by_first), float(by_second), head.by_log_share
    return CascadeEstimate(head.bound, second.bound, np.array(gradient), by_shares, float(by_shift))


def _head(
    problem: ErrorProblem,
    E: float,
    slopes: np.ndarray,
    share: float,
    changed: Sequence[tuple[ErrorProblem, ErrorProblem]],
    step: float,
) -> SemidefiniteEstimate | None:
    """The last stage: its problem changes with each parameter, and by what that moves E."""
    pairs = [
        (
            head_problem(above, E * math.exp(step * slope)),
            head_problem(below, E * math.exp(-step * slope)),
        )
        for (above, below), slope in zip(changed, slopes, strict=True)
    ]
    return semidefinite_estimate(head_problem(problem, E), share, pairs, step)
