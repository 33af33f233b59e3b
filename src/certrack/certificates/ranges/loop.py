"""The closed loop as a function of the constants, with the law fixed at their nominal values.

The law knows p_0: u = (nu_x x + nu_Y Y' - h(x; p_0) - phi^T theta(p_0))/g_n(p_0), where
Y' = (y_d ... y_d^(q+1)). With h + phi^T theta = sum_k r_k(p) m_k(x) and rho = g_n(p)/g_n(p_0),

    x_i' = g_i(p) x_{i+1} + sum_j b_ij(p) x_j                                          i < n
    x_n' = rho (nu_x x + nu_Y Y') + sum_k [r_k(p) - rho r_k(p_0)] m_k(x)

The brackets are simplified before anything is bounded, so what the law cancels in truth is gone. A
linear m_k goes into the matrix, m = 1 into the offset, a bounded one is one more bounded input, and
an unbounded one is refused. The adaptive law estimates g_n and theta: then rho = 1, and h alone is
left in the brackets. In error coordinates e = A x - B Y of the nominal design

    e' = A Acl A^-1 e + (A Acl A^-1 B | 0) Y' + A Ecl Y' - (0 | B) Y' + A o + ...
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from mpmath import iv, mp

from certrack.certificates.arithmetic import as_sympy, exact_float, rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.formulation import (
    UncertainInputs,
    error_coordinates,
    uncertain_inputs,
)
from certrack.certificates.intervals import enclosure
from certrack.certificates.ranges.formulas import OpenFormulas
from certrack.certificates.ranges.rational import Interval, RationalVector
from certrack.certificates.ranges.sectors import sector_of
from certrack.certificates.scope import refuse_unknown
from certrack.laws.backstepping import ErrorCoordinates
from certrack.laws.error_system import EstimatedParameters
from certrack.references.base import bound_of
from certrack.systems.system import System

#: Symbols of slopes: a dot, so they are the name of no constant.
SLOPE = "sector.slope"


@dataclass(frozen=True)
class RangedLoop:
    """x' = Acl(p) x + Ecl(p) Y' + o(p) + sum_k bracket_k(p) m_k(x) (last row) + uncertain terms.

    Attributes
    ----------
    system : System
    coordinates : ErrorCoordinates
        Of the nominal design, in exact rationals.
    symbols : m symbols
        The constants with a range; for the robust law also g_n and theta, where they have one.
    box : m intervals of rationals
    nominal : m rationals
    still : (n, n + q + 3) SymPy matrix
        (Acl | Ecl | o) without the terms within a sector.
    slopes : pairs (j, bracket * s)
        What the terms within a sector add to entry j of the last row: one for each of the last
        symbols s, which are no constants and vary in time (``sectors``).
    brackets : formulas of the symbols
    sizes : rationals
        sup |m_k(x)| over all x.
    estimated : formulas of g_n and theta, or None
        Of the adaptive law, where the constants determine them; None in the place of one that has a
        range of its own.
    gain_ratio : formula
        rho.
    """

    system: System
    coordinates: ErrorCoordinates
    symbols: tuple[sympy.Symbol, ...]
    box: tuple[Interval, ...]
    nominal: tuple[Any, ...]
    still: sympy.Matrix
    slopes: tuple[tuple[int, sympy.Expr], ...]
    brackets: tuple[sympy.Expr, ...]
    sizes: tuple[Any, ...]
    estimated: tuple[sympy.Expr | None, tuple[sympy.Expr, ...] | None]
    gain_ratio: sympy.Expr

    @property
    def n(self) -> int:
        """Order of the plant."""
        return self.coordinates.n

    @property
    def moving(self) -> int:
        """How many symbols, the last ones, vary in time whatever the constants do."""
        return len(self.slopes)

    @cached_property
    def matrix(self) -> sympy.Matrix:
        """(Acl | Ecl | o) of all symbols, (n, n + q + 3)."""
        matrix = self.still.copy()
        for j, term in self.slopes:
            matrix[self.n - 1, j] += term
        return matrix

    @cached_property
    def Xe(self) -> np.ndarray:
        """A^-1: x = Xe (e + B Y)."""
        return solve(self.coordinates.A, np.eye(self.n, dtype=object))

    @cached_property
    def Y(self) -> tuple[Any, ...]:
        """Bounds of y_d ... y_d^(q+1)."""
        bounds = self.system.reference.bounds(self.coordinates.q + 1).values
        return tuple(exact_float(bound, rational) for bound in bounds)

    def bound_on(self, i: int) -> Any:
        """Y_i alone: what no proof needs is not asked for."""
        return exact_float(bound_of(self.system.reference, i)[0], rational)

    @cached_property
    def uncertain(self) -> UncertainInputs:
        """How the w_k act on e."""
        uncertainty = self.system.plant.uncertainty
        return uncertain_inputs(uncertainty, self.coordinates.A, rational)

    @cached_property
    def entries(self) -> RationalVector:
        """All entries of the matrix, row by row, and the brackets."""
        return RationalVector.of([*self.matrix, *self.brackets], self.symbols)

    def unpacked(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrix (n, n + q + 3) and bracket values from a vector of `entries`."""
        size = self.matrix.shape[0] * self.matrix.shape[1]
        return values[:size].reshape(self.matrix.shape), values[size:]


