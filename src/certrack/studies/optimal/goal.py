"""What a trajectory is judged by, and what an optimum minimises under which limits."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from certrack.core.errors import InputError

#: What can be minimised, and what it is called in tables.
QUANTITIES = {
    "squared_error": "integral of e_1^2",
    "energy": "integral of u^2",
    "peak": "peak input",
    "time": "time [s]",
}

#: What can have a limit, and the arguments of :func:`~certrack.optimal` that are called otherwise.
LIMITED_QUANTITIES, ARGUMENT_NAMES = ("squared_error", "energy", "peak"), {"peak": "peak_input"}


@dataclass(frozen=True)
class TrajectoryCost:
    """What a trajectory costs.

    Attributes
    ----------
    squared_error : float
        Integral of e_1^2 over the horizon, squared unit of the output times s.
    energy : float
        Integral of u^2, squared unit of the input times s.
    peak : float
        Largest |u|.
    time : float, s
        A law's settling time, NaN where it does not settle; for an optimum of the time, when all
        error coordinates are zero; of another optimum, NaN.
    """

    squared_error: float
    energy: float
    peak: float
    time: float

    def record(self) -> dict[str, float | None]:
        """Ready for JSON: a number that does not exist is None."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value if value == value else None for name, value in values.items()}


@dataclass(frozen=True)
class Goal:
    """What is minimised, and the limits of the others.

    Parameters
    ----------
    minimised : str
        One of :data:`QUANTITIES`.
    squared_error, energy, peak : float, optional
        Limits, in the units of :class:`TrajectoryCost`.
    """

    minimised: str
    squared_error: float | None = None
    energy: float | None = None
    peak: float | None = None

    def __post_init__(self) -> None:
        if self.minimised not in QUANTITIES:
            raise InputError("objective", f"must be one of {', '.join(QUANTITIES)}", self.minimised)
        if getattr(self, self.minimised, None) is not None:
            key = ARGUMENT_NAMES.get(self.minimised, self.minimised)
            raise InputError(key, "is what is minimised, so it has no limit", remedy="Leave it out")
        if self.minimised == "time" and self.peak is None:
            raise InputError(
                "peak_input",
                "must be given for the shortest time: without it any time can be undercut",
            )
        if self.minimised == "squared_error" and self.energy is None and self.peak is None:
            raise InputError(
                "peak_input",
                "or energy must be given for the least integral of e_1^2: without them more input "
                "is always better",
            )
        if self.minimised in ("energy", "peak") and self.squared_error is None:
            raise InputError(
                "squared_error",
                f"must be given for the least {QUANTITIES[self.minimised]}: without it no input at "
                "all is best",
            )

    @property
    def limits(self) -> dict[str, float]:
        """The limits that are given."""
        limits = {name: getattr(self, name) for name in LIMITED_QUANTITIES}
        return {name: limit for name, limit in limits.items() if limit is not None}

    def record(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"minimised": self.minimised, "limits": self.limits}
