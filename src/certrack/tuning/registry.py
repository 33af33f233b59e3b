"""The family of each kind of law.

To give a law a family, write a class of :class:`certrack.tuning.families.Family` and list it here;
all else follows from the law's own certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from certrack.core.errors import InputError
from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Law
from certrack.laws.classic import Classic
from certrack.laws.robust import Robust
from certrack.systems.system import System
from certrack.tuning.families import AdaptiveFamily, Family, RobustFamily
from certrack.tuning.linear_family import LinearFamily, rates_of

FAMILIES: Mapping[str, Callable[[System, int], Family]] = {
    "robust": RobustFamily,
    "adaptive": AdaptiveFamily,
    "linear": LinearFamily,
}


def tuning_family(system: System, kind: str, feedforward: int) -> Family:
    """The family in which `system` is tuned.

    Raises
    ------
    InputError
        If laws of this kind have none, or the plant does not tell what they must know.
    """
    if kind not in FAMILIES:
        why = "has no certificate: without leakage no bound exists" if kind == Classic.kind else ""
        raise InputError(
            "law.kind",
            f"{why or 'has no gains that tune knows'}",
            kind,
            f"Choose --law {' or --law '.join(FAMILIES)}",
        )
    return FAMILIES[kind](_with_law(system, kind, feedforward), feedforward)


def _with_law(system: System, kind: str, feedforward: int) -> System:
    """The system with a law of this kind, as fast as its own; a linear one begins at any."""
    law = system.law
    if law.kind == kind or kind == LinearFamily.kind:
        return system
    known = Robust if kind == RobustFamily.kind else Adaptive
    c = tuple(np.round(rates_of(system), 6).tolist()) if not law.c else law.c
    changed: Law = known(c=c, coupling=law.coupling, feedforward=feedforward)
    return system.replace(law=changed, settings=replace(system.settings, estimates=None))
