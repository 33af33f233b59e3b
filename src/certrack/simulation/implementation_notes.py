"""What makes an implementation unlikely to work, told before it is run or exported.

No solver is needed: the period against the loop's speed, and the quanta against the tracking error
that they alone may cause.
"""

from __future__ import annotations

import math

import numpy as np

from certrack.loops.stability import linear_loop
from certrack.model.implementation import Implementation
from certrack.simulation.metrics import settling_band
from certrack.simulation.remedies import shorter_period
from certrack.systems.system import System

#: Below this part of the period at which the fastest pole fails, no loop is looked at closer.
SURELY_SHORT = 0.05

#: Period and delay times the fastest pole: below the first, sampling changes little; above the
#: second a design of this speed does not survive it as a rule.
SMALL_POLE_PERIOD, LARGE_POLE_PERIOD = 0.3, 1.0

#: Forward Euler of an estimate's leak, 1 - rate T: above 1 the estimate alternates.
ALTERNATING_LEAK = 1.0


def implementation_notes(system: System) -> tuple[str, ...]:
    """Notes on the implementation of a system; none where it has none or all is well.

    Parameters
    ----------
    system : System

    Returns
    -------
    tuple of texts
        One line each, with the remedy.
    """
    implementation = system.implementation
    if implementation is None:
        return ()
    return (*_speed_notes(system, implementation), *_quantum_notes(system))


def longest_speed_period(pole: float, delay: float) -> float:
    """Period at which a sampled loop e' = -pole e ceases to be stable, s.

    With the command held for a period and delayed by d whole periods, its characteristic equation
    is z^(d+1) - z^d + pole T = 0, whose roots leave the unit circle at
    pole T = 2 sin(pi/(4 d + 2)): 2 without a delay, 1 with one period.

    Parameters
    ----------
    pole : float, 1/s
    delay : float, periods

    Returns
    -------
    float
        Exact for whole periods; in between it follows the formula.
    """
    return 2 * math.sin(math.pi / (4 * delay + 2)) / pole


def quantum_error(system: System) -> float:
    """The steady |e_1| that quanta of sensors and actuator alone may cause.

    Half a quantum of each measured state and of the input act as one constant input of the designed
    error system, all to its disadvantage. States that are differenced count zero: the difference of
    a constant error vanishes. With integral action what is left is the error of the first sensor.

    Parameters
    ----------
    system : System
        With an implementation.
    """
    implementation, coordinates = system.implementation, system.controller.coordinates
    assert implementation is not None
    quanta = np.array(implementation.measurement_quantum or (0.0,) * system.plant.n)
    for i, name in enumerate(system.plant.states):
        if name in implementation.velocity:
            quanta[i] = 0.0
    if coordinates.integral is not None:
        return float(quanta[0] / 2)
    gain = system.truth.input_gain
    size = abs(float(gain.expr)) if gain is not None and gain.expr.is_number else 0.0
    pushed = np.abs(coordinates.nu_x) @ quanta / 2 + size * implementation.input_quantum / 2
    if not pushed:
        return 0.0
    return float(abs(np.linalg.inv(coordinates.error_matrix)[0, -1]) * pushed)


def _speed_notes(system: System, implementation: Implementation) -> tuple[str, ...]:
    """The exact verdict where the loop is linear, else the fastest error pole by the period."""
    period, delay = implementation.period, implementation.run_delay
    pole = system.controller.fastest_pole
    longest = longest_speed_period(pole, delay)
    if period < SURELY_SHORT * longest:
        return ()
    loop = linear_loop(system)
    if loop is not None:
        radius = loop.radius(period, delay)
        if radius < 1:
            return ()
        return (
            f"the sampled loop is unstable at a period of {period:g} s: the largest eigenvalue of "
            f"one period is {radius:.4g}. {_capital(shorter_period(system))}",
        )
    if period < longest:
        return ()
    delayed = f" and its delay of {delay:g} periods" if delay else ""
    return (
        f"the period of {period:g} s{delayed} is too long for the fastest error pole, {pole:.4g} "
        f"/s: a sampled loop of this speed is unstable from {longest:.3g} s on. "
        f"{_capital(shorter_period(system))}",
    )


def _capital(sentence: str) -> str:
    return sentence[0].upper() + sentence[1:]


def _quantum_notes(system: System) -> tuple[str, ...]:
    error = quantum_error(system)
    limit, name = system.varied.limit, "ensemble.limit"
    if limit is None:
        limit, name = settling_band(system.settings, system.reference), "the settling band"
    if not error > limit:
        return ()
    return (
        f"the quanta of sensors and actuator alone may hold |e_1| at {error:.3g}, beyond {name} of "
        f"{limit:.3g}. Use finer ones (implementation.measurement_quantum, input_quantum)",
    )
