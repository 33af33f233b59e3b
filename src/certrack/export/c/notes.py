"""What the user of exported C should know of it."""

from __future__ import annotations

import numpy as np

from certrack.core.expressions import TIME
from certrack.laws.leakage import leak_matrix
from certrack.simulation.implementation_notes import implementation_notes
from certrack.systems.system import System

#: Below this part of itself per sample, leakage is lost in the rounding of float.
STALLING_SHARE = 1e-4

#: The last whole number that float can count to.
FLOAT_COUNT = 2**24


def notes_for(system: System, real: str) -> tuple[str, ...]:
    """Notes on the code of a system with numbers of type `real`; usually none."""
    notes = implementation_notes(system)
    if real == "double":
        return notes
    return (*notes, *_time_notes(system), *_leak_notes(system))


def _time_notes(system: System) -> tuple[str, ...]:
    """A law that knows the time counts its samples, and float counts so far only."""
    implementation, formulas = system.implementation, system.controller.equations.formulas
    assert implementation is not None
    if not any(formula.has(TIME) for formula in formulas.values()):
        return ()
    hours = FLOAT_COUNT * implementation.period / 3600
    return (
        f"in float, the time of this law stands still after {hours:.1f} h: samples are counted up "
        f"to {FLOAT_COUNT}. Use --real double if it runs longer.",
    )


def _leak_notes(system: System) -> tuple[str, ...]:
    share = _leak_share(system)
    if not share < STALLING_SHARE:
        return ()
    stall = float(np.finfo(np.float32).eps) / 2 / share
    return (
        f"in float, estimates stall up to {stall:.1g} (relative) short of where leakage takes "
        f"them: it changes them by only {share:.1g} of themselves per sample. Use --real double "
        "or a longer period if that matters.",
    )


def _leak_share(system: System) -> float:
    """Part of itself by which leakage changes the slowest estimate per sample; inf without."""
    implementation = system.implementation
    assert implementation is not None
    rates = np.abs(np.diag(leak_matrix(system.controller)))
    return float(rates[rates > 0].min(initial=np.inf) * implementation.period)
