"""The certified error of the loop as a drive runs it, as an objective."""

from __future__ import annotations

import math

import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.estimate import (
    Estimate,
    Neighbour,
    estimate_implemented,
    estimate_nearby,
)
from certrack.laws.base import Law
from certrack.model.implementation import Implementation
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.quantities import Quantity

#: Step of the differences of the loop's gains, in logarithms of the law's: the bound is made of
#: sums of magnitudes, whose kinks lie close to each other.
IMPLEMENTED_DIFFERENCE = 1e-6


class ImplementedError(Quantity):
    """The bound of the implemented loop, estimated; one estimate takes some 25 ms."""

    name = "error"

    def __init__(self, drive: Implementation) -> None:
        self._drive, self.programs = drive, 0
        self._estimates: dict[Law, Estimate | None] = {}

    def value(self, candidate: Candidate) -> float:
        estimate = self.estimate(candidate)
        return math.inf if estimate is None else estimate.bound

    def estimate(self, candidate: Candidate) -> Estimate | None:
        """All bounds of the implemented loop; None if there are none."""
        if candidate.law not in self._estimates:
            self.programs += 1
            try:
                estimate = estimate_implemented(self.implemented(candidate))
            except NoCertificate:
                estimate = None
            self._estimates[candidate.law] = estimate
        return self._estimates[candidate.law]

    def implemented(self, candidate: Candidate) -> System:
        """The system as the drive runs it."""
        return candidate.base.replace(law=candidate.law, implementation=self._drive)

    def is_verified(self, candidate: Candidate) -> bool:
        """Whether its bound is proven, from the file's start where the input has limits."""
        law = candidate.family.written(candidate.v)
        system = candidate.base.replace(law=law, implementation=self._drive)
        return certify_implemented(system)[0].verified

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        estimate = self.estimate(candidate)
        if estimate is None:
            return np.zeros(len(candidate.v))
        changes = [above.bound - below.bound for above, below in self.nearby(candidate)]
        return np.array(changes) / (2 * IMPLEMENTED_DIFFERENCE * estimate.bound)

    def nearby(self, candidate: Candidate) -> list[tuple[Neighbour, Neighbour]]:
        """For each gain, the bounds a step above and below, from the fixed point in between."""
        estimate = self.estimate(candidate)
        assert estimate is not None

        def at(v: np.ndarray) -> Neighbour:
            moved = Candidate(candidate.family, candidate.base, v)
            return estimate_nearby(self.implemented(moved), estimate)

        def every() -> list[tuple[Neighbour, Neighbour]]:
            steps = IMPLEMENTED_DIFFERENCE * np.eye(len(candidate.v))
            return [(at(candidate.v + step), at(candidate.v - step)) for step in steps]

        return candidate.once((self, "nearby"), every)


class DrivePeak(Quantity):
    """What |u| may reach from the file's start: the nominal peak, and all that is uncertain.

    An estimate of the bound that the proof computes period by period.
    """

    name = "input from x0"

    def __init__(self, nominal: Quantity, error: ImplementedError) -> None:
        self._nominal, self._error = nominal, error

    def value(self, candidate: Candidate) -> float:
        estimate = self._error.estimate(candidate)
        if estimate is None:
            return math.inf
        return self._nominal.value(candidate) + estimate.peak_input

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        if self._error.estimate(candidate) is None:
            return np.zeros(len(candidate.v))
        changes = [
            above.peak_input - below.peak_input for above, below in self._error.nearby(candidate)
        ]
        nominal = self._nominal.value(candidate) * self._nominal.log_gradient(candidate)
        slopes: np.ndarray = nominal + np.array(changes) / (2 * IMPLEMENTED_DIFFERENCE)
        return slopes / self.value(candidate)