def ranged_loop(system: System, *, sectors: bool = False) -> RangedLoop:
    """The loop of a system as a function of what has a range.

    Parameters
    ----------
    system : System
    sectors : bool
        Whether nonlinear terms within a sector become numbers that vary in time; otherwise they are
        bounded inputs, and an unbounded one is refused.

    Raises
    ------
    NoCertificate
        If a constant with a range stands where no certificate covers it; the reason names it.
    """
    stated = refuse_unknown(system)
    design = OpenFormulas(system, isinstance(stated, EstimatedParameters))
    coordinates = error_coordinates(system, rational)
    n, q = coordinates.n, coordinates.q
    rho = (
        sympy.S.One
        if design.is_adaptive
        else sympy.cancel(design.gain / design.at_nominal(design.gain))
    )
    matrix = sympy.zeros(n, n + q + 3)
    for i in range(n - 1):
        matrix[i, i + 1] += design.number(f"plant.chain[{i}]", system.plant.chain[i])
        for j, entry in enumerate(system.plant.linear[i] if system.plant.linear else ()):
            matrix[i, j] += design.number(f"plant.linear[{i}][{j}]", entry)
    for j in range(n):
        matrix[n - 1, j] += rho * as_sympy(coordinates.nu_x[j])
    for j in range(q + 2):
        matrix[n - 1, n + j] += rho * as_sympy(coordinates.nu_Y[j])
    brackets, sizes = [], []
    slopes: list[tuple[int, sympy.Expr]] = []
    moving: list[sympy.Symbol] = []
    sector_ends: list[Interval] = []
    states = list(system.plant.symbols)
    for function, coefficient in (design.terms() if design.symbols else {}).items():
        bracket = sympy.cancel(sympy.together(coefficient - rho * design.at_nominal(coefficient)))
        if bracket == 0:
            continue
        if function == 1:
            matrix[n - 1, n + q + 2] += bracket
        elif function in states:
            matrix[n - 1, states.index(function)] += bracket
        elif sectors and (sector := sector_of(function, states)) is not None:
            slope = sympy.Symbol(f"{SLOPE}[{len(slopes)}]", real=True)
            moving.append(slope)
            sector_ends.append(sector[1:])
            slopes.append((sector[0], bracket * slope))
        else:
            brackets.append(bracket)
            sizes.append(_largest(function, states, bracket))
    return RangedLoop(
        system,
        coordinates,
        (*design.symbols, *moving),
        (*design.box, *sector_ends),
        (*design.nominal, *((low + high) / 2 for low, high in sector_ends)),
        matrix,
        tuple(slopes),
        tuple(brackets),
        tuple(sizes),
        design.estimated,
        rho,
    )


def _largest(function: sympy.Expr, states: Sequence[sympy.Symbol], bracket: sympy.Expr) -> Any:
    """Rational not below sup |m(x)| over all x."""
    everywhere = {state: iv.mpf(["-inf", "inf"]) for state in states}
    try:
        size = mp.mpf(abs(enclosure(function, everywhere)).b)
    except (ArithmeticError, ValueError, TypeError):
        size = mp.inf
    if not mp.isfinite(size):
        raise NoCertificate(
            f"{function} is unbounded, and the law cancels it only where {bracket} is zero; what "
            "is bounded, or a state times something bounded, is covered; narrow plant.ranges to "
            "the constants that do not move it, or use the adaptive law"
        )
    return exact_float(float(size), rational)  # exactly: mpmath's ends have 53 bits


@dataclass(frozen=True)
class ErrorForm:
    """e' = M e + W Y' + w + columns for w_k, in exact rationals; y^(i) not scaled.

    Attributes
    ----------
    M : (n, n) array
    W : (n, q+2) array
        Of y_d ... y_d^(q+1).
    offset : (n,) array
    brackets : values of the brackets
    """

    M: np.ndarray
    W: np.ndarray
    offset: np.ndarray
    brackets: np.ndarray


def error_form(loop: RangedLoop, values: np.ndarray) -> ErrorForm:
    """The error system for one vector of entries."""
    c, n = loop.coordinates, loop.n
    matrix, brackets = loop.unpacked(values)
    AM = c.A @ matrix[:, :n]
    M = AM @ loop.Xe
    W = c.A @ matrix[:, n:-1]
    W[:, :-1] = W[:, :-1] + M @ c.B
    W[:, 1:] = W[:, 1:] - c.B
    return ErrorForm(M, W, c.A @ matrix[:, -1], brackets)
