"""The plant's formulas with the constants that have a range left open, and their nominal values."""

from __future__ import annotations

import sympy

from certrack.certificates.arithmetic import as_sympy, rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.ranges.rational import Interval
from certrack.certificates.scope import refuse_unknown
from certrack.core.expressions import Expression, parse, symbol
from certrack.laws.error_system import EstimatedParameters
from certrack.model.ranges import open_constants
from certrack.systems.system import System

#: Symbols of ranges that no constant stands for: a dot, so they are the name of none.
RANGED_GAIN, RANGED_THETA = "ranges.input_gain", "ranges.theta"


class OpenFormulas:
    """What a loop is made of, as formulas of the constants with a range.

    Parameters
    ----------
    system : System
    is_adaptive : bool
        Whether the law estimates g_n and theta: then a range of these opens nothing.
    """

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
            {s: as_sympy(v) for s, v in zip(self.symbols, self.nominal, strict=True)}
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
                f"{function}; no certificate covers that: leave its range out, and bound what the "
                "function may differ by with gamma or beta in plant.uncertainty"
            )


def untrue_formulas(system: System) -> list[str]:
    """What of g_n and theta, of those that a proof takes, is not the truth's formula of the ranges.

    Members of an ensemble draw the constants; their g_n and theta are those of the truth.
    """
    if system.truth.states:
        return []
    plant, truth = system.plant, system.truth
    design = OpenFormulas(system, isinstance(refuse_unknown(system), EstimatedParameters))
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


def _rationalised(expr: sympy.Expr) -> sympy.Expr:
    """The formula with irrational numbers as the decimal text of their floats."""
    if expr.is_Rational:
        return expr
    if not expr.free_symbols:
        return as_sympy(float(expr))
    return expr.func(*map(_rationalised, expr.args)) if expr.args else expr
