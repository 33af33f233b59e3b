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
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from mpmath import iv, mp

from certrack.certificates.arithmetic import exact_float, rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.formulation import (
    UncertainInputs,
    error_coordinates,
    uncertain_inputs,
)
from certrack.certificates.intervals import enclosure
from certrack.certificates.ranges.rational import Interval, RationalVector
from certrack.certificates.ranges.sectors import sector_of
from certrack.certificates.scope import refuse_unknown
from certrack.core.expressions import Expression, parse, symbol
from certrack.laws.backstepping import ErrorCoordinates
from certrack.laws.error_system import EstimatedParameters
from certrack.model.ranges import open_constants
from certrack.references.base import bound_of
from certrack.systems.system import System

#: Symbols of ranges that no constant stands for: a dot, so they are the name of none.
RANGED_GAIN, RANGED_THETA = "ranges.input_gain", "ranges.theta"


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
    matrix : (n, n + q + 3) SymPy matrix
        (Acl | Ecl | o).
    brackets : formulas of the symbols
    sizes : rationals
        sup |m_k(x)| over all x.
    estimated : formulas of g_n and theta, or None
        Of the adaptive law, where the constants determine them; None in the place of one that has a
        range of its own.
    moving : int
        So many symbols, the last ones, are no constants: they vary in time (``sectors``).
    """

    system: System
    coordinates: ErrorCoordinates
    symbols: tuple[sympy.Symbol, ...]
    box: tuple[Interval, ...]
    nominal: tuple[Any, ...]
    matrix: sympy.Matrix
    brackets: tuple[sympy.Expr, ...]
    sizes: tuple[Any, ...]
    estimated: tuple[sympy.Expr | None, tuple[sympy.Expr, ...] | None]
    moving: int = 0

    @property
    def n(self) -> int:
        """Order of the plant."""
        return self.coordinates.n

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
    design = _Design(system, isinstance(stated, EstimatedParameters))
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
        matrix[n - 1, j] += rho * _sympy(coordinates.nu_x[j])
    for j in range(q + 2):
        matrix[n - 1, n + j] += rho * _sympy(coordinates.nu_Y[j])
    brackets, sizes = [], []
    slopes: list[tuple[sympy.Symbol, Interval]] = []
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
            slope = sympy.Symbol(
                f"slope.{len(slopes)}", real=True
            )  # a dot: the name of no constant
            slopes.append((slope, sector[1:]))
            matrix[n - 1, sector[0]] += bracket * slope
        else:
            brackets.append(bracket)
            sizes.append(_largest(function, states, bracket))
    return RangedLoop(
        system,
        coordinates,
        (*design.symbols, *(slope for slope, _ in slopes)),
        (*design.box, *(ends for _, ends in slopes)),
        (*design.nominal, *((low + high) / 2 for _, (low, high) in slopes)),
        matrix,
        tuple(brackets),
        tuple(sizes),
        design.estimated,
        len(slopes),
    )


def untrue_formulas(system: System) -> list[str]:
    """What of g_n and theta, of those that a proof takes, is not the truth's formula of the ranges.

    Members of an ensemble draw the constants; their g_n and theta are those of the truth.
    """
    if system.truth.states:
        return []
    plant, truth = system.plant, system.truth
    design = _Design(system, isinstance(refuse_unknown(system), EstimatedParameters))
    gain, theta = design.gain, design.theta
    names = []
    if plant.input_gain_range is None and sympy.cancel(
        gain - design.true_number("truth.input_gain", truth.input_gain)
    ):
        names.append("input_gain")
    for i, value in enumerate(theta):
        stated = plant.theta_range is not None
        if not stated and sympy.cancel(
            value - design.true_number(f"truth.theta[{i}]", truth.theta[i])
        ):
            names.append(f"theta[{i}]")
    return names


class _Design:
    """The plant's formulas with the ranged constants left open."""

    def __init__(self, system: System, is_adaptive: bool) -> None:
        plant = system.plant
        self.system, self.is_adaptive = system, is_adaptive
        self.symbols = tuple(symbol(name) for name, _, _ in plant.constant_ranges)
        self.box: tuple[Interval, ...] = tuple(
            (rational(low), rational(high)) for _, low, high in plant.constant_ranges
        )
        values = [plant.constant_values[str(s)] for s in self.symbols]
        self._constants = {symbol(name): value for name, value in plant.open_values.items()}
        self.gain = self._used(plant.input_gain, "input_gain")
        self.theta = [
            self._used(value, "theta", i)
            for i, value in enumerate(plant.theta or (None,) * plant.r)
        ]
        if not self.is_adaptive:
            values += self._open_gain_and_theta()
        self.nominal = tuple(map(rational, values))

    def _used(self, known: Expression | None, name: str, i: int = 0) -> sympy.Expr:
        """What the proof takes for g_n or an entry of theta.

        The plant's for a law that knows it, or where it follows the ranges; else the true one.
        """
        if known is not None:
            formula = self.number(f"plant.{name}", known)
            if formula.free_symbols or not self.is_adaptive:
                return formula
        true = getattr(self.system.truth, name)
        true = true[i] if isinstance(true, tuple) and true else true
        if not true:
            raise NoCertificate(
                f"a truth with states of its own has no {name} to be certified for; state "
                f"plant.ranges.{name}, or plant.{name} as a formula of the constants with a range"
            )
        return self.true_number(f"truth.{name}", true)

    def true_number(self, key: str, value: Expression | None) -> sympy.Expr:
        """A number of the truth, with its own constants, as a formula of the ranged ones."""
        assert value is not None
        plant, ranged = self.system.plant, set(self.system.plant.constant_boxes)
        shared = {k: v for k, v in self.system.truth.constants if k in plant.constant_values}
        stated = {k: v for k, v in shared.items() if k not in ranged}
        values = open_constants(dict(plant.constants) | stated, ranged)
        return _rationalised(parse(key, value, values).expr)

    def _open_gain_and_theta(self) -> list[sympy.Expr]:
        """For the robust law, symbols in the place of g_n and theta that have a range."""
        plant, values = self.system.plant, []
        if plant.input_gain_range is not None:
            values.append(self.gain)
            self.gain = self._opened(RANGED_GAIN, plant.input_gain_range)
        if plant.theta_range is not None:
            for i, box in enumerate(plant.theta_range):
                if box[0] == box[1]:
                    continue
                values.append(self.theta[i])
                self.theta[i] = self._opened(f"{RANGED_THETA}[{i}]", box)
        return values

    @property
    def estimated(self) -> tuple[sympy.Expr | None, tuple[sympy.Expr, ...] | None]:
        """What the adaptive law estimates, where the constants determine it."""
        plant = self.system.plant
        return (
            self.gain if plant.input_gain_range is None else None,
            tuple(self.theta) if plant.theta_range is None else None,
        )

    def _opened(self, name: str, box: tuple[float, float]) -> sympy.Symbol:
        new = sympy.Symbol(name, real=True)
        self.symbols += (new,)
        self.box += ((rational(box[0]), rational(box[1])),)
        return new

    def number(self, key: str, value: Expression | None) -> sympy.Expr:
        """A number of the plant as a formula of the ranged constants."""
        assert value is not None
        return _rationalised(parse(key, value, self.system.plant.open_values).expr)

    def at_nominal(self, expr: sympy.Expr) -> sympy.Expr:
        """The formula at the nominal constants."""
        return expr.xreplace(
            {s: _sympy(v) for s, v in zip(self.symbols, self.nominal, strict=True)}
        )

    def terms(self) -> dict[sympy.Expr, sympy.Expr]:
        """h + phi^T theta (h alone for the adaptive law) as functions of x with coefficients."""
        plant, states = self.system.plant, self.system.plant.symbols
        total = plant.drift.expr.xreplace(self._constants)
        for phi, theta in zip(plant.regressor, self.theta, strict=False):
            formula = phi.expr.xreplace(self._constants)
            self._refuse_open(formula, "plant.regressor")
            total += formula * (0 if self.is_adaptive else theta)
        coefficients: dict[sympy.Expr, sympy.Expr] = {}
        for term in sympy.Add.make_args(sympy.expand(total)):
            coefficient, function = term.as_independent(*states, as_Add=False)
            self._refuse_open(function, "plant.drift")
            coefficients[function] = coefficients.get(function, sympy.S.Zero) + _rationalised(
                coefficient
            )
        return coefficients

    def _refuse_open(self, function: sympy.Expr, where: str) -> None:
        inside = [str(s) for s in self.symbols if s in function.free_symbols]
        if inside:
            raise NoCertificate(
                f"{inside[0]} has a range and stands inside a nonlinear function of {where}, "
                f"{function}; no certificate covers that"
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
            f"{function} is unbounded, and the law cancels it only where {bracket} is zero; "
            "narrow plant.ranges to the constants that do not move it, or use the adaptive law"
        )
    return exact_float(float(size), rational)  # exactly: mpmath's ends have 53 bits


def _sympy(value: Any) -> sympy.Rational:
    exact = Fraction(str(value))
    return sympy.Rational(exact.numerator, exact.denominator)


def _rationalised(expr: sympy.Expr) -> sympy.Expr:
    """The formula with irrational numbers as the decimal text of their floats."""
    if expr.is_Rational:
        return expr
    if not expr.free_symbols:
        exact = Fraction(repr(float(expr)))
        return sympy.Rational(exact.numerator, exact.denominator)
    return expr.func(*map(_rationalised, expr.args)) if expr.args else expr


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
