"""A limit on a quantity, and what is to be optimised within limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certrack.tuning.candidate import Candidate
from certrack.tuning.quantities import Quantity, log_of, logarithm, slope_of


@dataclass(frozen=True)
class Limit:
    """A quantity that must not exceed a value, or not fall below it.

    Attributes
    ----------
    quantity : Quantity
    value : float
    at_least : bool
    option : str
        By which the user sets it; empty for one that is always in force.
    """

    quantity: Quantity
    value: float
    at_least: bool = False
    option: str = ""

    @property
    def name(self) -> str:
        """Of the quantity."""
        return self.quantity.name

    @property
    def sign(self) -> float:
        """1 where the quantity must be small."""
        return -1.0 if self.at_least else 1.0

    def excess(self, candidate: Candidate) -> float:
        """log(quantity/value), or its negative: the limit is kept where it is not positive."""
        return self.sign * (log_of(self.quantity, candidate) - logarithm(self.value))

    def gradient(self, candidate: Candidate) -> np.ndarray:
        """Of the excess."""
        return self.sign * slope_of(self.quantity, candidate)

    def describe(self) -> str:
        """As a sentence says it."""
        return f"{self.name} {'>=' if self.at_least else '<='} {self.value:.5g}"


@dataclass(frozen=True)
class Task:
    """What a search does.

    Attributes
    ----------
    objective : Quantity
    smallest : bool
        Whether it is made small; large otherwise.
    limits : tuple of Limit
    accepts : callable
        The last word on a point that keeps all limits.
    """

    objective: Quantity
    smallest: bool
    limits: tuple[Limit, ...]
    accepts: Callable[[Candidate], bool]

    @property
    def sign(self) -> float:
        """1 where the objective is made small."""
        return 1.0 if self.smallest else -1.0
