"""A design as a table shows it: certified, searched for, simulated."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.implemented.certify import KIND
from certrack.certificates.methods import METHOD_NAMES
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.loops.stability import linear_loop
from certrack.model.distribution import Distribution
from certrack.model.implementation import Implementation
from certrack.simulation.simulator import simulate
from certrack.studies.ensembles.ensemble import ensemble
from certrack.studies.falsifier.falsify import falsify
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.certified import certified, certified_or_why
from certrack.tuning.companion import companion, is_memoryless
from certrack.tuning.quantities import NoiseGain
from certrack.tuning.responses import Grid
from certrack.tuning.runs import corners
from certrack.tuning.sampled_responses import input_plant
from certrack.tuning.stability import StabilityEdge

#: Runs of the falsifier; members of the ensemble that looks for a larger peak than the corners';
#: grid of the exact peak, over that of the search.
FALSIFIED_RUNS, PEAK_MEMBERS, REFINED = 200, 200, 4

#: Steps that a measurement reports, by name: those of the certificate, what its effort ``fast``
#: leaves out, the falsifier, and what is simulated.
STEP_NAMES = (
    *METHOD_NAMES,
    "loop as the drive runs it",
    "cells or bootstrap",
    "falsifier",
    "simulation",
)
MEASURING_STEPS = len(STEP_NAMES)

#: What a peak input is: computed for all starts, the largest that was found, or of one run.
COMPUTED, FOUND, SIMULATED = (
    "over the box of starts",
    "the largest found from the box of starts",
    "simulated from the file's start",
)


@dataclass(frozen=True)
class ContinuousFigures:
    """What is proven and found of a design's continuous law.

    Attributes
    ----------
    certified : float
        inf if there is no verified bound.
    worst_found : float or None
    """

    certified: float
    worst_found: float | None


@dataclass(frozen=True)
class Measured:
    """Figures of one design.

    Attributes
    ----------
    certified : float
        The best verified bound of limsup |e_1|; inf if there is none.
    method : str
        Of that certificate.
    worst_found : float or None
        The worst |e_1| that the falsifier found, of the loop that is certified.
    tail_error, energy, input_variation : float
        Of the file's own run.
    peak_input : float
        Largest |u| from the box of starts, or from the file's start where there is none.
    peak_is : str
        :data:`COMPUTED`, :data:`FOUND` or :data:`SIMULATED`.
    continuous_only : str
        With ``[implementation]``: why the certificate is of the continuous law; empty if it is not.
    starts : str
        From which starts the certificate is, in words; empty for all.
    continuous : ContinuousFigures or None
        Where one of the designs compared is certified as the drive runs it and the other is not:
        what both have.
    noise : float
        ||dK_u/dx||.
    period : float or None
        Longest period at which the held loop is stable, exact; None for a nonlinear loop.
    """

    certified: float
    method: str
    worst_found: float | None
    tail_error: float
    peak_input: float
    energy: float
    input_variation: float
    noise: float
    period: float | None
    peak_is: str
    continuous_only: str = ""
    starts: str = ""
    continuous: ContinuousFigures | None = None

    @property
    def of_drive(self) -> bool:
        """Whether the certificate is of the loop as the drive runs it."""
        return self.method == KIND

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        entries = asdict(self)
        return {"found" if name == "worst_found" else name: v for name, v in entries.items()}


def figures_of(
    system: System,
    box: np.ndarray | None,
    seed: int,
    effort: str = "fast",
    progress: Progress = silent,
) -> Measured:
    """The figures of a system; `progress` gets steps, their number and the bound so far."""
    proven = certified_or_why(
        system,
        effort=effort,
        progress=lambda step, _, bound: progress(step, MEASURING_STEPS, bound),
    )
    best = proven.best
    bound = best.bound if best.exists else None
    progress(MEASURING_STEPS - 2, MEASURING_STEPS, bound)
    worst = _falsified(system, seed, best.kind == KIND)
    progress(MEASURING_STEPS - 1, MEASURING_STEPS, bound)
    metrics = simulate(system).metrics
    candidate = _Fixed(system)
    return Measured(
        certified=best.bound if best.verified else math.inf,
        method=best.kind if best.verified else "",
        worst_found=worst,
        tail_error=metrics.tail_error,
        peak_input=metrics.peak_input if box is None else box_peak(system, box, seed),
        energy=metrics.input_energy,
        input_variation=metrics.input_variation,
        noise=NoiseGain(system).value(candidate),
        period=_exact_edge(system, candidate),
        peak_is=SIMULATED if box is None else COMPUTED if input_plant(system) else FOUND,
        continuous_only=proven.why_continuous,
        starts=proven.starts if best.verified else "",
    )


def alike(
    first: tuple[System, Measured],
    second: tuple[System, Measured],
    seed: int,
    effort: str = "fast",
    progress: Progress = silent,
) -> tuple[Measured, Measured]:
    """The figures of two designs, with those of the continuous law where only it is in both.

    A bound of the loop as the drive runs it is larger than that of its continuous law, so a column
    of the one beside a column of the other would show a gain that is none.

    Parameters
    ----------
    first, second : pairs (System, Measured)
    seed : int
        Of the falsifier.
    effort : {"fast", "default", "high"}
    progress : callable
        Gets what :func:`~certrack.certify` reports.
    """
    if len({figures.of_drive for _, figures in (first, second) if figures.method}) < 2:
        return first[1], second[1]
    both = []
    for system, figures in (first, second):
        continuous = ContinuousFigures(figures.certified, figures.worst_found)
        if figures.of_drive:
            plain = system.replace(implementation=None)
            best = certified(plain, effort=effort, progress=progress)
            bound = best.bound if best.verified else math.inf
            continuous = ContinuousFigures(bound, _falsified(plain, seed, as_implemented=False))
        both.append(replace(figures, continuous=continuous))
    return both[0], both[1]


#: Of a design whose measurement was interrupted.
UNMEASURED = Measured(
    certified=math.nan,
    method="",
    worst_found=None,
    tail_error=math.nan,
    peak_input=math.nan,
    energy=math.nan,
    input_variation=math.nan,
    noise=math.nan,
    period=None,
    peak_is=SIMULATED,
)


class _Fixed(Candidate):
    """A system as it stands, as a candidate: its damping counts, too."""

    def __init__(self, system: System) -> None:
        self.base, self.v, self._known = system, np.zeros(0), {}
        self.__dict__ |= {"law": system.law, "design": system.controller.coordinates}
        self.__dict__ |= {"system": system}


def box_peak(system: System, box: np.ndarray, seed: int) -> float:
    """The largest |u| over a box of starts: exact for a linear loop without disturbance.

    Otherwise the largest of the corners and of an ensemble of starts in the box, with the
    disturbances of the file.
    """
    plant = input_plant(system)
    if is_memoryless(system.law):
        system = system.replace(implementation=None)
    if plant is not None:
        centre, radius = box.mean(axis=1), (box[:, 1] - box[:, 0]) / 2
        grid = Grid.of(system, REFINED)
        return plant.response(_Fixed(system), grid, centre, radius).peak
    peaks = [simulate(system, x0=tuple(corner)).metrics.peak_input for corner in corners(box)]
    starts = tuple(Distribution("uniform", tuple(ends)) for ends in box)
    population = replace(system.varied, x0=starts, disturbance="file", estimates=None)
    members = ensemble(system.replace(population=population), members=PEAK_MEMBERS, seed=seed)
    largest = members.statistics.metrics["peak_input"].summary()["max"]
    finite = [peak for peak in (*peaks, largest) if peak is not None]
    return float(max(finite)) if len(finite) == len(peaks) + 1 else math.inf


def _falsified(system: System, seed: int, as_implemented: bool) -> float | None:
    """Of the loop that is certified: the continuous one, or that of the drive."""
    try:
        attack = falsify(system, budget=FALSIFIED_RUNS, seed=seed, effort="fast")
    except InputError:
        return None  # a truth with states of its own, or names that the search needs
    if as_implemented:
        return None if attack.drive is None else attack.drive.worst_error
    return attack.worst_error


def _exact_edge(system: System, candidate: Candidate) -> float | None:
    if system.implementation is None:
        system = companion(system).replace(implementation=Implementation(1e-3))
    drive, loop = system.implementation, linear_loop(system)
    if loop is None or drive is None:
        return None
    guess = 1 / system.controller.fastest_pole
    return StabilityEdge(loop, guess, float(drive.run_delay)).first(candidate)
