"""x(0), the reference and the input at t = 0 of runs from a start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import flint

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.balls import ball_of
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.regional import is_regional
from certrack.certificates.implemented.start import Starts
from certrack.certificates.start import reference_at_start, states_at_start
from certrack.references.base import jumps
from certrack.systems.system import System

#: What a start proof is of, and which references at t = 0 it covers.
X0, POLYTOPE = "x0", "polytope"
FILE_PHASE, ANY_PHASE = "file", "any"


def phase_of(system: System, drive: Drive, of: str) -> str:
    """Whether y_d(0) ... counts as the file has it: it must be known, and no member differ.

    A box of starts is for any reference where it is all that is claimed.
    """
    population = system.varied
    varied = (
        is_regional(system) or population.amplitude is not None or population.frequency is not None
    )
    known = reference_at_start(system, drive.q)[1]
    return FILE_PHASE if known and not (of == POLYTOPE and varied) else ANY_PHASE


def start_set_of(
    system: System, drive: Drive, phase: str, region: Sequence[tuple[str, str]]
) -> Starts:
    """x(0) and what else is there at t = 0.

    Raises
    ------
    NoCertificate
        If the start is not one that is covered.
    """
    implementation = system.implementation
    assert implementation is not None
    if implementation.offset:
        raise NoCertificate("the first sample is not at t = 0")
    if drive.jitter:
        raise NoCertificate("with jitter nothing is proven of starts")
    x0, known = states_at_start(system)
    if not known:
        raise NoCertificate("the states at t = 0 are not known exactly")
    center, half = x0, [flint.arb(0)] * drive.n
    if region:
        ends = [(ball_of(float(low)), ball_of(float(high))) for low, high in region]
        center = [(low + high) / 2 for low, high in ends]
        half = [(high - low) / 2 for low, high in ends]
    Y = tuple(reference_at_start(system, drive.q)[0]) if phase == FILE_PHASE else None
    size, apart = _jumps(system, drive)
    initial = ball_of(implementation.initial_input) - drive.offset
    return Starts(tuple(center), tuple(half), Y, initial, size, apart)


def _jumps(system: System, drive: Drive) -> tuple[Any | None, int | None]:
    """Size of the jumps of y_d^(q+1), and the least periods between two; None for one or none."""
    if drive.jumps is not None:
        return drive.jumps[0], drive.periods_between_jumps
    jumping = jumps(system.reference, drive.q + 1) if drive.jumps_once else None
    return (None, None) if jumping is None else (exact_float(jumping[0], rational), None)
