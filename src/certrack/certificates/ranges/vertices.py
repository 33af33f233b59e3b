"""Certificates by one quadratic function for a whole box of constants.

The matrices of the error system lie in the hull of finitely many points. With one P and one alpha
and multipliers of its own at every point v, the inequality of :mod:`certrack.certificates.problem`
at each point gives V_v' <= -alpha V + Delta_v; V' is a mean of these, for constants that stand
still and for constants that vary in time alike. So limsup |e_1| <= sqrt(2 max Delta_v/alpha).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import rational
from certrack.certificates.exact import Proof, prove_together
from certrack.certificates.formulation import columns_of
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.ranges.coefficients import Channels, Coefficients, largest_brackets
from certrack.certificates.ranges.loop import ErrorForm, RangedLoop, error_form
from certrack.certificates.ranges.rational import Interval
from certrack.certificates.scaling import Scaling
from certrack.certificates.semidefinite import (
    MAX_ITERATIONS,
    SemidefiniteProgram,
)


@dataclass(frozen=True)
class VertexSolution:
    """A point of the program, in unscaled coordinates; multipliers (lam, nu, k) point by point."""

    alpha: float
    P: np.ndarray
    multipliers: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    lam_units: tuple[np.ndarray, ...]
    delta: float

    @property
    def bound(self) -> float:
        """limsup |e_1| in floating point, not yet verified."""
        return math.sqrt(max(0.0, 2 * self.delta / self.alpha))


class ProblemMaker:
    """Makes the error problems of a loop, in exact rationals."""

    def __init__(self, loop: RangedLoop) -> None:
        self.loop = loop

    def at_points(
        self, box: Sequence[Interval], adaptation: Adaptation | None
    ) -> list[ErrorProblem]:
        """The problem at each point of the hull of a box."""
        return [
            self._problem(error_form(self.loop, values), adaptation)
            for values in self.loop.entries.points(box)
        ]

    def at_centre(
        self, coefficients: Coefficients, box: Sequence[Interval], adaptation: Adaptation | None
    ) -> ErrorProblem:
        """The problem at the centre of a box, with an a-input for each function of the constants.

        |p_k| <= |q_k|, where q_k = C_k x + E_k Y' + d_k, each with a multiplier of its own: for
        many constants, where the hull has too many points.
        """
        channels, brackets = coefficients.over(box), largest_brackets(self.loop, box)
        values = np.concatenate([channels.centre.ravel(), brackets])
        return self._problem(error_form(self.loop, values), adaptation, channels)

    def _problem(
        self, form: ErrorForm, adaptation: Adaptation | None, channels: Channels | None = None
    ) -> ErrorProblem:
        c, n = self.loop.coordinates, self.loop.n
        inputs, none = self.loop.uncertain, np.zeros((0, n + c.q + 3), dtype=object)
        rows = none if channels is None else channels.rows
        Ua = [*inputs.a, *(() if channels is None else (c.A @ channels.columns).T)]
        Ub = [
            *inputs.b,
            *(
                c.A[:, -1] * value * size
                for value, size in zip(form.brackets, self.loop.sizes, strict=True)
                if value != 0
            ),
        ]
        sizes = [*self.loop.Y, rational(1)]
        Uy = [form.W[:, i] * sizes[i] for i in range(c.q + 2)] + [form.offset]
        Xy = [self.loop.Xe @ c.B[:, i] * sizes[i] for i in range(c.q + 1)] + [0 * form.offset] * 2
        through = [rows[:, n + i] * sizes[i] for i in range(c.q + 3)]
        acting = [
            i for i in range(c.q + 3) if _any(Uy[i]) or _any(through[i]) or (Ua and _any(Xy[i]))
        ]
        T = columns_of([through[i] for i in acting], len(rows))
        selected = tuple((rows[k : k + 1, :n], T[k : k + 1]) for k in range(len(rows)))
        return ErrorProblem(
            M=form.M,
            Ua=columns_of(Ua, n),
            Ub=columns_of(Ub, n),
            Uy=columns_of([Uy[i] for i in acting], n),
            Xe=self.loop.Xe,
            Xy=columns_of([Xy[i] for i in acting], n),
            states=inputs.states,
            derivatives=tuple(acting),
            adaptation=adaptation,
            selections=(*(inputs.selections or (None,) * len(inputs.a)), *selected),
        )


def _any(column: np.ndarray) -> bool:
    return any(v != 0 for v in column)


class VertexProgram:
    """One semidefinite program for all points of a hull, built once and solved for many alpha.

    Parameters
    ----------
    problems : ErrorProblem at each point
        In floats.
    target : int
        Which e_i is to be bounded (from 0).
    """

    def __init__(self, problems: Sequence[ErrorProblem], target: int = 0) -> None:
        self.problems, self.target = problems, target
        self._scaling = Scaling.of(problems[0])
        self._parts = [SemidefiniteProgram(problem, target, self._scaling) for problem in problems]
        self._build()

    def _build(self) -> None:
        """Variables: the entries of P, the largest Delta, then the multipliers of each point."""
        entries = self._parts[0].entries
        count = len(entries)
        sizes = [sum(problem.counts) for problem in self.problems]
        total = count + 1 + sum(sizes)
        base, slope, right, cones = [], [], [], []
        start = count + 1
        for part, problem, size in zip(self._parts, self.problems, sizes, strict=True):
            columns = [*range(count), *range(start, start + size)]
            na = problem.counts[0]
            height = len(part.inequality[0])
            here, there = np.zeros((height + size + 1, total)), np.zeros((height + size + 1, total))
            here[:height, columns], there[:height, columns] = part.inequality
            here[height : height + size, start : start + size] = -np.eye(size)
            here[-1, start + na : start + size] = 1.0  # sum nu + sum k <= Delta
            here[-1, count] = -1.0
            base.append(here)
            slope.append(there)
            right.append(np.zeros(height + size + 1))
            cones += [
                clarabel.PSDTriangleConeT(problem.n + size),
                clarabel.NonnegativeConeT(size + 1),
            ]
            start += size
        floor, unit = self._parts[0].floor
        rows = np.zeros((len(floor), total))
        rows[:, :count] = floor[:, :count]
        base.append(rows)
        slope.append(np.zeros_like(rows))
        right.append(unit)
        cones.append(clarabel.PSDTriangleConeT(self.problems[0].n))
        self._base, self._slope = (
            sparse.csc_matrix(np.vstack(base)),
            sparse.csc_matrix(np.vstack(slope)),
        )
        self._right, self._cones = np.concatenate(right), cones
        self._entries, self._sizes = entries, sizes

    @cached_property
    def fastest(self) -> float:
        """Supremum of the alpha for which there may be a certificate, 1/s."""
        return min(part.fastest for part in self._parts)

    def solve(self, alpha: float) -> VertexSolution | None:
        """The solution of least bound with this decay rate (1/s); None if there is none."""
        leak = self.problems[0].leakage(alpha)
        if leak is None:
            return None
        count = len(self._entries)
        cost = np.zeros(self._base.shape[1])
        cost[count] = 1.0
        if self.problems[0].adaptation is not None:
            cost[count - 1] = self._scaling.leak_cost(leak)
        cost /= cost.max()
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter = False, MAX_ITERATIONS
        zero = sparse.csc_matrix((len(cost), len(cost)))
        matrix = (self._base + self._scaling.rate(alpha) * self._slope).tocsc()
        result = clarabel.DefaultSolver(
            zero, cost, matrix, self._right, self._cones, settings
        ).solve()
        usable = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
        return self._unscaled(np.array(result.x), alpha, leak) if result.status in usable else None

    def _unscaled(self, x: np.ndarray, alpha: float, leak: Any) -> VertexSolution:
        scaling, count = self._scaling, len(self._entries)
        P = scaling.unscaled_P(self._entries, x[:count], self.target)
        delta = x[count] * scaling.sizes[self.target] ** 2 / scaling.time
        multipliers, start = [], count + 1
        for problem, size in zip(self.problems, self._sizes, strict=True):
            values = x[start : start + size]
            multipliers.append(scaling.unscaled_multipliers(problem, values, self.target))
            start += size
        if self.problems[0].adaptation is not None:
            delta += float(P[-1, -1] * leak)
        units = tuple(scaling.lam_units(problem, self.target) for problem in self.problems)
        return VertexSolution(alpha, P, tuple(multipliers), units, float(delta))


def prove_vertices(
    problems: Sequence[ErrorProblem], solution: VertexSolution, target: int = 0
) -> tuple[Proof, ...] | None:
    """Round a solution so that exact arithmetic confirms it at every point; None if it does not.

    Returns
    -------
    one Proof per point
        They share P, alpha and the bound, the largest of all points.
    """
    return prove_together(problems, solution, solution.multipliers, solution.lam_units, target)
