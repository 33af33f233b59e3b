"""The proof of the sampled adaptive loop: numbers as decimal texts, and their exact check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.bootstrap.box import Region, TextPair, interval_of
from certrack.certificates.bootstrap.check import claimed_bound
from certrack.certificates.bootstrap.forms import Forms, forms_of
from certrack.certificates.bootstrap.loop import AdaptiveLoop, adaptive_loop, formulas_of
from certrack.certificates.bootstrap.proof import FunctionProof, failed_part
from certrack.certificates.bootstrap.ranges import Ranges
from certrack.certificates.bootstrap.regions import (
    Reached,
    after,
    failed_ranges,
    failed_region,
    failed_shape,
    rows_of,
)
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import float_down, float_up, from_text
from certrack.certificates.formulation import error_problem
from certrack.certificates.sampled_adaptive.held import HeldLaw, held_law
from certrack.certificates.sampled_adaptive.mismatch import LoopRates, Near
from certrack.certificates.sampled_adaptive.paces import Paces, image
from certrack.systems.system import System

#: Corners of the box of starts are looked at one by one.
MOST_ERRORS = 12


@dataclass(frozen=True)
class SampledStage:
    """A stage of a bootstrap with what the sampled loop adds.

    Attributes
    ----------
    region : Region
    pace : pair
        Of the row of the proof.
    law : str
        Above |u - u_law| on the box.
    estimates : r + 1 texts
        Above what the steps add to the rates of theta_hat, then delta_hat.
    functions : tuple of FunctionProof
    """

    region: Region
    pace: TextPair
    law: str
    estimates: tuple[str, ...]
    functions: tuple[FunctionProof, ...]


@dataclass(frozen=True)
class InvariantSet:
    """A set {W <= 0} within a box that no run leaves.

    Attributes
    ----------
    region : Region
    law, estimates : as of :class:`SampledStage`
    function : FunctionProof
        W, and bounds of all errors that are within the box.
    room : str
        What W may rise by until the first sample has acted.
    starts : n texts
        W <= -room where |e_i(0)| is at most this ...
    priors : r + 1 pairs
        ... and delta_hat(0), theta_hat(0) are within these.
    """

    region: Region
    law: str
    estimates: tuple[str, ...]
    function: FunctionProof
    room: str
    starts: tuple[str, ...]
    priors: tuple[TextPair, ...]


@dataclass(frozen=True)
class SampledAdaptiveProof:
    """A set that is kept from the start on, and the stages on what is reached from it.

    Attributes
    ----------
    invariant : InvariantSet
    row : n + r + 1 texts
        A row of the errors that u_law' is near to.
    stages : tuple of SampledStage
    """

    invariant: InvariantSet
    row: tuple[str, ...]
    stages: tuple[SampledStage, ...]

    @property
    def bound(self) -> str:
        """The text of the bound on limsup |e_1|."""
        return claimed_bound(self.stages)

    @property
    def exact_row(self) -> np.ndarray:
        """The row in exact rationals."""
        return np.array([from_text(v) for v in self.row], dtype=object)


class SampledAdaptiveLoop:
    """The exact loop of a system with its implementation.

    Parameters
    ----------
    system : System

    Raises
    ------
    NoCertificate
        If it is not one that this room covers.
    """

    def __init__(self, system: System) -> None:
        self.held = held_law(system)
        self.problem = error_problem(system, rational)
        self.loop = adaptive_loop(system, self.problem)
        if self.loop.size > MOST_ERRORS:
            raise NoCertificate(f"a loop with more than {MOST_ERRORS} errors takes too long")
        formulas = formulas_of(system)
        self.ranges = Ranges(formulas, self.loop)
        self.motion = LoopRates(formulas, self.loop, self.held)
        self.estimates = tuple(rational(v) for v in system.estimates)
        self.priors = (self.loop.delta0, *self.loop.theta0)

    @property
    def largest_gain(self) -> Any:
        """Not below |g_n|."""
        return self.loop.smallest_gain * self.loop.largest_scale * self.loop.largest_scale

    def acting(self, law: Any, estimates: Sequence[Any]) -> np.ndarray:
        """What acts on the rates of the errors, for bounds of m and of the steps."""
        zero = rational(0)
        *thetas, delta = estimates
        values = [zero] * (self.loop.n - 1) + [self.largest_gain * law, *thetas]
        return np.array([*values, self.loop.largest_scale * delta], dtype=object)


def failed_mismatch(
    sampled: SampledAdaptiveLoop, stage: SampledStage | InvariantSet, paces: Paces
) -> str:
    """Empty if what a stage says that sampling adds is above what it adds, else what fails."""
    law, estimates = from_text(stage.law), [from_text(v) for v in stage.estimates]
    if len(estimates) != sampled.loop.r + 1:
        return "a stage has not as many estimates as the law"
    of_law, of_estimates = image(sampled.loop, sampled.held, paces, law)
    pairs = zip((of_law, *of_estimates), (law, *estimates), strict=True)
    if not all(bool(value < flint.arb(stated)) for value, stated in pairs):
        return "what sampling adds is not below what a stage says"
    return ""


def least_room(
    sampled: SampledAdaptiveLoop, forms: Forms, proof: FunctionProof, paces: Paces
) -> Any:
    """A bound of what the first input, which is of no sample, adds to W; None if there is none.

    |m| <= law + x with x <= m_0 before D, and x(t) <= b times its integral over T + D then. So

        int e^(alpha t) x dt <= m_0 D e^(alpha D)/(1 - b (T + D) e^(alpha (T + D))).
    """
    loop, held = sampled.loop, sampled.held
    unknowns = proof.unknowns()
    alpha, D, h = (flint.arb(v) for v in (unknowns.alpha, held.first, held.reach))
    T = flint.arb(held.T)
    left = 1 - paces.law_through * h * (alpha * h).exp()
    if not bool(left > 0):
        return None
    away = abs(paces.input - flint.arb(held.initial)).abs_upper()
    total = away * D * (alpha * D).exp() / left
    zero = flint.arb(0)
    drives = [b * T * (alpha * T).exp() for b in paces.drives_through]
    rates = [zero] * (loop.n - 1) + [flint.arb(sampled.largest_gain)]
    rates += [
        sum((flint.arb(abs(v)) * d for v, d in zip(row, drives[:-1], strict=True)), zero)
        for row in loop.Gamma
    ]
    rates.append(flint.arb(loop.largest_scale) * flint.arb(loop.gain_rate) * drives[-1])
    slopes = [2 * (abs(row).sum()) for row in unknowns.G[:-1]]  # on the box |zeta_i| <= 1
    rise = sum(
        (
            flint.arb(slope) * rate / flint.arb(radius)
            for slope, rate, radius in zip(slopes, rates, forms.radius, strict=True)
        ),
        zero,
    )
    return rise * total


def in_invariant_set(sampled: SampledAdaptiveLoop, forms: Forms, invariant: InvariantSet) -> bool:
    """Whether W <= -room at all starts, for all g_n and theta: W is convex."""
    loop = sampled.loop
    G, most = invariant.function.unknowns().G, -from_text(invariant.room)
    errors = [from_text(v) for v in invariant.starts]
    of_delta, *of_thetas = map(_pair_of, invariant.priors)
    ends = [(-v, v) for v in errors]
    ends += [
        (m - size - high, m + size - low)
        for m, size, (low, high) in zip(
            loop.theta_middle, loop.theta_radius, of_thetas, strict=True
        )
    ]
    first, last = (_start_of_d(loop, delta) for delta in of_delta)  # it is affine in delta_hat
    ends.append((min(first[0], last[0]), max(first[1], last[1])))
    for corner in product(*(dict.fromkeys(pair) for pair in ends)):
        zeta = [(z - m) / r for z, m, r in zip(corner, forms.middle, forms.radius, strict=True)]
        vector = np.array([*zeta, rational(1)], dtype=object)
        if not vector @ (G @ vector) <= most:
            return False
    return True


def _start_of_d(loop: AdaptiveLoop, delta: Any) -> tuple[Any, Any]:
    """Ends of d(0) = s/(g_0 v) - v delta_hat, v in [1, v_1]."""
    far, s, g = loop.largest_scale, loop.gain_sign, loop.smallest_gain
    first, last = s / g - delta, s / (g * far) - far * delta
    if s * delta < 0:  # its two terms move apart
        parts = [s / g, s / (g * far)], [-delta, -far * delta]
        return min(parts[0]) + min(parts[1]), max(parts[0]) + max(parts[1])
    return min(first, last), max(first, last)


def failed_limits(held: HeldLaw, paces: Paces) -> str:
    """Empty if neither the saturation nor the projection ever acts, else which may."""
    if held.saturation is not None:
        low, high = held.saturation
        inside = _is_within(paces.input, low, high) and low <= held.initial <= high
        if not inside:
            most = float_up(max(abs(v) for v in _ends_of_ball(paces.input)))
            return f"the saturation may act: |u| is only bounded by {most:.4g}"
    if held.projection is not None:
        for ball, (low, high) in zip(paces.estimates, held.projection, strict=True):
            if not _is_within(ball, low, high):
                first, last = (float(v) for v in _ends_of_ball(ball))
                return (
                    "the projection may act: an estimate is only bounded by "
                    f"[{float_down(rational(first)):.4g}, {float_up(rational(last)):.4g}]"
                )
    return ""


def _ends_of_ball(ball: Any) -> tuple[Any, Any]:
    return ball.lower().fmpq(), ball.upper().fmpq()


def _is_within(ball: Any, low: Any, high: Any) -> bool:
    first, last = _ends_of_ball(ball)
    return bool(low <= first and last <= high)


def failed_invariant(
    sampled: SampledAdaptiveLoop, invariant: InvariantSet
) -> tuple[str, Reached | None]:
    """What fails of the set that is invariant, or what is known in it."""
    loop = sampled.loop
    if reason := failed_shape(loop, invariant.region):
        return reason, None
    numbers = invariant.region.numbers()
    if not all(low < high for low, high in numbers.box):
        return "the box of the kept set is empty", None
    low, high = interval_of(numbers.linear_row(loop), numbers.box)
    if not (numbers.row[0] <= low and high <= numbers.row[1]):
        return "the row of the kept set is not that of its box", None
    if reason := failed_ranges(loop, sampled.ranges, invariant.region):
        return reason, None
    paces = sampled.motion.paces(numbers)
    if reason := failed_mismatch(sampled, invariant, paces) or failed_limits(sampled.held, paces):
        return reason, None
    forms, rows = sampled_forms(sampled, invariant), rows_of(loop, numbers)
    if reason := failed_part(forms, invariant.function, rows[: loop.size]):
        return reason, None
    claims = invariant.function.claims
    for error, side in product(range(loop.size), (1, -1)):
        end = numbers.box[error][1] if side > 0 else -numbers.box[error][0]
        bounds = [from_text(c.bound) for c in claims if (c.error, c.side) == (error, side)]
        if not any(bound < end for bound in bounds):
            return "the kept set is not inside its box", None
    room = least_room(sampled, forms, invariant.function, paces)
    if room is None or not bool(room <= flint.arb(from_text(invariant.room))):
        return "the first input may push the loop out of the kept set", None
    if reason := _failed_starts(sampled, invariant, forms):
        return reason, None
    return "", after(Reached(numbers.box), (invariant.function,), rows)


def _pair_of(texts: TextPair) -> tuple[Any, Any]:
    return from_text(texts[0]), from_text(texts[1])


def pace_after(
    pace: tuple[Any, Any], row: np.ndarray, known: Reached, functions: Sequence[FunctionProof]
) -> tuple[Any, Any]:
    """What is known of a row besides the errors, the last that a stage may bound."""
    low, high = known.interval_of(row)
    low, high = max(low, pace[0]), min(high, pace[1])
    for function in functions:
        for claim in function.claims:
            if claim.error == len(row) + 1:
                bound = from_text(claim.bound)
                low, high = (low, min(high, bound)) if claim.side > 0 else (max(low, -bound), high)
    return low, high


def _failed_starts(sampled: SampledAdaptiveLoop, invariant: InvariantSet, forms: Forms) -> str:
    loop = sampled.loop
    if len(invariant.starts) != loop.n or any(from_text(v) < 0 for v in invariant.starts):
        return "there is not one start for each error"
    pairs = [_pair_of(texts) for texts in invariant.priors]
    if len(pairs) != loop.r + 1 or any(low > high for low, high in pairs):
        return "there is not one interval for the start of each estimate"
    if from_text(invariant.room) < 0 or not in_invariant_set(sampled, forms, invariant):
        return "a start is not in the kept set"
    return ""


def sampled_forms(sampled: SampledAdaptiveLoop, stage: SampledStage | InvariantSet) -> Forms:
    """The forms of a stage, or of the kept set, with what sampling adds."""
    acting = sampled.acting(from_text(stage.law), [from_text(v) for v in stage.estimates])
    return forms_of(sampled.loop, stage.region.numbers(), acting)


def failed_sampled_adaptive(system: System, proof: SampledAdaptiveProof) -> str:
    """Empty if the proof holds for the system, exactly, else what fails."""
    try:
        with within_floats():
            sampled = SampledAdaptiveLoop(system)
            reason, known = failed_invariant(sampled, proof.invariant)
            if known is None:
                return reason
            row = proof.exact_row
            if len(row) != sampled.loop.size:
                return "the row of the law's rate does not have the shape of the loop"
            pace = known.interval_of(row)
            for stage in proof.stages:
                if reason := failed_region(sampled.loop, sampled.ranges, known, stage.region):
                    return reason
                numbers, stated = stage.region.numbers(), _pair_of(stage.pace)
                if not (stated[0] < pace[0] and pace[1] < stated[1]):
                    return "a stage's pace does not hold what was proven before"
                paces = sampled.motion.paces(numbers, Near(row, stated))
                if reason := failed_mismatch(sampled, stage, paces):
                    return reason
                forms, rows = sampled_forms(sampled, stage), rows_of(sampled.loop, numbers)
                for function in stage.functions:
                    if reason := failed_part(forms, function, [*rows, row]):
                        return reason
                known = after(known, stage.functions, rows)
                pace = pace_after(pace, row, known, stage.functions)
            claimed_bound(proof.stages)
    except NoCertificate as refusal:
        return str(refusal)
    return ""
