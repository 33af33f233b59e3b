"""A worst case for the adaptive law: that of the loop which knows what this one estimates.

With the estimates at the truth the two loops are one, and linear, so its kernels and linear
programs, at the corners of what has a range, give a reference, disturbances and constants. The
adaptive law is then run with them, its estimates begun at the truth.
"""

from __future__ import annotations

from dataclasses import fields, replace

from certrack.core.errors import InputError
from certrack.core.rationals import float_of
from certrack.laws.adaptive import Adaptive
from certrack.laws.robust import Robust
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.linear.search import (
    LinearCase,
    NothingTried,
    continuous_case,
)
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
from certrack.systems.system import System


def is_estimated(system: System) -> bool:
    """Whether the worst case is that of the loop which knows what the law estimates."""
    return isinstance(system.law, Adaptive) and bool(system.plant.constant_ranges)


def estimated_case(
    system: System, bounds: tuple[float, ...], output: SoughtOutput = ERROR
) -> LinearCase:
    """The worst case of the known loop, run with the adaptive law.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_{q+1}
    output : SoughtOutput
        What is made large.

    Returns
    -------
    LinearCase

    Raises
    ------
    NothingTried
        Where the known loop is not linear, or nothing is found.
    """
    try:
        known = continuous_case(known_system(system), bounds, output)
    except InputError as problem:  # a range with no nominal value inside, say
        raise NothingTried(f"the loop with known parameters is no system: {problem}") from None
    truth = known.system.truth
    assert truth.input_gain is not None
    gain, *theta = (float_of(entry.expr) for entry in (truth.input_gain, *truth.theta))
    case = known.system.replace(
        plant=system.plant,
        law=system.law,
        settings=replace(known.system.settings, estimates=(1 / gain, *theta)),
    )
    run = simulate(case)
    return LinearCase(known.estimate, case, run, output.tail(run))


def known_system(system: System) -> System:
    """The system with the robust law of the same gains, which knows the true g_n and theta."""
    plant, truth = system.plant, system.truth
    common = {f.name: getattr(system.law, f.name) for f in fields(Robust) if f.init}
    if plant.input_gain is None:
        plant = replace(plant, input_gain=truth.input_gain)
    if plant.theta is None and plant.r:
        plant = replace(plant, theta=truth.theta)
    settings = replace(system.settings, estimates=None)
    return system.replace(plant=plant, law=Robust(**common), settings=settings)
