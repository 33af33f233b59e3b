"""The search for a kept set as large as possible, and for the stages on what is reached from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.bootstrap.box import Region, TextPair, interval_of
from certrack.certificates.bootstrap.forms import Forms, forms_of
from certrack.certificates.bootstrap.polynomial_stages import shrunk
from certrack.certificates.bootstrap.program import BootstrapProgram, Minimiser
from certrack.certificates.bootstrap.proof import prove_function, row_over_box
from certrack.certificates.bootstrap.rates import Rate
from certrack.certificates.bootstrap.regions import (
    FREE_DIGITS,
    WIDER,
    Reached,
    first_box,
    next_region,
    rational_float,
    rows_of,
    wider_texts,
)
from certrack.certificates.bootstrap.search import (
    FIRST_TRIES,
    LATER_TRIES,
    MOST_GROUPS,
    MOST_STAGES,
    Group,
    functions_on,
    starting_rates,
    sweep_of,
)
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, decimal_text, float_down, float_up, from_text
from certrack.certificates.sampled_adaptive.mismatch import Near
from certrack.certificates.sampled_adaptive.paces import Paces, image, least_law
from certrack.certificates.sampled_adaptive.proof import (
    InvariantSet,
    SampledAdaptiveLoop,
    SampledAdaptiveProof,
    SampledStage,
    failed_invariant,
    failed_limits,
    in_invariant_set,
    least_room,
    pace_after,
)
from certrack.core.progress import Progress, silent

#: Boxes that are tried for the kept set, as parts of the one that the continuous law reaches: from
#: the largest on, each so much smaller than the one before; and shapes that are tried of each.
LARGEST_PART, SMALLER_BOX, BOXES, SHAPES = 8.0, 0.75, 12, 3

#: A next shape is wider than what the function reaches on the one before by this part; a shape that
#: grows by more than the second in one direction is given up.
WIDER_SHAPE, WILD = 0.02, 1.5

#: A level is lower than the one that touches the box by this part.
BELOW_END = 1e-3

#: Decay rates of W that are tried, as parts of that of the continuous law's first proof.
RATE_PARTS = (0.7, 1.2, 2.0)

#: What is added to what sampling adds, relatively, so that another rounding confirms it.
SAMPLING_ROOM = rational("1e-6")

#: The iteration ends when no interval shrinks by more than this part, with a sweep.
WORTH_ONE_MORE = 0.002

#: Why there is none where nothing more is known.
NOTHING_KEPT = (
    "no set of starts is kept by the sampled loop: sample more often, or lower the delay or tau"
)

#: Bisections of the size of the starts, and their digits.
START_STEPS, STARTS_DIGITS = 12, 4


def prove_sampled_adaptive(
    sampled: SampledAdaptiveLoop, first: Proof, progress: Progress = silent
) -> SampledAdaptiveProof:
    """The kept set, and the stages on what is reached from it.

    Parameters
    ----------
    sampled : SampledAdaptiveLoop
    first : Proof
        A bound on e_n of the continuous law: where to look for the set.
    progress : callable
        Gets the bound so far, as its last argument.

    Raises
    ------
    NoCertificate
        If there is none.
    """
    loop = sampled.loop
    invariant = _invariant(sampled, first)
    reason, known = failed_invariant(sampled, invariant)
    if known is None:
        raise NoCertificate(reason)
    middle = sampled.motion.middle_row(invariant.region.numbers())
    texts = tuple(f"{v:.{FREE_DIGITS}g}" for v in middle)
    row = np.array([from_text(v) for v in texts])
    pace = known.interval_of(row)
    rates: dict[Group, Rate] = {}
    starts = starting_rates(loop, float(from_text(first.alpha)))
    starts.append(max(starts))  # that of the row
    stages: list[SampledStage] = []
    sweep, stalled = sweep_of(loop, first), False
    for count in range(MOST_STAGES):
        tries = LATER_TRIES if count else FIRST_TRIES
        region = next_region(loop, sampled.ranges, known)
        stated = wider_texts(*pace, WIDER)
        exact = from_text(stated[0]), from_text(stated[1])
        law, estimates = _stated(sampled, sampled.motion.paces(region.numbers(), Near(row, exact)))
        acting = sampled.acting(from_text(law), [from_text(v) for v in estimates])
        functions, later = functions_on(
            loop,
            region,
            acting,
            known,
            rates,
            starts,
            tries,
            sweep if stalled else (),
            1 if stalled else MOST_GROUPS,
            () if stalled else (row,),
        )
        gain = shrunk(known, later)
        if functions:
            stages.append(SampledStage(region, stated, law, estimates, functions))
            known, pace = later, pace_after(pace, row, later, functions)
            progress(0, None, max(map(abs, known.box[0].astype(float))))
        if stalled and gain < WORTH_ONE_MORE:
            break
        stalled = gain < WORTH_ONE_MORE
    return SampledAdaptiveProof(invariant, texts, tuple(stages))


def _stated(sampled: SampledAdaptiveLoop, paces: Paces) -> tuple[str, tuple[str, ...]]:
    """Texts above what sampling adds on a box."""
    law = _above(least_law(sampled.held, paces))
    _, estimates = image(sampled.loop, sampled.held, paces, from_text(law))
    return law, tuple(map(_above, estimates))


def _above(ball: Any) -> str:
    """A decimal text clearly above a ball."""
    value = rational_float(float(ball.upper())) * (1 + SAMPLING_ROOM) + rational("1e-30")
    return decimal_text(float_up(value))


def _invariant(sampled: SampledAdaptiveLoop, first: Proof) -> InvariantSet:
    """The largest set that is found."""
    outer, why, refused = first_box(sampled.loop, first).box, "", ""
    scale = LARGEST_PART
    for _ in range(BOXES):
        box = outer * rational(scale)
        for _ in range(SHAPES):
            try:
                best, box, reason = _invariant_on(sampled, first, box)
            except NoCertificate as refusal:
                best, box, reason, refused = None, None, "", str(refusal)
            else:
                why, refused = reason or why, NOTHING_KEPT
            if best is not None:
                return best
            if box is None:
                break
        scale *= SMALLER_BOX
    raise NoCertificate(why or refused)


def _invariant_on(
    sampled: SampledAdaptiveLoop, first: Proof, box: np.ndarray
) -> tuple[InvariantSet | None, np.ndarray | None, str]:
    """A set inside a box; else a box to try next, if it is promising, and why there is none."""
    loop = sampled.loop
    region = _of_box(sampled, box)
    numbers = region.numbers()
    paces = sampled.motion.paces(numbers)
    law, estimates = _stated(sampled, paces)
    acting = sampled.acting(from_text(law), [from_text(v) for v in estimates])
    floats = forms_of(loop.in_floats(), numbers.in_floats(), acting.astype(float))
    rows = rows_of(loop, numbers)[: loop.size]
    wanted = tuple(product(range(loop.size), (1, -1)))
    asked = np.array([row_over_box(floats, side * rows[i].astype(float)) for i, side in wanted])
    program, best, most = BootstrapProgram(floats, len(wanted)), None, np.inf
    for part in RATE_PARTS:
        solution = program.solve(part * float(from_text(first.alpha)), asked)
        if solution is not None:
            exceeded = _exceeded(solution, numbers.box.astype(float))
            if exceeded < most:
                best, most = solution, exceeded
    if best is None:
        return None, None, ""
    if most > 1 - BELOW_END:
        return None, _next_shape(best, numbers.box.astype(float)), ""
    if reason := failed_limits(sampled.held, paces):
        return None, None, reason
    forms = forms_of(loop, numbers, acting)
    function = prove_function(
        forms, _widest(best, wanted, floats.middle, floats.radius), wanted, rows
    )
    if function is None:
        return None, None, ""
    room = least_room(sampled, forms, function, paces)
    if room is None:
        return None, None, "the period is too long for the delay"
    invariant = InvariantSet(region, law, estimates, function, _above(room), (), ())
    larger = _with_starts(sampled, forms, invariant)
    if larger is None:
        return None, None, "the priors of the estimates are too far from what they are of"
    return larger, None, ""


def _of_box(sampled: SampledAdaptiveLoop, box: np.ndarray) -> Region:
    """What a stage on a box stands on."""
    region = next_region(sampled.loop, sampled.ranges, Reached(box))
    numbers = region.numbers()
    low, high = interval_of(numbers.linear_row(sampled.loop), numbers.box)
    return replace(region, row=wider_texts(low, high, WIDER))


def _reached_ends(solution: Minimiser) -> np.ndarray:
    """What a function reaches of each error."""
    pairs = (solution.bounds * solution.sizes).reshape(-1, 2)
    return np.stack([-pairs[:, 1], pairs[:, 0]], axis=1)


def _exceeded(solution: Minimiser, box: np.ndarray) -> float:
    """Which part of the way from the middle to the end of the box a function reaches."""
    middle, radius = box.mean(axis=1), np.diff(box, axis=1)[:, 0] / 2
    return float((np.abs(_reached_ends(solution) - middle[:, None]) / radius[:, None]).max())


def _next_shape(solution: Minimiser, box: np.ndarray) -> np.ndarray | None:
    """A box a little larger than what is reached; None if that is far beyond the one before."""
    reached = _reached_ends(solution)
    middle, radius = reached.mean(axis=1), np.diff(reached, axis=1)[:, 0] / 2
    if (radius > WILD * np.diff(box, axis=1)[:, 0] / 2).any():
        return None
    radius = radius * (1 + WIDER_SHAPE)
    ends = np.stack([middle - radius, middle + radius], axis=1)
    return np.array([[rational(float(v)) for v in row] for row in ends], dtype=object)


def _widest(
    solution: Minimiser, wanted: Sequence[tuple[int, int]], middle: np.ndarray, radius: np.ndarray
) -> Minimiser:
    """The same function with the highest level whose set is in the box: W - c decays as W does.

    Where zeta = centre + what spreads, the largest zeta_i on the set is centre_i and the root of
    level times spread_i; and that root over twice the level is how often W counts in its proof.
    """
    G = solution.unknowns.G.copy()
    size = len(G) - 1
    centre = -np.linalg.solve(G[:size, :size], G[:size, -1])
    spread = np.diag(np.linalg.inv(G[:size, :size]))
    level = -float(G[-1, -1] + G[-1, :size] @ centre)
    most = float(((1 - BELOW_END - np.abs(centre)) ** 2 / spread).min())
    G[-1, -1] -= most - level
    half = np.sqrt(most * spread)
    scales = np.array([radius[i] * half[i] / (2 * most) for i, _ in wanted])
    bounds = np.array(
        [side * (middle[i] + radius[i] * centre[i]) + radius[i] * half[i] for i, side in wanted]
    )
    unknowns = replace(solution.unknowns, G=G)
    return replace(solution, unknowns=unknowns, sizes=scales, bounds=bounds / scales)


def _with_starts(
    sampled: SampledAdaptiveLoop, forms: Forms, invariant: InvariantSet
) -> InvariantSet | None:
    """With boxes of starts that are proven to be in the set: of the errors, and of the estimates.

    Of its shape and as large as possible, around the estimates of the file, or else the priors.
    """
    for centre in (sampled.estimates, sampled.priors):
        low, high, best = 0.0, 1.0, None
        for step in range(START_STEPS + 1):
            tried = 0.0 if step == 0 else (low + high) / 2
            errors, priors = _scaled_starts(sampled, forms, centre, tried)
            larger = replace(invariant, starts=errors, priors=priors)
            if in_invariant_set(sampled, forms, larger):
                low, best = tried, larger
            elif best is None:
                break
            else:
                high = tried
        if best is not None:
            return best
    return None


def _scaled_starts(
    sampled: SampledAdaptiveLoop, forms: Forms, centre: Sequence[Any], part: float
) -> tuple[tuple[str, ...], tuple[TextPair, ...]]:
    sizes, n = forms.radius.astype(float), sampled.loop.n
    errors = tuple(_short_down(part * size) for size in sizes[:n])
    spreads = [from_text(_short_down(part * size)) for size in (sizes[-1], *sizes[n:-1])]
    pairs = [
        (decimal_text(float_down(mid - spread)), decimal_text(float_up(mid + spread)))
        for mid, spread in zip(centre, spreads, strict=True)
    ]
    return errors, tuple(pairs)


def _short_down(value: float) -> str:
    """A short decimal text that is not above a number >= 0."""
    text = f"{value:.{STARTS_DIGITS}g}"
    return text if from_text(text) <= rational(value) else f"{value * (1 - 1e-3):.{STARTS_DIGITS}g}"
