"""What makes a loop slower: the keys that a remedy names are those that the law has."""

from __future__ import annotations

from certrack.laws.baselines.base import Baseline
from certrack.laws.linear import Linear
from certrack.laws.observer import DOB
from certrack.systems.system import System

#: A recursion whose fastest pole is so many times its largest gain owes that to the chain.
FAR_FROM_GAINS = 5.0


def slower_law(system: System) -> str:
    """What to change for slower poles.

    Parameters
    ----------
    system : System
    """
    law = system.law
    if isinstance(law, Linear):
        return "lower law.K" if law.lqr is None else "raise law.lqr.input"
    if isinstance(law, Baseline):
        return law.slower
    return poles_near_gains(system) or "lower law.c"


def poles_near_gains(system: System) -> str:
    """What to change where the fastest pole is far from all gains c; empty where it is near.

    Parameters
    ----------
    system : System
    """
    law = system.law
    if isinstance(law, Linear | Baseline):
        return ""
    if system.controller.fastest_pole > FAR_FROM_GAINS * max(law.c):
        if not law.gains().is_lean:
            return "leave law.k and law.p out, which make the poles fast, or lower law.c"
        if law.coupling is None:
            return "set law.coupling = 0.5: what makes the poles fast is plant.chain, not law.c"
    return ""


def shorter_period(system: System) -> str:
    """The remedy for a loop that is unstable as it is sampled."""
    observer = "" if system.law.observer is None else ", change law.observer"
    return (
        f"shorten implementation.period or delay{observer}, or {slower_law(system)} "
        "(certrack margin finds the edge)"
    )


def takes_differences(system: System) -> bool:
    """Whether states of `velocity` are filtered differences, and not an observer's."""
    observer = system.law.observer
    return observer is None or observer.kind == DOB
