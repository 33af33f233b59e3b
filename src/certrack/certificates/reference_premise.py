"""The premise of the reference: the bounds of y_d and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from certrack.certificates.premise import ASSUMED, CHECKED, CONTRADICTED, PROVEN, Premise
from certrack.core.errors import InputError
from certrack.core.rounding import rounded_up
from certrack.references import SymbolicReference
from certrack.references.soft_start import long_run
from certrack.systems.system import System

#: Its name in the list of premises.
REFERENCE = "reference"

#: Times at which a declared bound is held against the reference, beyond those of the loader, s.
LATE_TIMES = np.geomspace(1e4, 1e9, 20_001)

#: Relative excess over a declared bound that rounding explains.
BOUND_ROUNDING = 1e-9


def reference_premise(system: System) -> Premise:
    """The bounds Y_0 ... Y_{q+1} that a certificate takes for true."""
    reference, joined = system.reference, long_run(system.reference)
    order = system.controller.coordinates.q + 1
    try:
        bounds = reference.bounds(order)
    except InputError as problem:
        return Premise(REFERENCE, ASSUMED, "bounds of y_d and its derivatives", remedy=str(problem))
    pairs = list(enumerate(zip(bounds.values, bounds.origin, strict=True)))
    detail = ", ".join(
        f"|y_d^({i})| <= {rounded_up(repr(v), 6)} ({origin})" for i, (v, origin) in pairs
    )
    if not type(reference).__module__.startswith("certrack."):
        return Premise(REFERENCE, ASSUMED, f"{detail}, as the reference's own class says")
    declared = [i for i, (_, origin) in pairs if origin == "declared"]
    if not declared:
        return Premise(REFERENCE, PROVEN, detail)
    broken = _beyond(reference, bounds.values, declared)
    if broken is not None:
        i, t, value = broken
        return Premise(
            REFERENCE,
            CONTRADICTED,
            f"|y_d^({i})| = {value:.6g} at t = {t:.6g} s, declared <= {bounds.values[i]:.6g}",
            {"t": t, "value": value, "limit": bounds.values[i]},
            f"state reference.bounds[{i}] for all t >= 0",
        )
    if _proves(joined, joined.bounds(order).values, declared):
        return Premise(REFERENCE, PROVEN, detail)
    return Premise(REFERENCE, CHECKED, f"{detail}; declared ones on samples of t")


def _beyond(
    reference: Any, limits: Sequence[float], declared: Sequence[int]
) -> tuple[int, float, float] | None:
    """A late time at which a declared bound is broken."""
    values = np.abs(reference.values(LATE_TIMES, max(declared)))
    for i in declared:
        above = np.flatnonzero(values[i] > limits[i] * (1 + BOUND_ROUNDING))
        if len(above):
            return i, float(LATE_TIMES[above[0]]), float(values[i][above[0]])
    return None


def _proves(reference: Any, limits: Sequence[float], declared: Sequence[int]) -> bool:
    """Whether the declared bounds are not below what the formula has been proven to keep."""
    if not isinstance(reference, SymbolicReference):
        return False
    try:
        proven_bounds = replace(reference, declared=None, bound=None).bounds(max(declared)).values
    except InputError:
        return False
    return all(proven_bounds[i] <= limits[i] for i in declared)
