"""Limits of the input, and where to look for starts from which they are never met."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.start import FromStarts
from certrack.core.rounding import in_digits
from certrack.systems.system import System

#: Digits of the ends of a region that is not the file's.
REGION_DIGITS = 3

#: What a state adds to the input counts as this part of what another one does, at least, where a
#: region is looked for.
LEAST_SHARE_OF_STATE = 1e-2


@dataclass(frozen=True)
class InputLimits:
    """Limits of u without the constant of the law, and of its steps; large numbers for none."""

    low: Any
    high: Any
    step: Any

    def hold(self, size: Any, step: Any) -> bool:
        """Whether |u| <= size and |u_k - u_{k-1}| <= step are within them."""
        return bool(self.low <= -size and size <= self.high and step <= self.step)


#: Stands for no limit.
NO_LIMIT = 10**9


def input_limits(system: System, drive: Drive) -> InputLimits:
    """The limits of a system's input."""
    implementation = system.implementation
    assert implementation is not None
    low, high, step = rational(-NO_LIMIT), rational(NO_LIMIT), rational(NO_LIMIT)
    if implementation.saturation is not None:
        low, high = (rational(v) - drive.offset for v in implementation.saturation)
    if implementation.rate_limit is not None:
        step = rational(implementation.rate_limit) * drive.T
    return InputLimits(low, high, step)


def is_limited(system: System) -> bool:
    """Whether the file limits the input or its rate."""
    drive = system.implementation
    return drive is not None and (drive.saturation is not None or drive.rate_limit is not None)


def region_of(
    system: System, drive: Drive, frame: Callable[[], FromStarts]
) -> tuple[tuple[str, str], ...]:
    """Where starts are looked at: the ensemble's box and x0, or where one state alone may be.

    Parameters
    ----------
    system : System
    drive : Drive
    frame : callable
        Its result has rows of the input and its steps.

    Raises
    ------
    NoCertificate
        If the states of the starts are not those of the design.
    """
    if system.truth.states:
        raise NoCertificate("the simulated plant has states of its own")
    x0, drawn = system.settings.x0, system.varied.x0
    if drawn is not None:
        return tuple(
            (repr(min(entry.low, v)), repr(max(entry.high, v)))
            for entry, v in zip(drawn, x0, strict=True)
        )
    limits = input_limits(system, drive)
    room = np.array([float(limits.high - limits.low) / 2, float(limits.step)])
    magnitudes = np.abs(frame().gains.before.value[:, -2:, : drive.n]).max(axis=0)
    least = LEAST_SHARE_OF_STATE * magnitudes.max(axis=1, keepdims=True)
    reach = np.min(room[:, None] / np.maximum(magnitudes, least), axis=0)
    half = [max(in_digits(v, REGION_DIGITS), abs(x)) for v, x in zip(reach, x0, strict=True)]
    return tuple((repr(-v), repr(v)) for v in half)
