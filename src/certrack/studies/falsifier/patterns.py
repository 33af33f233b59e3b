"""Parts of the adversary, and those that are nearly bang-bang patterns.

A pattern is tanh(m sin(omega t + phase) + v . x): searched frequency, phase, hardness and state
feedback.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from certrack.laws.seeking import NUMBERS
from certrack.studies.falsifier.draft import ParameterTable, SystemDraft

#: Largest hardness of a disturbance's pattern: tanh(30 y) is a sign but for 3 % of y's range.
MAX_HARDNESS = 30.0

#: Range of the pattern's frequencies, rad/s, if the design allows them: faster ones average out.
MIN_FREQUENCY, MAX_FREQUENCY = 0.05, 10.0

#: Begin of the names of the patterns' numbers, where they are constants of the plant.
ADVERSARY_PREFIX = "adv_"

#: Hardness to begin with: tanh(10 y) is a sign but for a tenth of y's range, and still cheap.
PLAUSIBLE_HARDNESS = 10.0

#: |tanh| rounds to 1: with this factor w_k never passes its bound.
BELOW_ONE = 0.999999


@dataclass(frozen=True)
class SearchVariable:
    """One searched number.

    Attributes
    ----------
    name : str
        As a constant of the plant, where it is one.
    low, high : float
    """

    name: str
    low: float
    high: float

    @property
    def middle(self) -> float:
        """Middle of the range."""
        return (self.low + self.high) / 2

    @property
    def neutral(self) -> float:
        """0 if it is in the range, else the middle."""
        return 0.0 if self.low <= 0 <= self.high else self.middle


class AdversaryPart(ABC):
    """One thing that the adversary may choose."""

    @property
    @abstractmethod
    def variables(self) -> tuple[SearchVariable, ...]:
        """Its numbers, in the order of all values below."""

    def plausible(self, frequency: float, phase: float) -> tuple[float, ...]:
        """Values to begin with; where it oscillates, with this frequency and phase."""
        return tuple(variable.neutral for variable in self.variables)

    @abstractmethod
    def write_system(self, values: Sequence[float], draft: SystemDraft, *, named: bool) -> None:
        """Put it into a system; what is written as formulas refers to constants if `named`."""

    @abstractmethod
    def write_parameters(self, values: np.ndarray, table: ParameterTable) -> None:
        """Put the values (G, N) of N members into the parameters of the loop with named ones."""


@dataclass(frozen=True)
class Pattern(AdversaryPart):
    """A signal within [-1, 1].

    Attributes
    ----------
    name : str
        By which its numbers differ from those of others.
    states : names of the plant's states
    fastest : float, rad/s
    """

    name: str
    states: tuple[str, ...]
    fastest: float

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        k = self.name
        feedback = (f"{ADVERSARY_PREFIX}v{k}_{j}" for j in range(len(self.states)))
        return (
            SearchVariable(f"{ADVERSARY_PREFIX}m{k}", 0.0, MAX_HARDNESS),
            SearchVariable(f"{ADVERSARY_PREFIX}w{k}", MIN_FREQUENCY, self.fastest),
            SearchVariable(f"{ADVERSARY_PREFIX}p{k}", 0.0, 2 * math.pi),
            *(SearchVariable(name, -MAX_HARDNESS, MAX_HARDNESS) for name in feedback),
        )

    def plausible(self, frequency: float, phase: float) -> tuple[float, ...]:
        return (PLAUSIBLE_HARDNESS, frequency, phase, *(0.0 for _ in self.states))

    def write_system(self, values: Sequence[float], draft: SystemDraft, *, named: bool) -> None:
        numbers = {
            variable.name: value for variable, value in zip(self.variables, values, strict=True)
        }
        if named:
            draft.constants |= numbers
        m, w, p, *v = (name if named else f"({value!r})" for name, value in numbers.items())
        feedback = "".join(f" + {v_j}*{x}" for v_j, x in zip(v, self.states, strict=True))
        self.write(f"tanh({m}*sin({w}*t + {p}){feedback})", draft)

    @abstractmethod
    def write(self, pattern: str, draft: SystemDraft) -> None:
        """Put the pattern into a system."""

    def write_parameters(self, values: np.ndarray, table: ParameterTable) -> None:
        for variable, row in zip(self.variables, values, strict=True):
            table.set_constant(variable.name, row)


@dataclass(frozen=True)
class FreeLevel(Pattern):
    """The level of gains that move (law.online), by any rule; within a rate that is stated."""

    def write(self, pattern: str, draft: SystemDraft) -> None:
        online = draft.law.online
        assert online is not None
        free = f"1/2 + {BELOW_ONE}/2*{pattern}"
        rules = ("threshold", "rise", "fall", "seek", *NUMBERS, "seed")
        rule = replace(online, **dict.fromkeys(rules), schedule=free)
        draft.law = replace(draft.law, online=rule)
