"""When something happens to a plant under a sampled controller: the same times for all members."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from certrack.core.arrays import Array
from certrack.model.implementation import Implementation
from certrack.model.jitter import timing_shifts

#: Events closer than this part of a period are one, and so are those closer than
#: `EVENT_ROUNDING` times the run: rounding may have separated what the user meant to be one.
EVENT_GAP, EVENT_ROUNDING = 1e-9, 1e-15

#: Nothing begins this part of the run before its end.
END_MARGIN = 1e-12


class _Kind(IntEnum):
    """What happens at an event, in the order of the columns below."""

    sample = 0
    action = 1
    jump = 2
    mark = 3
    edge = 4


#: Whose time holds where events are one; the last has the say: at a break the new piece holds.
_PRECEDENCE = (_Kind.mark, _Kind.action, _Kind.sample, _Kind.jump, _Kind.edge)


@dataclass(frozen=True)
class EventTimeline:
    """All events of a run, in order.

    Attributes
    ----------
    times : (K+1,) array, s
        From the begin to the end of the run.
    clock : (K+1,) array, s
        The times as the controller knows them: those of samples are without jitter.
    samples, acts : (K+1,) arrays of bool
        Where a sample is taken; where the next command begins to act.
    breaks : (K+1,) array of int
        How many new pieces of the reference, or of what is totalled, begin there.
    marks : (K+1,) array of int
        Number of the time of interest there, or -1.
    """

    times: Array
    clock: Array
    samples: Array
    acts: Array
    breaks: Array
    marks: Array


def event_timeline(
    implementation: Implementation, duration: float, breaks: Array, marks: Array
) -> EventTimeline:
    """The events of a run; those that rounding alone separates are one.

    Parameters
    ----------
    implementation : Implementation
        Sampling period, offset, delay and jitter.
    duration : float, s
    breaks : array, s
        Where rates, the reference or what is totalled may jump.
    marks : array, s
        Times of interest, increasing.
    """
    period = implementation.period
    nominal = implementation.offset + period * np.arange(implementation.samples(duration))
    nominal = nominal[nominal < duration * (1 - END_MARGIN)]
    shifts = period * timing_shifts(implementation, len(nominal))
    samples = np.maximum(nominal + shifts[0], 0.0)
    nominal = nominal[samples < duration * (1 - END_MARGIN)]
    samples = samples[: len(nominal)]
    actions = nominal + implementation.run_delay * period + shifts[1, : len(nominal)]
    actions = actions[actions < duration * (1 - END_MARGIN)]
    columns = [samples, actions, np.asarray(breaks), np.asarray(marks), np.array([0.0, duration])]
    times = np.concatenate(columns)
    kind = np.repeat(np.arange(len(columns)), [len(column) for column in columns])
    order = np.argsort(times, kind="stable")  # of equal times in the order of their kinds
    gaps = np.diff(times[order], prepend=-np.inf)
    event = np.empty(len(times), dtype=int)
    close = max(EVENT_GAP * min(period, duration), EVENT_ROUNDING * duration)
    event[order] = np.cumsum(gaps > close) - 1
    merged = np.empty(event.max() + 1)
    for part in _PRECEDENCE:
        merged[event[kind == part]] = times[kind == part]

    def has(part: _Kind) -> Array:
        flags = np.zeros(len(merged), dtype=bool)
        flags[event[kind == part]] = True
        return flags

    clock = merged.copy()
    clock[event[kind == _Kind.sample]] = nominal
    numbers = np.full(len(merged), -1)
    numbers[event[kind == _Kind.mark]] = np.arange(len(marks))
    pieces = np.bincount(event[kind == _Kind.jump], minlength=len(merged))
    return EventTimeline(merged, clock, has(_Kind.sample), has(_Kind.action), pieces, numbers)
