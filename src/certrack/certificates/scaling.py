"""The units in which the semidefinite program of an error problem is solved."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import lapack, schur

from certrack.certificates.problem import ErrorProblem

#: Part of the inputs' size that is added in every direction when the coordinates are scaled, so
#: that one which no input reaches gets a size, too.
SCALING_FLOOR = 1e-6

#: Steps that find the sizes, and by which factor the last may still change them among each other:
#: a step reaches sizes that differ by 1e3.
SCALING_STEPS, SCALED_ENOUGH = 20, 1.5

#: Where they change among each other by less, they are those of every further step.
SCALED = 1 + 1e-9

#: A scaled input below this is none for the solver, whose accuracy is 1e-8.
NEGLIGIBLE = 1e-14

#: So many bits the solver gets of a number, about 12 digits: the program of a system in other
#: units is then the same one, and not one that differs in what the solver's noise grows from.
KEPT_BITS = 42

#: How much larger than the geometric mean of two rates a scaled coupling may be.
COUPLING = 2.0


@dataclass(frozen=True)
class Scaling:
    """Units in which a program is of order one: e_i = sizes_i e^_i, and time in `time` seconds.

    A can have entries of 1e5, and a state can be an angle in radians or in microns; without this
    the solver sees nothing but the largest.

    Attributes
    ----------
    time : float, s
        In which the slowest pole of the error system decays.
    sizes : (n,) array
        Typical size of each e_i.
    equilibrate : bool
        Whether the solver chooses units of its own besides. Near the best alpha it needs a third
        fewer iterations without; elsewhere, and for the last digits, it is better off with them.
    """

    time: float
    sizes: np.ndarray
    equilibrate: bool = True

    @classmethod
    def of(cls, problem: ErrorProblem) -> Scaling:
        """The natural scaling: the sizes are roots of a Gramian's diagonal, under full inputs.

        How large the a-inputs are, which are bounded by ||x||, shows from the size that the others
        give to x; where there are no others, any size will do.
        """
        slowest = -float(np.linalg.eigvals(problem.M).real.max())
        time = 1 / slowest if slowest > 0 else 1.0
        timed = _timed(problem, time)
        bounded = np.hstack([timed.Ub, timed.Uy])
        sizes = _size_under(timed, bounded) if bounded.any() else np.zeros(problem.n)
        reached = timed.Ua * _reach(problem, sizes)
        return cls(time, _size_under(timed, np.hstack([bounded, reached])))

    def alone(self) -> Scaling:
        """The same without units of the solver's own."""
        return replace(self, equilibrate=False)

    def applied(self, problem: ErrorProblem) -> ErrorProblem:
        """The same problem in these units, with a_k in those of what bounds it.

        Inputs that are lost in the solver's roundings are left out, and the last digits of all
        numbers: they depend on the units. The exact proof has them, and room for them.
        """
        timed, sizes, reach = _timed(problem, self.time), self.sizes, _reach(problem, self.sizes)
        norm_x = _norm(problem.Xe * sizes, problem.Xy)
        selections = tuple(
            None if part is None else (part[0] * (norm_x / r), _divided(part[1], r))
            for part, r in zip(problem.selections, reach, strict=False)
        )
        numbers = {
            "M": timed.M / sizes[:, None] * sizes[None, :],
            "Ua": timed.Ua * reach / sizes[:, None],
            "Ub": timed.Ub / sizes[:, None],
            "Uy": timed.Uy / sizes[:, None],
            "Xe": timed.Xe * sizes[None, :] / norm_x,
            "Xy": timed.Xy / norm_x,
        }
        numbers = {name: _rounded(values) for name, values in numbers.items()}
        for name in ("Ua", "Ub", "Uy", "Xy"):
            numbers[name] = np.where(np.abs(numbers[name]) < NEGLIGIBLE, 0.0, numbers[name])
        return replace(timed, **numbers, selections=selections)

    def rate(self, alpha: float) -> Any:
        """A rate (1/s) in the program's unit of time."""
        return _rounded(alpha * self.time)

    def leak_cost(self, leak: Any) -> Any:
        """What the leakage costs for each unit of the program's last entry of P."""
        return _rounded(leak * self.time / self.sizes[-1] ** 2)

    def unscaled_P(
        self, entries: list[tuple[int, int]], values: np.ndarray, target: int
    ) -> np.ndarray:
        """P in the problem's units, from the entries of a program whose target is of size 1."""
        P = np.zeros((len(self.sizes), len(self.sizes)))
        for (i, j), value in zip(entries, values * self.sizes[target] ** 2, strict=True):
            P[i, j] = P[j, i] = value / (self.sizes[i] * self.sizes[j])
        return P

    def unscaled_multipliers(
        self, problem: ErrorProblem, values: np.ndarray, target: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """lam, nu and k in the problem's units."""
        na, nb, _ = problem.counts
        scaled = np.maximum(values, 0.0) * (self.sizes[target] ** 2 / self.time)
        lam, nu, k = np.split(scaled, [na, na + nb])
        return lam / _reach(problem, self.sizes) ** 2, nu, k

    def lam_units(self, problem: ErrorProblem, target: int) -> np.ndarray:
        """What a lam of 1 in a program is in the problem's units."""
        scale: float = self.sizes[target] ** 2 / self.time
        units: np.ndarray = scale / _reach(problem, self.sizes) ** 2
        return units


def _rounded(values: Any) -> Any:
    """The numbers without their last bits."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2.0**KEPT_BITS) / 2.0**KEPT_BITS, exponent)


def _timed(problem: ErrorProblem, unit: float) -> ErrorProblem:
    """The same problem with rates per `unit` seconds; the estimates' part is scaled as a number."""
    rates = {name: getattr(problem, name) * unit for name in ("M", "Ua", "Ub", "Uy")}
    return replace(problem, **rates)


def _reach(problem: ErrorProblem, sizes: np.ndarray) -> np.ndarray:
    """Typical size of what bounds each a-input, for e_i of these sizes and y_i of 1."""
    norm_x = _norm(problem.Xe * sizes, problem.Xy)
    reach = np.full(problem.counts[0], norm_x)
    for k, part in enumerate(problem.selections):
        if part is not None:
            S, T = part
            through_y = S @ problem.Xy
            reach[k] = _norm(S @ problem.Xe * sizes, through_y if T is None else through_y + T)
    return reach


def _norm(through_e: np.ndarray, through_y: np.ndarray) -> float:
    return math.hypot(float(np.linalg.norm(through_e)), float(np.linalg.norm(through_y))) or 1.0


def _divided(matrix: np.ndarray | None, by: float) -> np.ndarray | None:
    return None if matrix is None else matrix / by


def _size_under(problem: ErrorProblem, inputs: np.ndarray) -> np.ndarray:
    """The sizes, found step by step in units of the last ones.

    In one step an e_i that is 1e8 times smaller than another would drown in the roundings.
    """
    size = np.ones(problem.n)
    if np.linalg.eigvals(problem.M).real.max() >= 0:
        return size
    for _ in range(SCALING_STEPS):
        rates, drive = problem.M / size[:, None] * size, inputs / size[:, None]
        drive = drive @ drive.T
        if not np.isfinite(drive).all():
            raise OverflowError("the squares of the inputs overflow")
        weight = float(np.trace(drive)) or 1.0
        gramian = _gramian_diagonal(rates, drive + SCALING_FLOOR * weight * np.eye(problem.n))
        if not (np.isfinite(gramian).all() and gramian.min() > 0):
            break
        change, before = np.sqrt(gramian), size
        size = _not_slaved(problem.M, size * change)
        moved = size / before
        if change.max() < SCALED_ENOUGH * change.min() or moved.max() < SCALED * moved.min():
            break
    return size


def _gramian_diagonal(M: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Diagonal of the solution X of M X + X M^T = -drive, by the real Schur form."""
    form, basis = schur(M)
    solution, scale, _ = lapack.dtrsyl(form, form, -basis.T @ drive @ basis, tranb="T")
    diagonal: np.ndarray = np.diag(basis @ solution @ basis.T) * scale
    return diagonal


def _not_slaved(M: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The sizes, raised where an e_i only follows another: P, which is near one, must damp both.

    Their coupling must not be much larger than the geometric mean of their rates; where it is so
    in any unit, nothing helps, and their sizes are made equal.
    """
    rates = np.abs(np.diag(M))
    coupling = np.abs(M - np.diag(np.diag(M)))
    limit = np.maximum(COUPLING * np.sqrt(np.outer(rates, rates)), coupling)
    ratio = np.where(coupling > 0, coupling / np.where(limit > 0, limit, 1.0), 0.0)
    for _ in range(len(size)):
        size = np.maximum(size, (ratio * size).max(axis=1))
    return size
