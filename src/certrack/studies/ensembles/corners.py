"""The corners of plant.ranges: they run besides the random members, and count nowhere.

Corner k has the high end of range i where bit i of k is set, and the low end elsewhere; its start,
disturbance and noise are drawn as those of member k are. In all that computes members, corners are
members whose numbers no ensemble reaches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.integrators.base import Outcome
from certrack.model.sampling import MAX_MEMBERS
from certrack.studies.ensembles.plan import METRICS, Range
from certrack.studies.ensembles.statistics import Statistics
from certrack.systems.system import System

#: The corners of so many ranges are run; of more there would be more than 64.
MAX_RANGES = 6

#: Corner 0, as the number of a member.
FIRST_CORNER = MAX_MEMBERS


def constant_ranges_of(system: System) -> dict[str, tuple[float, float]]:
    """The constants with a range, in the order of the file.

    Of a truth with states of its own, those that the population draws: what another constant means
    in its rates, nobody says.
    """
    boxes = system.plant.constant_boxes
    if not system.truth.states:
        return boxes
    drawn = dict(system.varied.constants)
    return {name: box for name, box in boxes.items() if name in drawn}


def ranges_of(system: System) -> dict[str, tuple[float, float]]:
    """All that has a range: constants, then ``input_gain``, then entries of theta.

    An interval that is a point is none; nor has a truth with states of its own a gain or theta.
    """
    ranges, plant = dict(constant_ranges_of(system)), system.plant
    if system.truth.states:
        return ranges
    others = {"input_gain": plant.input_gain_range} if plant.input_gain_range else {}
    others |= {f"theta[{i}]": box for i, box in enumerate(plant.theta_range or ())}
    return ranges | {name: (low, high) for name, (low, high) in others.items() if low < high}


def count_of(ranges: Mapping[str, tuple[float, float]]) -> int:
    """How many corners are run."""
    return 2 ** len(ranges) if 0 < len(ranges) <= MAX_RANGES else 0


def span_of(system: System) -> Range | None:
    """The corners as numbers of members; None where there are none, or too many."""
    count = count_of(ranges_of(system))
    return (FIRST_CORNER, FIRST_CORNER + count) if count else None


def corner_values(
    ranges: Mapping[str, tuple[float, float]], corners: np.ndarray
) -> dict[str, np.ndarray]:
    """The values at some corners, by name."""
    return {
        name: np.where(corners >> i & 1, high, low)
        for i, (name, (low, high)) in enumerate(ranges.items())
    }


def draws_at_corners(
    system: System,
    of_members: Callable[[int, int], dict[str, np.ndarray]],
    begin: int,
    end: int,
) -> dict[str, np.ndarray]:
    """Every drawn number of some corners, by name.

    Parameters
    ----------
    system : System
    of_members : callable
        Gives the draws of members begin ... end-1.
    begin, end : int
        From :data:`FIRST_CORNER` on; registers are filled with corners from the first on.
    """
    ranges, constants = ranges_of(system), system.plant.constant_boxes
    count = count_of(ranges)
    corners = np.arange(begin - FIRST_CORNER, end - FIRST_CORNER) % count
    draws = {name: values[corners] for name, values in of_members(0, count).items()}
    for name, values in corner_values(ranges, corners).items():
        draws[f"constants.{name}" if name in constants else name] = values
    return draws


def moved_parameters(system: System) -> set[str]:
    """Parameters of the loop for g_n and theta, where corners have others than members."""
    ranges, plant = ranges_of(system), system.plant
    names = {"input_gain": f"true_g_{plant.n - 1}"}
    names |= {f"theta[{i}]": f"true_theta_{i}" for i in range(plant.r)}
    return {names[name] for name in ranges if name in names} if count_of(ranges) else set()


@dataclass(frozen=True)
class Corners:
    """What the runs at the corners of the ranges gave.

    Attributes
    ----------
    constants : one mapping of names to values for each corner
        Of all that has a range, ``input_gain`` and ``theta[0]`` among them.
    errors : floats
        Tail error at each corner; inf where the run does not finish.
    outcomes : names of outcomes
    limit : float, optional
        That of the ensemble.
    """

    constants: tuple[dict[str, float], ...]
    errors: tuple[float, ...]
    outcomes: tuple[str, ...]
    limit: float | None

    @classmethod
    def of(cls, system: System, statistics: Statistics, limit: float | None) -> Corners:
        """The corners of a system from their statistics, with the metrics of each."""
        ranges = ranges_of(system)
        assert statistics.table is not None
        parts = sorted(statistics.table.parts, key=lambda part: part[0])
        tails = np.concatenate([metrics[METRICS.index("tail_error")] for _, metrics, _ in parts])
        codes = np.concatenate([outcomes for *_, outcomes in parts])
        values = corner_values(ranges, np.arange(len(tails)))
        names = [outcome.name for outcome in Outcome]
        return cls(
            tuple({n: float(v[k]) for n, v in values.items()} for k in range(len(tails))),
            tuple(np.where(np.isnan(tails), math.inf, tails).tolist()),
            tuple(names[code] for code in codes),
            limit,
        )

    @property
    def worst(self) -> int:
        """The corner with the largest tail error; the first that is lost, if one is."""
        return max(range(len(self.errors)), key=self.errors.__getitem__)

    @property
    def lost(self) -> int:
        """How many do not finish."""
        return sum(math.isinf(error) for error in self.errors)

    @property
    def beyond(self) -> int | None:
        """How many are beyond the limit, lost ones among them; None without a limit."""
        return None if self.limit is None else sum(error > self.limit for error in self.errors)

    def summary(self) -> dict[str, Any]:
        """Ready for JSON; the tail error of a lost one is null."""
        worst = self.worst
        return {
            "count": len(self.errors),
            "lost": self.lost,
            "beyond": self.beyond,
            "worst": {
                "corner": worst,
                "constants": self.constants[worst],
                "tail_error": self.errors[worst],
                "outcome": self.outcomes[worst],
            },
        }
