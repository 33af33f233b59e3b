"""What :func:`certrack.tune` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from certrack.core.rounding import rounded_up
from certrack.systems.system import System
from certrack.tuning.measure import Measured


@dataclass(frozen=True)
class ActiveLimit:
    """A limit that the tuned design uses fully.

    Attributes
    ----------
    limit : str
    value : float
        Of the limit.
    price : float
        The part of the objective that is gained where the limit is eased by a tenth, at
        the slope of the optimum: over the whole tenth it is mostly less.
    """

    limit: str
    value: float
    price: float

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"limit": self.limit, "value": self.value, "price": self.price}


@dataclass(frozen=True)
class FrontPoint:
    """One design of a front.

    Attributes
    ----------
    limit : float
        The value of the limit that is swept.
    objective : float or None
        The best estimate with it; None if nothing keeps all limits.
    """

    limit: float
    objective: float | None


@dataclass(frozen=True)
class Front:
    """The best objective against one of the limits.

    Attributes
    ----------
    limit, objective : str
        Names of the quantities.
    points : tuple of FrontPoint
    """

    limit: str
    objective: str
    points: tuple[FrontPoint, ...]


@dataclass(frozen=True)
class Tuned:
    """Result of :func:`certrack.tune`.

    Attributes
    ----------
    system : System
        With the tuned law.
    objective : str
    before, after : Measured
    limits : tuple of str
        All that were in force.
    active : tuple of ActiveLimit
    programs : int
        Evaluations of the certificate with its gradient.
    programs_per_start : tuple of int
    seed : int
    front : Front or None
    notes : tuple of str
    stopped : bool
        Whether the search was interrupted: the best so far.
    broken : tuple of str
        Limits that the measured figures exceed, each with the figure.
    """

    system: System
    objective: str
    before: Measured
    after: Measured
    limits: tuple[str, ...]
    active: tuple[ActiveLimit, ...]
    programs: int
    programs_per_start: tuple[int, ...]
    seed: int
    front: Front | None = None
    notes: tuple[str, ...] = ()
    stopped: bool = False
    broken: tuple[str, ...] = ()

    @property
    def certified(self) -> tuple[float, float]:
        """Certified errors before and after, of the same loop where both have such a bound."""
        pair = self.before, self.after
        before, after = (m.continuous.certified if m.continuous else m.certified for m in pair)
        return before, after

    def __repr__(self) -> str:
        before, after = (rounded_up(bound, 4) for bound in self.certified)
        return f"Tuned(certified {before} -> {after}, {self.programs} programs)"

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        law = self.system.law
        gains = {"kind": law.kind, "feedforward": law.feedforward}
        front = None
        if self.front is not None:
            points = [{"limit": p.limit, "objective": p.objective} for p in self.front.points]
            front = {"limit": self.front.limit, "points": points}
        return {
            "objective": self.objective,
            "before": self.before.summary(),
            "after": self.after.summary(),
            "limits": list(self.limits),
            "active": [limit.summary() for limit in self.active],
            "law": gains | tuned_numbers(self.system),
            "programs": self.programs,
            "programs_per_start": list(self.programs_per_start),
            "seed": self.seed,
            "front": front,
            "notes": list(self.notes),
            "stopped": self.stopped,
            "broken": list(self.broken),
        }


def tuned_numbers(system: System) -> dict[str, Any]:
    """The gains of a law, by name."""
    names = (
        "c",
        "K",
        "r",
        "coupling",
        "gain_rate",
        "leak_gain",
        "leak_theta",
        "Gamma",
        "delta0",
        "theta0",
        "integral",
    )
    law = system.law
    values = {name: getattr(law, name, None) for name in names}
    if law.observer is not None:
        of_observer = ("weights", "bandwidth")
        values |= {f"observer.{name}": getattr(law.observer, name) for name in of_observer}
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in values.items()
        if value not in (None, ())
    }
