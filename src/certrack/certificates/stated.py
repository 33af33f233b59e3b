"""Does a law obey the error system that it states?

A certificate is a theorem about equations, so what counts is neither the class of a law nor its
name but what it computes. Its formulas are compared with those of the stated system as identities,
by symbolic algebra, with the common parts nu, e_n and phi as symbols; then its numbers with those
of the plant and of the recursion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

from certrack.certificates.arithmetic import as_sympy, rational
from certrack.certificates.certificate import NoCertificate
from certrack.core.expressions import symbol
from certrack.core.once import once
from certrack.core.rationals import float_of
from certrack.laws.base import Law
from certrack.laws.equations import Equations
from certrack.laws.error_system import EstimatedParameters, KnownParameters, OwnErrors
from certrack.laws.integral import INTEGRAL
from certrack.laws.linear import Linear
from certrack.laws.online import first_end, other_end
from certrack.laws.recursion import recursion
from certrack.laws.signals import Signals
from certrack.systems.system import System

#: Why there is no certificate in continuous time of a law with integral action.
INTEGRAL_ACTION = (
    "integral action (law.integral) is covered as implemented only: state [implementation], and a "
    "law of known parameters"
)

#: Why there is no other certificate of a law whose gains move.
GAINS_MOVE = "gains move (law.online): only the certificate online can cover it, in continuous time"

#: Comparisons of formulas that a process remembers.
MAX_COMPARISONS = 64

#: Relative difference from the recursion's numbers that is a rounding and not another design.
SAME_NUMBERS = 1e-9


def stated_error_system(
    system: System, *, integral: bool = False, moving: bool = False
) -> KnownParameters | EstimatedParameters:
    """The error system of the law, which its equations do obey.

    Its gains are exact rationals (as SymPy numbers).

    Parameters
    ----------
    system : System
    integral : bool
        Whether the law may have integral action; what it states is then of the nu that has it.
    moving : bool
        Whether its gains may move; what it states is then of those of ``[law]``.

    Raises
    ------
    NoCertificate
        If the law states none, or does not obey what it states.
    """
    if system.law.integral is not None and not integral:
        raise NoCertificate(INTEGRAL_ACTION)
    if system.law.online is not None:
        if not moving:
            raise NoCertificate(GAINS_MOVE)
        system = first_end_system(system)
    return _compared_with_its_equations(system)


@once
def first_end_system(system: System) -> System:
    """The system with the gains of ``[law]``, which stand still."""
    return _with_gains(system, first_end(system.law))


@once
def other_end_system(system: System) -> System:
    """The system with the gains of ``[law.online]``, which stand still."""
    return _with_gains(system, other_end(system.law))


def _with_gains(system: System, law: Law) -> System:
    settings = replace(system.settings, estimates=None)
    return system.replace(law=law, settings=settings, implementation=None, population=None)


@once
def _compared_with_its_equations(system: System) -> KnownParameters | EstimatedParameters:
    law, plant = system.law, system.plant
    signals = _bare_signals(system)
    stated = law.error_system(signals)
    if law.no_certificate or stated is None or isinstance(stated, OwnErrors):
        raise NoCertificate(
            law.no_certificate
            or "certificates cover laws that state their error system, that of the recursion, "
            f"not {law.kind}"
        )
    equations = law.equations(signals)
    for what in _disagreements(stated, equations, signals):
        raise NoCertificate(_refusal(system, what))
    _compare_controller(system, equations, signals)
    _compare_recursion(system)
    values = _exact_values(signals, law.parameters(plant))
    exact = _with_values(stated, values)
    if isinstance(exact, KnownParameters):
        _compare_parameters(system, exact)
    elif not all(v.is_positive for v in (exact.gain_rate, exact.leak_gain, exact.leak_theta)):
        raise NoCertificate(_refusal(system, "gbar, gbar1 and gbar2 must be positive"))
    return exact


def _bare_signals(system: System) -> Signals:
    """Signals whose nu, e_n and phi are symbols, so that an identity does not look into them."""
    signals = Signals(system.plant, system.law.order(system.plant), short=True)
    signals.phi = tuple(symbol(f"phi_of_x_{i}") for i in range(system.plant.r))
    return signals


def _disagreements(
    stated: KnownParameters | EstimatedParameters, equations: Equations, s: Signals
) -> Iterator[str]:
    """The formulas of a law that are not those of what it states."""
    states = tuple(z for z, _ in equations.update)
    if states != stated.estimates:
        yield "its own states are not the estimates"
        return
    if not identical(equations.u, stated.input(s.nu, s.phi)):
        yield "its u is another"
    rates = stated.rates(s.nu, s.phi, s.e_n, s.sign_g)
    for (z, rate), expected in zip(equations.update, rates, strict=True):
        if not identical(rate, expected):
            yield f"the rate of {z} is another"


def identical(formula: Any, expected: sympy.Expr) -> bool:
    """Whether two formulas are the same by symbolic algebra."""
    if formula == expected:
        return True
    difference = sympy.expand(sympy.sympify(formula) - expected)
    return difference == 0 or sympy.cancel(sympy.together(difference)) == 0


def _refusal(system: System, what: str) -> str:
    name = type(system.law).__name__
    return (
        "certificates cover laws whose equations are those of the error system that they state, "
        f"not {name}: {what}"
    )


def _compare_controller(system: System, equations: Equations, bare: Signals) -> None:
    """Refuse a law whose controller has other formulas or numbers than the law's own."""
    law, plant, controller = system.law, system.plant, system.controller
    full = Signals(plant, bare.q, integral=law.integral is not None)
    parts = (bare.nu, bare.e_n, *bare.phi), (full.nu, full.e_n, *full.phi)
    runs = controller.equations.formulas
    others = [z for z in controller.states if z not in [name for name, _ in equations.update]]
    rates = dict(controller.equations.update)
    if others != [INTEGRAL] * (law.integral is not None) or any(
        not identical(rates[z], full.x[0] - full.Y[0]) for z in others
    ):
        raise NoCertificate(_refusal(system, "it has states that are not its own"))
    for name, formula in equations.formulas.items():
        if name not in runs or not _same_with_parts(*parts, runs[name], sympy.sympify(formula)):
            raise NoCertificate(_refusal(system, f"what runs as {name} is another"))
    used = dict(zip(controller.symbols, controller.values, strict=True))
    for name, value in _exact_values(bare, law.parameters(plant)).items():
        if used.get(name) != float_of(value):
            raise NoCertificate(_refusal(system, f"what runs with {name} has another number"))


