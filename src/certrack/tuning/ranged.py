"""The error where constants have ranges: of the worst of their corners, as an objective.

At a corner the loop is linear with known constants, and its peak gains are nearly what happens
there. A certificate of all constants between is not below the largest of them, and comes near it
with cells; it is computed once, of the result.
"""

from __future__ import annotations

import math

import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.estimates.loop_data import in_plant_coordinates
from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.ranges.certify import range_prover
from certrack.laws.base import Law
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.quantities import Quantity


class RangedError(Quantity):
    """The largest error at the corners of the ranges, of a law with known parameters.

    Raises
    ------
    NoCertificate
        If no certificate can cover the ranges.
    """

    name = "error"

    def __init__(self, system: System) -> None:
        self.programs = 0
        self._errors: dict[Law, float] = {}
        prover = range_prover(system)
        prover.problems(prover.box)

    def value(self, candidate: Candidate) -> float:
        if candidate.law not in self._errors:
            self.programs += 1
            self._errors[candidate.law] = self._error(candidate.system)
        return self._errors[candidate.law]

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        before = self.programs
        gradient = super().log_gradient(candidate)
        self.programs = before  # an evaluation is one with its gradient
        return gradient

    def _error(self, system: System) -> float:
        try:
            prover = range_prover(system)
            problems = [problem.in_floats() for problem in prover.problems(prover.box)]
        except NoCertificate:
            return math.inf
        bounds = [
            peak_estimate(in_plant_coordinates(problem), gradient=False).bound
            for problem in problems
        ]
        return max(bounds)
