"""Do the limits of the input ever act? Proven from the file's start, or from its box of starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import float_up
from certrack.certificates.implemented.proof import delays
from certrack.certificates.implemented.start import (
    StartBounds,
    StartingLoop,
    bounds_from_start,
    starting_loop,
)
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: What limits of the input mean for a bound.
NO_LIMITS, INACTIVE, MAY_ACT = "none", "inactive", "may act"

#: From which starts the bound is proven.
ANY_START, FROM_X0, FROM_BOX = "any", "x0", "box"


@dataclass(frozen=True)
class InputLimits:
    """What is known of the limits of the input.

    Attributes
    ----------
    status : {"none", "inactive", "may act"}
    starts : {"any", "x0", "box"} or None
        The starts for which that is proven; None where the limits may act.
    detail : str
        In words, for the premise.
    """

    status: str
    starts: str | None
    detail: str


def is_limited(system: System) -> bool:
    """Whether the file limits the input or its rate."""
    drive = system.implementation
    return drive is not None and (drive.saturation is not None or drive.rate_limit is not None)


def input_limits(system: System) -> InputLimits:
    """Whether the limits act from the file's start, or from any in the box of its ensemble.

    The starts are those of the design's states, and references begin as the file's.
    """
    if not is_limited(system):
        return InputLimits(NO_LIMITS, ANY_START, "the input has no limits")
    try:
        with within_floats():
            loops = [starting_loop(system, delay) for delay in delays(system)]
            from_x0 = [bounds_from_start(system, loop=loop) for loop in loops]
            if reason := beyond_limits(system, loops, from_x0):
                return InputLimits(MAY_ACT, None, reason)
            detail = _detail(from_x0)
    except NoCertificate as refusal:
        return InputLimits(MAY_ACT, None, str(refusal))
    if _box_is_inside(system, loops):
        return InputLimits(INACTIVE, FROM_BOX, f"{detail}; nor from any start of ensemble.x0")
    return InputLimits(INACTIVE, FROM_X0, detail)


def _detail(bounds: Sequence[StartBounds]) -> str:
    peak = max(entry.peak_input for entry in bounds)
    return (
        f"from x0, for references that begin as the file's, |u| <= {rounded_up(peak, 4)} for all "
        "time, so its limits never act"
    )


def _box_is_inside(system: System, loops: Sequence[StartingLoop]) -> bool:
    """Whether the limits do not act from any start of the population's box."""
    population = system.population
    if population is None or population.x0 is None or system.truth.states:
        return False
    box = [(entry.low, entry.high) for entry in population.x0]
    if any(abs(end) == float("inf") for pair in box for end in pair):
        return False
    try:
        with within_floats():
            of_box = [bounds_from_start(system, box, loop=loop) for loop in loops]
    except NoCertificate:
        return False
    return not beyond_limits(system, loops, of_box)


def beyond_limits(
    system: System, loops: Sequence[StartingLoop], bounds: Sequence[StartBounds]
) -> str:
    """Empty if the input keeps within its limits for all time, else why it may not."""
    drive = system.implementation
    assert drive is not None
    offset = loops[0].drive.offset
    size = max(float(entry.peaks[-2]) for entry in bounds)
    peak = rounded_up(max(entry.peak_input for entry in bounds), 4)
    if drive.saturation is not None:
        low, high = map(rational, drive.saturation)
        exact = rational(size) if size < float("inf") else None
        if exact is None or not (low <= offset - exact and offset + exact <= high):
            return f"from x0 the input is certified to be within {peak} only"
    if drive.rate_limit is not None:
        step = max(float(entry.peaks[-1]) for entry in bounds)
        most = float_up(rational(drive.rate_limit) * rational(drive.period))
        if not step * (1 + 1e-12) <= most:
            return (
                f"from x0 the input's steps are certified to be within {rounded_up(step, 4)} only"
            )
    return ""