@lru_cache(maxsize=MAX_COMPARISONS)
def _same_with_parts(
    symbols: tuple[sympy.Symbol, ...],
    parts: tuple[sympy.Expr, ...],
    formula: sympy.Expr,
    bare: sympy.Expr,
) -> bool:
    """Whether a formula is the bare one with parts in the place of symbols.

    A law that is made again for other gains has the same formulas.
    """
    return identical(formula, bare.xreplace(dict(zip(symbols, parts, strict=True))))


def _compare_recursion(system: System) -> None:
    """Refuse a law whose e_n and nu are not those of the recursion, or of K, with its gains."""
    law, plant, controller = system.law, system.plant, system.controller
    q, beyond = law.order(plant), law.sampled_feedforward
    design = (
        Linear.coordinates(law, plant)
        if isinstance(law, Linear)
        else recursion(plant.g, plant.b, law.gains(), q, beyond=beyond)
    )
    part = design.integral
    expected = {} if part is None else {"A_n0": part.column[-1:], "nu_0": np.array([part.nu])}
    expected |= {
        "A_n": design.A[-1],
        "B_n": design.B[-1],
        "nu_x": design.nu_x,
        "nu_Y": design.nu_Y,
        "sign_g": np.array([plant.gain_sign]),
    }
    used = dict(zip(controller.symbols, controller.values, strict=True))
    for name, numbers in expected.items():
        group = controller.signals.all_parameters[name]
        actual = np.array([used[entry] for entry in group])
        numbers = np.ravel(numbers)
        if np.abs(actual - numbers).max() > SAME_NUMBERS * np.abs(numbers).max():
            raise NoCertificate(_refusal(system, f"its {name} is not that of the recursion"))


def _exact_values(s: Signals, numbers: Mapping[str, Any]) -> dict[sympy.Symbol, sympy.Rational]:
    """The law's gains by their symbols."""
    values = {}
    for name, group in s.all_parameters.items():
        if name in numbers:
            entries = np.ravel(np.asarray(numbers[name], dtype=object))
            for entry, value in zip(group, entries, strict=True):
                values[entry] = as_sympy(value)
    return values


def _with_values(
    stated: KnownParameters | EstimatedParameters, values: Mapping[sympy.Symbol, Any]
) -> KnownParameters | EstimatedParameters:
    def substituted(formula: Any) -> Any:
        return sympy.sympify(formula).xreplace(values)

    if isinstance(stated, KnownParameters):
        return KnownParameters(substituted(stated.g_n), tuple(map(substituted, stated.theta)))
    return EstimatedParameters(
        delta_hat=stated.delta_hat,
        gain_rate=substituted(stated.gain_rate),
        leak_gain=substituted(stated.leak_gain),
        leak_theta=substituted(stated.leak_theta),
        delta0=substituted(stated.delta0),
        theta_hat=stated.theta_hat,
        theta0=tuple(map(substituted, stated.theta0)),
        Gamma=tuple(tuple(map(substituted, row)) for row in stated.Gamma),
    )


def _compare_parameters(system: System, stated: KnownParameters) -> None:
    """Refuse a law that takes other numbers for g_n and theta than the plant states."""
    plant = system.plant
    known = (plant.input_gain, *(plant.theta or ()))
    used = (stated.g_n, *stated.theta)
    if len(known) != len(used) or any(
        value is None or rational(value) != rational(entry)
        for value, entry in zip(known, used, strict=False)
    ):
        raise NoCertificate(
            _refusal(system, "its g_n and theta are not plant.input_gain and plant.theta")
        )
