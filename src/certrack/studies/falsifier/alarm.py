"""Is a run beyond the certificate? Then a premise is broken, or something is wrong here.

A bound on limsup |e_1| says nothing of a transient, so a run is held against the certified *tube*
from its own start, at every time. A bound without a tube of its own, by peak gains, is granted for
the start what the tube of the quadratic proof grants: the distance of its square from its floor.
Where there is no tube at all, the file's own run, which may be short, is run on until nothing is
left of its start; other cases begin where the error is zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from certrack.certificates import Certificate, NoCertificate, Proof
from certrack.certificates.assumption_1 import VIOLATION_TOLERANCE, uncertain_terms
from certrack.certificates.methods import BOOTSTRAP, QUADRATIC_KINDS
from certrack.certificates.online.certify import OnlineProof
from certrack.certificates.online.tube import tube_of
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.sampling import Points
from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.references import SymbolicReference
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.loop import slowest_time_constant
from certrack.systems.system import System

#: Excess over the tube that the integrator may cause, over the tolerance of the run, relative to
#: the largest |x_1|.
RUN_ROUNDING = 100.0

#: So many of the slowest time constants leave nothing of a start: e^-40 is 4e-18 of it.
START_FORGOTTEN = 40.0

PREMISE, DEFECT = "premise", "defect"


@dataclass(frozen=True)
class Alarm:
    """A run beyond a verified bound.

    Attributes
    ----------
    kind : {"premise", "defect"}
    reason : str
    """

    kind: str
    reason: str


def alarm(
    system: System,
    case: System,
    run: Run,
    against: Certificate,
    stages: tuple[Proof, ...] | tuple[OnlineProof, ...],
) -> Alarm | None:
    """The alarm that a run raises, or None.

    Parameters
    ----------
    system : System
        The certified one.
    case : System
        What was run: the same with other disturbance, reference and true parameters.
    run : Run
    against : Certificate
        The best verified one.
    stages : tuple of Proof
        The proof of a tube.
    """
    if not _beyond(system, case, run, against, stages):
        return None
    return why_beyond(system, case, run)


def why_beyond(system: System, case: System, run: Run) -> Alarm:
    """The alarm of a run that is beyond what is proven: which premise is broken, or none.

    Parameters
    ----------
    system : System
        The certified one.
    case : System
        What was run.
    run : Run
    """
    file_omega = case.truth.omega == system.truth.omega
    for premise in contradicted(premises(system)):
        if file_omega or not premise.name.startswith("w_"):
            return Alarm(PREMISE, f"{premise.name}: {premise.detail}; {premise.remedy}")
    broken = broken_on_the_way(case, run)
    if broken:
        return Alarm(PREMISE, broken)
    return Alarm(
        DEFECT,
        "every premise holds as far as it was looked at: certrack itself is wrong; please report "
        "this file",
    )


def _beyond(
    system: System,
    case: System,
    run: Run,
    against: Certificate,
    stages: tuple[Proof, ...] | tuple[OnlineProof, ...],
) -> bool:
    """Whether |e_1| passes the tube from the run's start; or the bound, without a tube."""
    if run.outcome in (Outcome.escaped, Outcome.undefined):
        return True
    error = np.abs(run.e[0])
    slack = RUN_ROUNDING * case.settings.tolerance * max(1.0, float(np.abs(run.x[0]).max()))
    late = run.t >= case.settings.tail_start
    if not np.any(error[late] > against.bound + slack):
        return False
    if not stages:
        return not _is_own(system, case) or _beyond_in_the_long_run(case, against)
    try:
        around = tube_of(_within_bounds(system, case), stages)
    except (NoCertificate, InputError):
        return True
    limit = around(run.t)
    if against.kind not in (*QUADRATIC_KINDS, BOOTSTRAP):  # its stages take their time, too
        from_start = np.sqrt(np.maximum(limit**2 - around.floor, 0.0))
        limit = np.minimum(limit, against.bound + from_start)
    return bool(np.any(error > limit + slack))


def _is_own(system: System, case: System) -> bool:
    """Whether a case is the file's own, which begins anywhere and may be short."""
    return case.reference == system.reference and case.truth.omega == system.truth.omega


def _beyond_in_the_long_run(case: System, against: Certificate) -> bool:
    """Whether |e_1| passes the bound where nothing is left of the start."""
    settings, forgotten = case.settings, START_FORGOTTEN * slowest_time_constant(case)
    run = simulate(case.with_settings(duration=forgotten + settings.duration, tail=forgotten))
    if run.outcome is not Outcome.finished:
        return True
    slack = RUN_ROUNDING * settings.tolerance * max(1.0, float(np.abs(run.x[0]).max()))
    return run.metrics.tail_error > against.bound + slack


def _within_bounds(system: System, case: System) -> System:
    """The case, its reference bounded as the certified one: the proof is for these bounds."""
    reference = case.reference
    if not isinstance(reference, SymbolicReference) or reference == system.reference:
        return case
    order = system.controller.coordinates.q + 1
    bounds = system.reference.bounds(order).values
    return case.replace(reference=replace(reference, declared=bounds))


def broken_on_the_way(case: System, run: Run) -> str:
    """Where the run's own omega leaves Assumption 1, in words; empty if nowhere."""
    for term in uncertain_terms(case):
        points = Points(run.t, run.x)
        excess = term.excess(points) / (1 + term.limit(points))
        i = int(np.argmax(excess))
        if excess[i] > VIOLATION_TOLERANCE and math.isfinite(excess[i]):
            return (
                f"{term.name} leaves Assumption 1 on this run, at t = {run.t[i]:.4g}: tau "
                f"|{term.name}| = {float(term.size(points)[i]):.6g} > "
                f"{float(term.limit(points)[i]):.6g}"
            )
    return ""
