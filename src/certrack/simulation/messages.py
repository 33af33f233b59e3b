"""How a run ended, in words: a sampled loop has other remedies than a continuous one."""

from __future__ import annotations

from certrack.integrators.base import Outcome
from certrack.systems.system import System

#: What is said of a sampled run instead of the outcome's own words.
OF_SAMPLED_LOOPS = {
    Outcome.escaped: (
        "A plant state passed simulation.max_state: the sampled loop diverges. Shorten "
        "implementation.period or delay, or widen the saturation (certrack margin tells how far "
        "each may go); if the file without [implementation] escapes too, it is the law: raise c, "
        "start closer to the reference, or check the sign of the input gain."
    ),
    Outcome.undefined: (
        "The plant's right-hand side is not finite here: a formula leaves its domain (log, sqrt, "
        "a division). Check the formulas near this state."
    ),
    Outcome.step_limit: (
        "One interval between two samples took too many steps: the plant is too stiff for them. "
        "Raise simulation.tolerance, or replace a steep tanh() by sign()."
    ),
}


def outcome_message(outcome: Outcome, system: System) -> str:
    """What to tell the user of an outcome, remedy included.

    Parameters
    ----------
    outcome : Outcome
    system : System
        That was run.
    """
    if system.implementation is None:
        return str(outcome.value)
    return OF_SAMPLED_LOOPS.get(outcome, str(outcome.value))
