"""The error where constants have ranges: of the worst of their corners, as an objective.

At a corner the loop is linear with known constants, and its peak gains are nearly what happens
there. A certificate of all constants between is not below the largest of them, and comes near it
with cells; it is computed once, of the result.
"""

from __future__ import annotations

import numpy as np

from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.estimates.ranged_loop import CornerLoop, corner_loops
from certrack.certificates.ranges.certify import range_prover
from certrack.laws.base import Law
from certrack.systems.system import System
from certrack.tuning.candidate import DIFFERENCE, Candidate
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
        self._corners = corner_loops(range_prover(system).loop)
        self._worst: dict[Law, tuple[float, CornerLoop]] = {}

    def value(self, candidate: Candidate) -> float:
        return self._worst_corner(candidate)[0]

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        bound, corner = self._worst_corner(candidate)
        gradient = peak_estimate(corner.with_design(candidate.design)).gradient
        if gradient is None:
            return np.zeros(len(candidate.v))
        changes = [
            gradient.along(corner.with_design(above.design), corner.with_design(below.design))
            for above, below in candidate.neighbours
        ]
        return np.array(changes) / (2 * DIFFERENCE * bound)

    def _worst_corner(self, candidate: Candidate) -> tuple[float, CornerLoop]:
        if candidate.law not in self._worst:
            self.programs += 1
            bounds = [
                peak_estimate(corner.with_design(candidate.design), gradient=False).bound
                for corner in self._corners
            ]
            worst = int(np.argmax(bounds))
            self._worst[candidate.law] = bounds[worst], self._corners[worst]
        return self._worst[candidate.law]
