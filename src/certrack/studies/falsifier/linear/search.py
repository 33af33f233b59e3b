"""The worst case of a linear error loop, found by kernels and linear programs, and simulated."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.premises import refuse_unknown
from certrack.certificates.ranges.loop import RangedLoop, ranged_loop
from certrack.integrators.base import Outcome
from certrack.laws.error_system import EstimatedParameters
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.linear.ascent import worst_inputs
from certrack.studies.falsifier.linear.case import written_case
from certrack.studies.falsifier.linear.continuous import continuous_chain
from certrack.studies.falsifier.linear.corners import worst_corners
from certrack.systems.system import System

#: Corners whose worst inputs are computed and simulated.
CANDIDATES = 3


@dataclass(frozen=True)
class LinearCase:
    """A worst case of a linear loop.

    Attributes
    ----------
    estimate : float
        |e_1| at the end, by the linear loop.
    system : System
        Replays it.
    run : Run
    error : float
        Tail error of the run; inf if it escapes, 0 if it ends before the tail.
    """

    estimate: float
    system: System
    run: Run
    error: float


def continuous_case(system: System, bounds: tuple[float, ...]) -> LinearCase | None:
    """The worst case of the continuous loop at constant parameters.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_{q+1}

    Returns
    -------
    LinearCase, or None for a law whose loop is not linear, or where nothing is found.
    """
    loop = linear_error_loop(system)
    if loop is None or not all(map(math.isfinite, bounds)):
        return None
    found = []
    for point in worst_corners(loop, bounds, CANDIDATES):
        chain = continuous_chain(loop, point, bounds)
        worst = None if chain is None else worst_inputs(chain)
        if worst is not None:
            found.append((worst, values_at(loop, point)))
    if not found:
        return None
    worst, values = max(found, key=lambda pair: pair[0].error)
    odd = not loop.brackets and all(entry == 0 for entry in loop.matrix[:, -1])
    senses = (1,) if odd else (1, -1)
    cases = (written_case(system, worst, values, sense) for sense in senses)
    return max(played(cases, worst.error), key=lambda case: case.error)


def linear_error_loop(system: System) -> RangedLoop | None:
    """The error loop as a function of the constants; None where it is not linear."""
    try:
        with within_floats():
            if isinstance(refuse_unknown(system), EstimatedParameters):
                return None
            return ranged_loop(system)
    except NoCertificate:
        return None


def values_at(loop: RangedLoop, point: tuple[Any, ...]) -> dict[str, Any]:
    """The values of what has a range, as texts of fractions by name."""
    return {str(name): str(value) for name, value in zip(loop.symbols, point, strict=True)}


def played(cases: Iterator[System], estimate: float) -> list[LinearCase]:
    """The cases, simulated."""
    return [
        LinearCase(estimate, case, run, tail_error(run))
        for case in cases
        for run in [simulate(case)]
    ]


def tail_error(run: Run) -> float:
    """Tail error of a run; inf if it escapes, 0 if it ends before the tail."""
    if run.outcome is Outcome.escaped:
        return math.inf
    error = float(run.metrics.tail_error)
    return 0.0 if math.isnan(error) else error
