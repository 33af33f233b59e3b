"""One point of a search: its law, and what is computed from it once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from certrack.laws.backstepping import ErrorCoordinates
from certrack.laws.base import Law
from certrack.systems.system import System
from certrack.tuning.families import Family

Computed = TypeVar("Computed")

#: Step of the differences of problem data and of cheap quantities, in logarithms of gains.
DIFFERENCE = 1e-5


class Candidate:
    """A point of the search.

    Parameters
    ----------
    family : Family
    base : System
        All but the law.
    v : array
        Logarithms of the tuned gains.
    """

    def __init__(self, family: Family, base: System, v: np.ndarray) -> None:
        self.family, self.base, self.v = family, base, np.array(v, dtype=float)
        self._known: dict[Any, Any] = {}

    def once(self, key: Any, compute: Callable[[], Computed]) -> Computed:
        """What `compute` gives, which is asked for a key once."""
        if key not in self._known:
            self._known[key] = compute()
        known: Computed = self._known[key]
        return known

    @cached_property
    def law(self) -> Law:
        """Its law."""
        return self.family.law(self.v)

    @cached_property
    def design(self) -> ErrorCoordinates:
        """Its error coordinates."""
        return self.law.coordinates(self.base.plant)

    @cached_property
    def system(self) -> System:
        """The system with its law."""
        return self.base.replace(law=self.law)

    @cached_property
    def neighbours(self) -> list[tuple[Candidate, Candidate]]:
        """For each gain, the points a small step above and below."""
        steps = DIFFERENCE * np.eye(len(self.v))
        return [
            (
                Candidate(self.family, self.base, self.v + step),
                Candidate(self.family, self.base, self.v - step),
            )
            for step in steps
        ]
