"""One variable of an FMU, as its description declares it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Variable:
    """A variable of the FMU; its value reference is its place in the list."""

    name: str
    causality: str
    start: float
    description: str
    unit: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """What both versions call the same."""
        common = {"name": self.name, "causality": self.causality, "description": self.description}
        if self.causality == "input":
            return common | {"variability": "continuous"}
        if self.causality == "parameter":
            return common | {"variability": "tunable", "initial": "exact"}
        return common | {"variability": "discrete", "initial": "exact"}

    @property
    def value(self) -> dict[str, str]:
        """Start and unit."""
        return {"start": repr(self.start)} | ({"unit": self.unit} if self.unit else {})
