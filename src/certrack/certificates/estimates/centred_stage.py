"""The centred stage in floats, for any gains, and what moves it: the set that is reached before.

Its data are those of the stage before but for the bound on zeta, which is that of a set
e^T P e <= E^2: they change with a gain, with E, and with P. The first program has many optimal P
where a part of P acts on no active constraint; the largest of them has the smallest set, and a
small reward for P in units of itself singles it out. Its gradient follows from the equations of the
optimum, differentiated implicitly (:func:`.last_digits.optimality_residual`): with F(x, z; v) = 0,

    d(x, z) = -(dF/d(x, z))^-1 dF
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.certificates.centred import CentredProblems, bounds_needed
from certrack.certificates.estimates.last_digits import optimality_residual, optimality_slopes
from certrack.certificates.estimates.recentred import about_itself, inverse_root
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.semidefinite import ProgramPoint, SemidefiniteProgram
from certrack.core.expressions import symbol
from certrack.core.magnitudes import largest_magnitudes
from certrack.core.powers import put_in
from certrack.laws.backstepping import ErrorCoordinates
from certrack.systems.system import System

#: A design as this stage needs it: its error system and its recursion.
StageDesign = tuple[ErrorProblem, ErrorCoordinates]

#: What P in units of itself is worth, as a part of the cost: that is larger by about its square,
#: gradients err by up to its size, for these units count as fixed.
SIZE_REWARD = 1e-5

#: Rounds: the first is in units of the solver's P, which is not unique; the last in its own.
REWARD_ROUNDS = 2

#: A solution counts if its residual is no more than this part of the reward.
REWARD_SEEN = 1e-2

#: An error system, and the decay rate it is looked at with, 1/s.
Rated = tuple[ErrorProblem, float]


@dataclass(frozen=True)
class CentredStage:
    """The centred problems of one plant and reference, for any gains of an adaptive law.

    Attributes
    ----------
    drift : sympy.Expr
    regressor : tuple of sympy.Expr
    states : tuple of sympy.Symbol
    Y : tuple of float
        Bounds of y_d ... y_d^(q+1).
    """

    drift: sympy.Expr
    regressor: tuple[sympy.Expr, ...]
    states: tuple[sympy.Symbol, ...]
    Y: tuple[float, ...]

    @classmethod
    def of(cls, system: System) -> CentredStage:
        """Those of `system` with other gains.

        Raises
        ------
        NoCertificate
            If its reference has not all bounds.
        """
        plant = system.plant
        exact = {symbol(name): value for name, value in plant.constant_values.items()}
        Y = bounds_needed(system, system.controller.coordinates.q)
        regressor = tuple(put_in(phi.expr, exact) for phi in plant.regressor)
        drift = put_in(plant.drift.expr, exact)
        return cls(drift, regressor, tuple(plant.symbols), tuple(map(float, Y)))

    def problems(self, design: StageDesign, P: np.ndarray, bound: float) -> CentredProblems:
        """Those of a design, on the set e^T P e <= bound^2; of floats, so nothing is proven."""
        problem, coordinates = design
        remainder = self.remainder(design, P, bound)
        centred = CentredProblems.of_design(problem, coordinates, list(self.Y), remainder)
        return centred.in_floats()

    def remainder(self, design: StageDesign, P: np.ndarray, bound: float) -> float:
        """The bound on |h - phi^T theta_tilde| there; inf where nothing is known."""
        problem, coordinates = design
        law = problem.adaptation
        assert law is not None
        try:
            spreads = np.diagonal(problem.Xe @ np.linalg.solve(P, problem.Xe.T))
        except np.linalg.LinAlgError:
            return math.inf
        if not (spreads >= 0).all():  # P is lost in roundings: no set at all
            return math.inf
        offsets = np.abs(problem.Xe @ coordinates.B) @ np.array(self.Y[: coordinates.q + 1])
        radii = bound * np.sqrt(spreads) + offsets
        box = {
            state: (np.array([-radius]), np.array([radius]))
            for state, radius in zip(self.states, radii, strict=True)
        }
        errors = bound * np.sqrt(np.diagonal(law.Gamma).astype(float) / P[-1, -1])
        try:
            total = largest_magnitudes(self.drift, box, 1)[0]
            for phi, error in zip(self.regressor, errors, strict=False):
                total += largest_magnitudes(phi, box, 1)[0] * error
        except TypeError:  # a function without a rule
            return math.inf
        return float(total)


@dataclass(frozen=True)
class ReachedSet:
    """e^T P e <= bound^2 in the long run, with P the largest, and what it is when gains move.

    Attributes
    ----------
    P : (n, n) array
    bound : float
        Of limsup |e_n|.
    moved : list of pairs (P, bound)
        A step above and below, for each pair of changed problems.
    """

    P: np.ndarray
    bound: float
    moved: list[tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]]]

    @classmethod
    def of(
        cls, rated: Rated, changed: Sequence[tuple[Rated, Rated]] = (), step: float = 1.0
    ) -> ReachedSet | None:
        """That of a problem and its decay rate; None if there is none, or no largest P.

        Parameters
        ----------
        rated : Rated
        changed : pairs of Rated
            With each parameter a step above and below.
        step : float
            Of these.
        """
        problem, alpha = rated
        target = problem.n - 1
        program = SemidefiniteProgram(problem, target)
        point = program.point(alpha)
        if point is None:
            return None
        cost, reward = point.cost, np.zeros_like(point.cost)
        for _ in range(REWARD_ROUNDS):
            reward = _reward(program, replace(point, cost=cost))
            point = about_itself(program, replace(point, cost=cost - reward), alpha)
        here = program.numbers(alpha)
        assert here is not None
        unit = float(cost.max() / (here[0].max() or 1.0))
        P, bound = _set_of(program, rated, point.x)
        sizes = problem.n + sum(problem.counts), problem.n
        optimum = (point.cost, *here[1:]), sizes, point.x, point.z
        left = np.linalg.norm(optimality_residual(*optimum))
        if not (bound > 0 and left <= REWARD_SEEN * np.linalg.norm(reward)):
            return None
        slopes = optimality_slopes(*optimum)

        def residual(of: Rated) -> np.ndarray:
            numbers = SemidefiniteProgram(of[0], target, program.scaling).numbers(of[1])
            if numbers is None:
                return np.full(len(slopes), np.nan)
            moved = numbers[0] * unit - reward, *numbers[1:]
            return optimality_residual(moved, sizes, point.x, point.z)

        pairs = []
        for above, below in changed:
            change = _balanced_solution(slopes, (residual(below) - residual(above)) / 2)[
                : len(point.x)
            ]
            pair = (
                _set_of(program, above, point.x + change),
                _set_of(program, below, point.x - change),
            )
            pairs.append(pair)
        return cls(P, bound, pairs)


def _reward(program: SemidefiniteProgram, point: ProgramPoint) -> np.ndarray:
    """For each variable: a part of the cost times the mean of T^T P T, which is I at the point.

    In the program's units entries of P differ by powers of ten from plant to plant, and a reward
    that is nothing for one outweighs the cost of another.
    """
    free = program.target
    T = inverse_root(program.parts(point.x)[0][:free, :free])
    weights = SIZE_REWARD * float(point.cost @ point.x) / free * (T @ T.T)
    reward = np.zeros_like(point.cost)
    for k, (i, j) in enumerate(program.entries):
        if j < free:
            reward[k] = weights[i, j] * (1 if i == j else 2)
    return reward


def _set_of(program: SemidefiniteProgram, rated: Rated, x: np.ndarray) -> tuple[np.ndarray, float]:
    """P and the bound that variables of a program make of a problem in its units."""
    problem, alpha = rated
    solution = SemidefiniteProgram(problem, program.target, program.scaling).solution(
        ProgramPoint(x, np.zeros(0), np.zeros(0)), alpha
    )
    return solution.P, solution.bound


def _balanced_solution(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solution where rows and columns differ by powers of ten, as entries of P and w do."""
    columns = np.abs(matrix).max(axis=0) + np.finfo(float).tiny
    rows = np.abs(matrix / columns).max(axis=1) + np.finfo(float).tiny
    solution: np.ndarray = np.linalg.solve(matrix / columns / rows[:, None], right / rows) / columns
    return solution
