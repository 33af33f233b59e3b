"""What is optimised or limited: positive numbers of a candidate, and their gradients."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
import sympy

from certrack.certificates.arithmetic import decimal
from certrack.certificates.estimates.dual import SemidefiniteEstimate, semidefinite_estimate
from certrack.certificates.estimates.loop_data import PlainLoop
from certrack.certificates.estimates.peak_gains import PeakEstimate, peak_estimate
from certrack.certificates.formulation import error_problem, problem_of_design
from certrack.certificates.problem import ErrorProblem
from certrack.core.errors import CertrackError
from certrack.core.expressions import symbol
from certrack.core.powers import put_in
from certrack.laws.adaptive import Adaptive
from certrack.systems.system import System
from certrack.tuning.candidate import DIFFERENCE, Candidate


class Quantity(ABC):
    """A positive number of a candidate; inf where it does not exist.

    Attributes
    ----------
    name : str
        As the table of limits calls it.
    """

    name: ClassVar[str]

    @abstractmethod
    def value(self, candidate: Candidate) -> float:
        """The number."""

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        """Gradient of its logarithm by v; by central differences if a class has nothing better."""
        pairs = [(self.value(above), self.value(below)) for above, below in candidate.neighbours]
        return np.array([logarithm(a) - logarithm(b) for a, b in pairs]) / (2 * DIFFERENCE)


#: Logarithm of what does not exist: far beyond every limit, and still a number for the optimiser.
NO_VALUE = 50.0


def logarithm(value: float) -> float:
    """log of a positive number, within what an optimiser can calculate with."""
    if not value < math.inf:
        return NO_VALUE
    return max(math.log(value), -NO_VALUE) if value > 0 else -NO_VALUE


def log_of(quantity: Quantity, candidate: Candidate) -> float:
    """log of a quantity; :data:`NO_VALUE` where gains are so extreme that nothing is computed."""

    def value() -> float:
        try:
            with np.errstate(all="ignore"):
                return logarithm(quantity.value(candidate))
        except BEYOND_FLOATS:
            return NO_VALUE

    return candidate.once((quantity, "log"), value)


def slope_of(quantity: Quantity, candidate: Candidate) -> np.ndarray:
    """Gradient of the same; zero there."""
    try:
        with np.errstate(all="ignore"):
            return np.nan_to_num(quantity.log_gradient(candidate), posinf=0.0, neginf=0.0)
    except BEYOND_FLOATS:
        return np.zeros(len(candidate.v))


#: What is raised where gains are so extreme that numbers leave the range of floats.
BEYOND_FLOATS = (CertrackError, ArithmeticError, ValueError, np.linalg.LinAlgError)


class PeakGainError(Quantity):
    """The certified error of a law with known parameters: peak gains, with their gradient."""

    name = "error"

    def __init__(self, system: System) -> None:
        self._loop, self.programs = PlainLoop.of(system), 0
        self._last: tuple[Candidate, PeakEstimate] | None = None

    def value(self, candidate: Candidate) -> float:
        return self._estimate(candidate).bound

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        estimate = self._estimate(candidate)
        if estimate.gradient is None:
            return np.zeros(len(candidate.v))
        slopes = []
        for above, below in candidate.neighbours:
            high, low = (self._loop.with_design(point.design) for point in (above, below))
            change = estimate.gradient.along(high, low)
            slopes.append(change / (2 * DIFFERENCE * estimate.bound))
        return np.array(slopes)

    def _estimate(self, candidate: Candidate) -> PeakEstimate:
        if self._last is None or self._last[0] is not candidate:
            self.programs += 1
            problem = self._loop.with_design(candidate.design)
            self._last = candidate, peak_estimate(problem)
        return self._last[1]


class SemidefiniteError(Quantity):
    """The certified error of a law with estimates: the semidefinite program, and its dual.

    Its decay rate is a variable of the search: one program gives the bound and the gradient.
    """

    name = "error"

    def __init__(self, system: System) -> None:
        self._template = error_problem(system, decimal)
        self._uncertainty, self.programs = system.plant.uncertainty, 0
        q = system.controller.coordinates.q
        self._bounds = system.reference.bounds(q + 1).values
        self._last: tuple[Candidate, SemidefiniteEstimate | None] | None = None

    def value(self, candidate: Candidate) -> float:
        estimate = self._estimate(candidate)
        return math.inf if estimate is None else estimate.bound

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        estimate = self._estimate(candidate)
        if estimate is None:
            return np.zeros(len(candidate.v))
        return np.append(estimate.log_gradient, estimate.by_log_share)

    def problem(self, candidate: Candidate) -> ErrorProblem:
        """The error system of a candidate."""
        law, known = candidate.law, self._template.adaptation
        assert isinstance(law, Adaptive) and known is not None
        r = len(known.theta0)
        adaptation = replace(
            known,
            gain_rate=law.gain_rate,
            leak_gain=law.leak_gain,
            leak_theta=law.leak_theta,
            Gamma=np.diag(np.array(law.Gamma or (), dtype=float)).reshape(r, r),
        )
        return problem_of_design(
            candidate.design, self._uncertainty, self._bounds.__getitem__, adaptation, decimal
        )

    def _estimate(self, candidate: Candidate) -> SemidefiniteEstimate | None:
        if self._last is None or self._last[0] is not candidate:
            self.programs += 1
            pairs = [
                (self.problem(above), self.problem(below))
                for above, below in candidate.neighbours[:-1]
            ]
            share = math.exp(candidate.v[-1])
            estimate = semidefinite_estimate(self.problem(candidate), share, pairs, DIFFERENCE)
            self._last = candidate, estimate
        return self._last[1]


class NoiseGain(Quantity):
    """||dK_u/dx||: how much input a unit of noise on all states makes, at rest in the origin."""

    name = "noise"

    def __init__(self, system: System) -> None:
        plant, truth = system.plant, system.truth
        exact = {symbol(name): value for name, value in plant.constant_values.items()}
        total = put_in(plant.drift.expr, exact)
        numbers = plant.theta or truth.theta or ()
        for phi, theta in zip(plant.regressor, numbers, strict=False):
            total += put_in(phi.expr, exact) * float(theta.expr)
        origin = dict.fromkeys(plant.symbols, sympy.S.Zero)
        slopes = [sympy.diff(total, x).subs(origin) for x in plant.symbols]
        numbers_at_rest = [complex(v) if v.is_number else complex("nan") for v in slopes]
        self._slopes = np.nan_to_num(np.real(numbers_at_rest))
        gain = plant.input_gain or truth.input_gain
        self._gain = abs(float(gain.expr)) if gain is not None else 1.0

    def value(self, candidate: Candidate) -> float:
        feedback = candidate.design.nu_x - self._slopes
        return float(np.linalg.norm(feedback)) / self._gain


class Largest(Quantity):
    """The largest of several quantities of one name."""

    def __init__(self, quantities: Sequence[Quantity]) -> None:
        self._quantities = quantities

    @property
    def name(self) -> str:  # type: ignore[override]
        """Of each."""
        return self._quantities[0].name

    def value(self, candidate: Candidate) -> float:
        return max(quantity.value(candidate) for quantity in self._quantities)

    def log_gradient(self, candidate: Candidate) -> np.ndarray:
        worst = max(self._quantities, key=lambda quantity: quantity.value(candidate))
        return worst.log_gradient(candidate)
