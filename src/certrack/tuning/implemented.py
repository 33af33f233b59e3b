"""The certified error of the loop as a drive runs it, as an objective."""

from __future__ import annotations

import math

import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.estimate import Estimate, estimate_implemented
from certrack.laws.base import Law
from certrack.model.implementation import Implementation
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.quantities import Quantity, logarithm

#: Step of the differences, in logarithms of gains: well above the roundings of the fixed point.
IMPLEMENTED_DIFFERENCE = 1e-4


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
        return difference_quotients(self, candidate)


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
        return difference_quotients(self, candidate)


def difference_quotients(quantity: Quantity, candidate: Candidate) -> np.ndarray:
    """The gradient of a quantity of the implemented loop."""
    slopes = []
    for step in IMPLEMENTED_DIFFERENCE * np.eye(len(candidate.v)):
        high, low = (
            quantity.value(Candidate(candidate.family, candidate.base, candidate.v + sign * step))
            for sign in (1, -1)
        )
        slopes.append((logarithm(high) - logarithm(low)) / (2 * IMPLEMENTED_DIFFERENCE))
    return np.array(slopes)
