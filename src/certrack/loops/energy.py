"""Where the energy of two motors goes, as formulas; integrated as states of the truth itself.

With the torques T_i of :mod:`certrack.model.motors`, the stored energy E(x) and the rates f,

    T_i omega_i                       to the mechanism
    R_i (T_i/k_i)^2                   copper
    F(x)                              friction
    W = grad E . f(T = 0) + F         from the surroundings: what the disturbances do

so that E' = sum T_i omega_i - F + W wherever grad E holds T_i with the factor omega_i, which is
checked. The link asks for P = sum (T_i omega_i + R_i (T_i/k_i)^2); source and chopper follow
:class:`certrack.model.motors.Supply`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, Expression, symbol
from certrack.core.formula_text import text_of
from certrack.core.kinks import derivative
from certrack.core.lowering import numpy_callable, rows
from certrack.loops.plant import INPUT, true_constants
from certrack.model.motors import BOTH, MotorNumbers, Motors, Supply
from certrack.systems.system import System

#: What is integrated, in the order of the added states; all in joules but the last, in rad.
FLOWS = (
    *("copper_1", "copper_2", "work_1", "work_2", "friction", "surroundings"),
    *("drawn", "returned", "chopper", "supply_loss", "asked", "given_back", "twist"),
)

#: A file without [truth.supply]: an ideal source that takes nothing back.
PLAIN_SUPPLY = Supply("chopper")

#: Beginning of the names of the added states.
FLOW_PREFIX = "flow_of_"

#: States at which the factor of the torques in E' is compared with the speeds, and how closely.
CHECK_POINTS, CHECK_ACCURACY = 40, 1e-9


def require_motors(system: System) -> Motors:
    """The motors of a system, or what to do where it has none."""
    motors = system.truth.motors
    if motors is None:
        message = "is missing: energy needs to know the motors"
        remedy = "certrack.load('dual-motor-physical') shows one; docs/energy.md tells how"
        raise InputError("truth.motors", message, remedy=remedy)
    return motors


def motor_numbers(system: System) -> MotorNumbers:
    """Numbers of the motors of a system, its true constants put in."""
    known = {name: sympy.Rational(value) for name, value in true_constants(system).items()}
    return require_motors(system).numbers(known)


def power_formulas(system: System, motors: Motors | None = None) -> dict[str, sympy.Expr]:
    """The rates of :data:`FLOWS` as formulas in t, u, the truth's states and its constants.

    Parameters
    ----------
    system : System
        With motors.
    motors : Motors, optional
        In the place of its own.

    Returns
    -------
    dict
        W; of the twist rad/s.

    Raises
    ------
    InputError
        If the system has no motors, or its stored energy does not fit its rates.
    """
    motors, truth = motors or require_motors(system), system.truth
    states = [symbol(name) for name in truth.states or ()]
    torques = motors.torque_formulas(INPUT)
    T = list(torques.values())
    w = [speed.expr for speed in motors.speeds]
    work = [torque * speed for torque, speed in zip(T, w, strict=True)]
    squares = [
        R.expr * (torque * inverse) ** 2
        for R, torque, inverse in zip(motors.resistance, T, motors.currents_per_torque, strict=True)
    ]
    gradient = [derivative(motors.stored.expr, x) for x in states]
    growth = sum(
        (g * rate.expr for g, rate in zip(gradient, truth.rates or (), strict=True)),
        sympy.S.Zero,
    )
    _check_stored(system, growth, list(torques), w)
    friction = motors.friction.expr
    link = work[0] + work[1] + squares[0] + squares[1]
    asked = sympy.Max(link, 0)
    back = asked - link  # max(-link, 0), with the same switch
    return {
        "copper_1": squares[0],
        "copper_2": squares[1],
        "work_1": work[0],
        "work_2": work[1],
        "friction": friction,
        "surroundings": growth.xreplace(dict.fromkeys(torques, sympy.S.Zero)) + friction,
        **_source(truth.supply or PLAIN_SUPPLY, asked, back),
        "asked": asked,
        "given_back": back,
        "twist": w[0] - w[1],
    }


def _source(supply: Supply, asked: sympy.Expr, back: sympy.Expr) -> dict[str, sympy.Expr]:
    """Power out of the source, into it, into the chopper, and lost between link and source."""
    exact = {name: sympy.Rational(str(value)) for name, value in _finite(supply).items()}
    accepted = sympy.S.Zero
    if supply.kind == "battery":
        accepted = sympy.Min(back, exact["power_limit"]) if "power_limit" in exact else back
    stored = exact["efficiency"] * accepted
    drawn, returned, loss = asked, stored, accepted - stored
    if supply.resistance:
        V, R = exact["voltage"], exact["resistance"]

        def current(p: sympy.Expr) -> sympy.Expr:
            return 2 * p / (V + sympy.sqrt(V**2 - 4 * R * p))

        out, back_in = current(asked), current(-stored)
        drawn, returned = V * out, -V * back_in
        loss += R * (out**2 + back_in**2)  # one of the two is zero
    return {
        "drawn": drawn,
        "returned": returned,
        "chopper": back - accepted,
        "supply_loss": loss,
    }


def _finite(supply: Supply) -> dict[str, Any]:
    names = ("voltage", "resistance", "efficiency", "power_limit")
    values = {name: getattr(supply, name) for name in names}
    return {k: v for k, v in values.items() if v is not None and math.isfinite(v)}


def _check_stored(
    system: System, growth: sympy.Expr, torques: list[sympy.Symbol], speeds: list[sympy.Expr]
) -> None:
    """Refuse a stored energy that a torque changes by another power than torque times speed."""
    states, constants = system.truth.states or (), true_constants(system)
    arguments = [*map(symbol, states), *map(symbol, constants)]
    factors = [derivative(growth, torque) for torque in torques]
    values = numpy_callable([arguments], [*factors, *speeds])
    rng = np.random.default_rng(0)
    for point in rng.uniform(-2, 2, (CHECK_POINTS, len(states))):
        with np.errstate(all="ignore"):
            results = np.array(values([*point, *constants.values()]), float)
        for i, (factor, speed) in enumerate(zip(results[:2], results[2:], strict=True)):
            if abs(factor - speed) > CHECK_ACCURACY * (1 + abs(speed)):
                where = ", ".join(f"{n} = {v:.3g}" for n, v in zip(states, point, strict=True))
                raise InputError(
                    "truth.motors.stored",
                    f"does not fit truth.rates: 1 N m of {torques[i]} changes it by {factor:.6g} W "
                    f"where truth.motors.speeds[{i}] = {speed:.6g} rad/s (at {where})",
                    remedy="Check the inertias in both",
                )


def with_flows(system: System, tolerance: float) -> System:
    """The same system with :data:`FLOWS` among the states of its truth, at zero at the start.

    The motors' torques are put into the rates; what varies between members is left out. So every
    integrator of runs, sampled ones too, integrates the energies with the states.

    Parameters
    ----------
    system : System
        With motors.
    tolerance : float
        Of the integrator, unless the file's is smaller.

    Returns
    -------
    System
    """
    truth, settings = system.truth, system.settings
    numbers = motor_numbers(system)
    free = {FLOW_PREFIX + name: getattr(numbers, name) for name in BOTH}
    share, damping = (
        Expression(name, symbol(name)) for name in (FLOW_PREFIX + name for name in BOTH)
    )
    motors = replace(require_motors(system), share=share, damping=damping)  # one loop for all
    torques = motors.torque_formulas(INPUT)
    states, rates = truth.states or (), truth.rates or ()
    texts = [text_of(rate.expr.xreplace(torques)) for rate in rates]
    texts += [text_of(power) for power in power_formulas(system, motors).values()]
    wider = replace(
        truth,
        states=(*states, *(FLOW_PREFIX + name for name in FLOWS)),
        rates=tuple(texts),  # type: ignore[arg-type]
        constants=(*truth.constants, *free.items()),  # type: ignore[arg-type]
        motors=None,
        supply=None,
    )
    x0 = (*settings.x0, *([0.0] * len(FLOWS)))
    return system.replace(
        truth=wider,
        settings=replace(settings, x0=x0, tolerance=min(settings.tolerance, tolerance)),
        population=None,
    )


def with_motors(system: System, **changes: Any) -> System:
    """The same system with other motors, such as another share or damping.

    Parameters
    ----------
    system : System
    **changes
        Fields of :class:`~certrack.model.motors.Motors`; numbers may be floats.

    Returns
    -------
    System
    """
    motors = replace(require_motors(system), **changes)
    return system.replace(truth=replace(system.truth, motors=motors))


def stored_energy(system: System, states: np.ndarray) -> np.ndarray:
    """Energy in the mechanism, shape (N,), J, of the truth's states, shape (S, N)."""
    names, constants = system.truth.states or (), true_constants(system)
    formula: Expression = require_motors(system).stored
    arguments = [tuple(map(symbol, names)), tuple(map(symbol, constants))]
    value = numpy_callable(arguments, [formula.expr])(
        states[: len(names)], list(constants.values())
    )[0]
    return np.broadcast_to(np.asarray(value, float), states.shape[1:])


def power_values(
    system: System, t: np.ndarray, states: np.ndarray, u: np.ndarray
) -> dict[str, np.ndarray]:
    """The rates of :data:`FLOWS` at given times, states (S, N) and inputs, each of shape (N,)."""
    names, constants = system.truth.states or (), true_constants(system)
    powers = power_formulas(system)
    arguments = [TIME, tuple(map(symbol, names)), INPUT, tuple(map(symbol, constants))]
    values = numpy_callable(arguments, list(powers.values()))
    with np.errstate(all="ignore"):  # beyond what the source can give there is no current
        results = rows(values(t, states[: len(names)], u, list(constants.values())), len(t))
    return dict(zip(powers, results, strict=True))
