"""The error systems at both ends of moving gains, in coordinates that they share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import sympy

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import ToNumber, exact_float, rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.formulation import (
    adaptation_of,
    error_coordinates,
    error_problem,
    problem_of_design,
)
from certrack.certificates.online.adaptation import moving_adaptation
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scope import ranged_names
from certrack.certificates.stated import (
    first_end_system,
    identical,
    other_end_system,
    stated_error_system,
)
from certrack.core.once import once
from certrack.laws.online import ENDS, LEVEL, OTHER, RULE
from certrack.laws.plant_coordinates import PlantCoordinates, plant_coordinates
from certrack.laws.signals import Signals
from certrack.references.base import bound_of
from certrack.systems.system import System

#: Why there is none of a law whose gains stand still.
GAINS_STAND_STILL = "the gains stand still (no law.online)"


@once
def end_problems(system: System) -> tuple[ErrorProblem, ...]:
    """The problems whose proofs together cover all motions of the gains, in exact rationals.

    One with estimates, else one for each end.

    Raises
    ------
    NoCertificate
        If there is no certificate of this kind.
    """
    if system.law.online is None:
        raise NoCertificate(GAINS_STAND_STILL)
    ends = first_end_system(system), other_end_system(system)
    _refuse_beside(ends[0])
    problems = [error_problem(end, rational) for end in ends]  # refuses what is not covered
    _require_mean(system, *ends)
    one, two = (adaptation_of(end, rational) for end in ends)
    if one is None or two is None:
        coordinates = [_in_plant_coordinates(end) for end in ends]
        problems = [_problem(end, part) for end, part in zip(ends, coordinates, strict=True)]
        return tuple(_with_inputs_of_both(*problems))
    _require_shared(*ends, one, two)
    slower = min(problems, key=lambda problem: -problem.M[-1, -1])
    rate = system.law.online.rate
    adaptation = moving_adaptation(one, two, None if rate is None else rational(rate))
    return (replace(slower, adaptation=adaptation).read_only(),)


def _refuse_beside(first: System) -> None:
    """Refuse what other certificates cover, which do not cover moving gains."""
    ranged = ranged_names(first, stated_error_system(first))
    beside = f"plant.ranges of {', '.join(ranged)}" if ranged else ""
    if first.plant.uncertainty.bound is not None:
        beside = "plant.uncertainty.bound"
    if beside:
        raise NoCertificate(f"no certificate covers {beside} beside law.online: leave one out")


def _require_mean(system: System, first: System, other: System) -> None:
    """Refuse a controller that is not the mean of both ends with a level within [0, 1]."""
    plant, online = system.plant, system.law.online
    assert online is not None
    runs, still = system.controller, first.controller
    names = dict.fromkeys(name for key in online.changes for name in ENDS[key])
    signals = Signals(plant, still.signals.q)
    known, moved = still.signals.all_parameters, {}
    level = _stated_level(system)
    for name in names:
        if name in known:
            others = signals.parameters(f"{OTHER}{name}", len(known[name]))
            for here, there in zip(known[name], others, strict=True):
                moved[here] = here + level * (there - here)
    formulas = runs.equations.formulas
    for name, formula in still.equations.formulas.items():
        if name not in formulas or not identical(formulas[name], formula.xreplace(moved)):
            raise NoCertificate(f"what runs as {name} is no mean of the laws at both ends")
    values = dict(zip(runs.symbols, runs.values, strict=True))
    for prefix, end in (("", first), (OTHER, other)):
        for group, symbols in end.controller.signals.all_parameters.items():
            used = runs.signals.all_parameters.get(f"{prefix}{group}", ())
            numbers = dict(zip(end.controller.symbols, end.controller.values, strict=True))
            if any(values[a] != numbers[b] for a, b in zip(used, symbols, strict=bool(used))):
                raise NoCertificate(f"what runs with {prefix}{group} has another number")
    for name, value in online.numbers.items():
        (number,) = (values[a] for a in runs.signals.all_parameters.get(name, ()))
        if number != value:
            raise NoCertificate(f"what runs with {name} has another number")


def _require_shared(first: System, other: System, one: Adaptation, two: Adaptation) -> None:
    """Refuse estimates whose error systems differ in more than what one inequality covers.

    A larger c_n only takes from V' if it stands in M[n, n] and nowhere else.
    """
    here, there = (error_coordinates(end, rational) for end in (first, other))
    same = all(
        (getattr(here, part) == getattr(there, part)).all() for part in ("A", "B", "F", "g", "R")
    )
    apart = here.error_matrix != there.error_matrix
    apart[-1, -1] = False
    if not same or apart.any():
        hint = "" if first.law.coupling is None else ": with law.coupling it is in M[n, n-1], too"
        raise NoCertificate(
            "with estimates c_n may stand in the last diagonal entry of the error system only"
            f"{hint}; leave law.coupling out, or let other gains move"
        )
    known = ("gains", "delta0", "gain_sign", "theta_box", "shift")
    same = all(getattr(one, part) == getattr(two, part) for part in known)
    apart = one.Gamma != two.Gamma
    np.fill_diagonal(apart, val=False)
    if not same or (one.theta0 != two.theta0).any() or apart.any():
        raise NoCertificate("the update laws of both ends differ in more than may move")


def _stated_level(system: System) -> sympy.Expr:
    """The level, which its formula holds within [0, 1], and its rate within the stated one."""
    online, runs = system.law.online, system.controller
    assert online is not None
    rates = dict(runs.equations.update)
    s, expected = Signals(system.plant, runs.signals.q), None
    parts = {name: s.parameter(f"{RULE}{name}") for name in ("threshold", "rise", "fall", "rate")}
    if online.threshold is not None:
        q = (s.x[0] - s.Y[0]) / parts["threshold"]
        expected = (parts["rise"] * q**4 * (1 - LEVEL) - parts["fall"] * LEVEL) / (1 + q**4)
    elif online.rate is not None:
        wanted = online.wanted(s)
        expected = parts["rate"] * (wanted - LEVEL)
    else:
        return online.wanted(s)
    if LEVEL not in rates or not identical(rates[LEVEL], expected):
        raise NoCertificate("the level of law.online moves by another rule")
    return LEVEL


def _in_plant_coordinates(end: System) -> PlantCoordinates:
    """K and r of one end, which its design must be for every x and Y."""
    design = error_coordinates(end, rational)
    F, nu_x, nu_Y = design.F, design.nu_x, design.nu_Y
    n = len(nu_x)
    g = np.array([F[i, i + 1] for i in range(n - 1)], dtype=object)
    b = F.copy()
    b[range(n - 1), range(1, n)] = b[range(n - 1), range(1, n)] - g
    same = plant_coordinates(g, b, nu_x, nu_Y[-1], design.q)
    if any(a != c for a, c in zip(same.nu_Y, nu_Y, strict=True)):
        raise NoCertificate("the law is no linear feedback in the coordinates of the plant")
    return same


def _problem(end: System, coordinates: PlantCoordinates) -> ErrorProblem:
    def bound(i: int) -> Any:
        return exact_float(bound_of(end.reference, i)[0], rational)

    number: ToNumber = rational
    return problem_of_design(coordinates, end.plant.uncertainty, bound, None, number)


def _with_inputs_of_both(first: ErrorProblem, other: ErrorProblem) -> list[ErrorProblem]:
    """Both with a column for y_d^(q+1), where one has it."""
    orders = sorted({*first.derivatives, *other.derivatives})
    return [
        problem if list(problem.derivatives) == orders else _widened(problem, tuple(orders))
        for problem in (first, other)
    ]


def _widened(problem: ErrorProblem, orders: tuple[int, ...]) -> ErrorProblem:
    """With one more reference input, the last one, that does not act."""
    zero = np.zeros((problem.n, 1), dtype=object) + rational(0)
    Uy, Xy = (np.hstack([part, zero]) for part in (problem.Uy, problem.Xy))
    return replace(problem, Uy=Uy, Xy=Xy, derivatives=orders)
