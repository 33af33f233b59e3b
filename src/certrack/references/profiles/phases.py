"""Phases of a move: times in which one derivative, the highest, is constant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple


class Phase(NamedTuple):
    """A stretch of time in s, and the highest derivative during it: floats, or exact rationals."""

    duration: Any
    value: Any


@dataclass(frozen=True)
class Profile:
    """A move from rest to rest whose speed is symmetric in time.

    Attributes
    ----------
    rise : phases
        From rest to where the acceleration is zero, or with a limited snap to where it is largest.
    cruise : number, s
        How long the largest speed is held.
    order : int
        Of the derivative that the phases state.
    fall : phases
        From the largest acceleration to none, where the rise ends there.
    """

    rise: tuple[Phase, ...]
    cruise: Any
    order: int
    fall: tuple[Phase, ...] = ()

    @property
    def half(self) -> tuple[Phase, ...]:
        """From rest to the largest speed."""
        return (*self.rise, *self.fall)

    @property
    def duration(self) -> Any:
        """Of the move, s."""
        return 2 * sum(phase.duration for phase in self.half) + self.cruise

    def phases(self) -> tuple[Phase, ...]:
        """All phases that last some time; neighbours of one value are one."""
        speed = self.rise[-1].value if self.order == 1 else self.cruise * 0
        every = (*self.half, Phase(self.cruise, speed), *mirrored(self.half, self.order))
        joined: list[Phase] = []
        for phase in every:
            if joined and joined[-1].value == phase.value:
                joined[-1] = Phase(joined[-1].duration + phase.duration, phase.value)
            elif phase.duration:
                joined.append(phase)
        return tuple(joined)


def mirrored(phases: Sequence[Phase], order: int) -> tuple[Phase, ...]:
    """The same backwards in time: odd derivatives keep their sign."""
    sign = 1 if order % 2 else -1
    return tuple(Phase(p.duration, sign * p.value) for p in reversed(phases))


def following(state: Sequence[Any], phase: Phase) -> tuple[Any, ...]:
    """y ... y^(n-1) at the end of a phase from those at its begin, in whatever numbers they are."""
    every, powers = (*state, phase.value), [phase.duration * 0 + 1]
    for k in range(1, len(every)):
        powers.append(powers[-1] * phase.duration / k)
    return tuple(
        sum((every[j] * powers[j - i] for j in range(i + 1, len(every))), every[i])
        for i in range(len(state))
    )


def travelled(phases: Sequence[Phase], order: int) -> Any:
    """y at the end of phases that begin at zero, at rest."""
    state: tuple[Any, ...] = (phases[0].duration * 0,) * order
    for phase in phases:
        state = following(state, phase)
    return state[0]
