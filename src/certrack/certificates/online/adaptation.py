"""Update laws whose numbers move between two ends."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from certrack.certificates.adaptation import Adaptation


@dataclass(frozen=True)
class MovingAdaptation(Adaptation):
    """What the update laws contribute to V' where their numbers move.

    gain_rate, Gamma, leak_gain and leak_theta are the smallest of both ends.

    Attributes
    ----------
    largest_leaks : pair of numbers
        gbar1 and gbar2.
    falls : pair of numbers, 1/s
        The largest relative rates at which gbar and Gamma fall.
    """

    largest_leaks: tuple[Any, Any] = (0, 0)
    falls: tuple[Any, Any] = (0, 0)

    def leakage_cost(self, alpha: Any) -> Any:
        """q(alpha), worst over the ranges and over all that the numbers may be.

        The cost is a^2/(4 (a - b)) times a square, a a leakage and b below it: convex in a. It
        falls where gbar or Gamma grows.
        """
        total = 0
        for cost, least, largest, fall in zip(
            (self._cost_of_gain, self._cost_of_theta),
            (self.leak_gain, self.leak_theta),
            self.largest_leaks,
            self.falls,
            strict=True,
        ):
            costs = [cost(alpha + fall, leak) for leak in (least, largest)]
            if any(value is None for value in costs):
                return None
            total = total + max(costs)
        return total

    def in_floats(self) -> MovingAdaptation:
        plain = super().in_floats()
        return MovingAdaptation(
            **{entry.name: getattr(plain, entry.name) for entry in fields(plain)},
            largest_leaks=tuple(map(float, self.largest_leaks)),  # type: ignore[arg-type]
            falls=tuple(map(float, self.falls)),  # type: ignore[arg-type]
        )


def moving_adaptation(first: Adaptation, other: Adaptation, rate: Any) -> MovingAdaptation:
    """The update laws between two ends.

    Parameters
    ----------
    first, other : Adaptation
        They differ in gain_rate, the leakages and a diagonal Gamma at most.
    rate : number or None
        The largest |w'|, 1/s; None where gain_rate and Gamma are the same at both ends.
    """
    gbar, step = min(first.gain_rate, other.gain_rate), abs(first.gain_rate - other.gain_rate)
    Gamma, fall_of_Gamma = first.Gamma, 0
    if (first.Gamma != other.Gamma).any():
        diagonals = list(zip(np.diag(first.Gamma), np.diag(other.Gamma), strict=True))
        for i, (a, b) in enumerate(diagonals):
            Gamma = Gamma.copy() if i == 0 else Gamma
            Gamma[i, i] = min(a, b)
        fall_of_Gamma = max(rate * abs(a - b) / min(a, b) for a, b in diagonals)
    values = {entry.name: getattr(first, entry.name) for entry in fields(first)}
    least = {
        "gain_rate": gbar,
        "leak_gain": min(first.leak_gain, other.leak_gain),
        "leak_theta": min(first.leak_theta, other.leak_theta),
        "Gamma": Gamma,
    }
    return replace(
        MovingAdaptation(**(values | least)),
        largest_leaks=(
            max(first.leak_gain, other.leak_gain),
            max(first.leak_theta, other.leak_theta),
        ),
        falls=(rate * step / gbar if step else 0, fall_of_Gamma),
    )
