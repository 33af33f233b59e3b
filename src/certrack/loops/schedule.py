"""When a run has to stop and restart: at breaks of the reference, switches and bursts of time.

* Breaks and pieces of the reference are its own (:mod:`certrack.references`).
* Switches of time (:mod:`certrack.loops.time_switches`) are breaks where their functions change
  sign; from break to break a switch is a constant.
* Bursts (:mod:`certrack.loops.bursts`) are where a smooth formula of t moves much faster than it
  did before; a loop at rest would step across them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.sign_changes import sign_changes, signs
from certrack.loops.bursts import Scan, scan
from certrack.loops.time_switches import TimeSwitches
from certrack.references import Reference, pieces_at

#: Two times closer than this part of the run are one: rounding separated them.
BREAK_BLUR = 1e-13


class Pieces(Protocol):
    """What changes from break to break of a run; a reference is one."""

    def breaks(self, start: float, end: float) -> Array:
        """Increasing times strictly inside (start, end), s."""

    def piece_values(self, t: float) -> Array:
        """Values of the piece's symbols from a break on."""


@dataclass(frozen=True)
class Schedule:
    """Breaks of a run, and the values that hold from each on: :class:`Pieces`.

    Attributes
    ----------
    reference : Reference
    switches : TimeSwitches
    times : (K,) array, s
        Switches and bursts.
    values : (S, K+1) array
        Of the switches, from the begin of the run and from each of the times on.
    scans : tuple of Scan
        What the search for bursts found.
    blur : float, s
        Times that are this close are the same.
    """

    reference: Reference
    switches: TimeSwitches
    times: Array
    values: Array
    scans: tuple[Scan, ...]
    blur: float

    def breaks(self, start: float, end: float) -> Array:
        """All breaks; one of the reference holds where two are the same but for rounding."""
        of_time = self.times[(self.times > start) & (self.times < end)]
        stated = np.asarray(self.reference.breaks(start, end), dtype=float)
        if not len(of_time):
            return stated
        near = _nearest(of_time, np.concatenate([[start, end], stated]))
        return np.union1d(stated, of_time[np.abs(near - of_time) > self.blur])

    def piece_values(self, t: float) -> Array:
        """Values of the reference's piece and of the switches on the piece that begins at t."""
        piece = self.reference.piece_values(t)
        if not len(self.values):
            return piece
        return np.concatenate([piece, self.switch_values(np.array([t]))[:, 0]])

    def switch_values(self, t: Array) -> Array:
        """Values of the switches at times, a row each; those after it where t is a switch."""
        later = np.searchsorted(self.times, t + self.blur, side="right")
        values: Array = self.values[:, later]
        return values

    def pieces_at(self, t: Array) -> Array:
        """Values of all symbols of the piece at every time, a row each."""
        if not len(self.values):
            return pieces_at(self.reference, t)
        return np.vstack([pieces_at(self.reference, t), self.switch_values(t)])

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know of the search for bursts."""
        return tuple(dict.fromkeys(entry.note for entry in self.scans if entry.note))


def make_schedule(
    reference: Reference,
    switches: TimeSwitches,
    numbers: Mapping[sympy.Symbol, float],
    duration: float,
    tolerance: float,
) -> Schedule:
    """Find all switches and bursts of a run.

    Parameters
    ----------
    reference : Reference
    switches : TimeSwitches
    numbers : mapping
        Values of :attr:`~certrack.loops.time_switches.TimeSwitches.numbers`, and maybe more.
    duration : float, s
    tolerance : float
        Of the integrator: the scan for bursts is as fine.

    Raises
    ------
    InputError
        If the switches are too many.
    """
    known = tuple(sorted((s.name, float(numbers[s])) for s in switches.numbers))
    times, values, scans = _searched(switches, known, duration, tolerance)
    return Schedule(reference, switches, times, values, scans, BREAK_BLUR * duration)


def _nearest(times: Array, others: Array) -> Array:
    """The nearest of others to each time."""
    others = np.sort(others)
    k = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    before, after = others[k - 1], others[k]
    return np.where(times - before < after - times, before, after)


@lru_cache(maxsize=64)
def _searched(
    switches: TimeSwitches,
    numbers: tuple[tuple[str, float], ...],
    duration: float,
    tolerance: float,
) -> tuple[Array, Array, tuple[Scan, ...]]:
    """Times, values of the switches, and scans; the same run is looked through once."""
    known = {sympy.Symbol(name, real=True): value for name, value in numbers}
    nodes = np.array([0.0, duration])
    for function in (*switches.branches, *switches.functions):
        new = sign_changes(function, nodes, known)
        nodes = np.union1d(nodes, new)
    distinct = np.concatenate([[True], np.diff(nodes) > BREAK_BLUR * duration])
    nodes = np.append(nodes[:-1][distinct[:-1]], duration)
    middles = (nodes[:-1] + nodes[1:]) / 2
    values = np.array([signs(function, middles, known) for function in switches.functions])
    values = values.reshape(len(switches.functions), len(middles))
    scans = tuple(
        scan(formula, nodes, known, dict(zip(switches.symbols, values, strict=True)), tolerance)
        for formula in switches.formulas
    )
    marks = np.concatenate([np.empty(0), *(entry.marks for entry in scans)])
    marks = marks[np.abs(_nearest(marks, nodes) - marks) > BREAK_BLUR * duration]
    times = np.union1d(nodes[1:-1], marks)
    owner = np.searchsorted(nodes[1:-1], np.concatenate([[0.0], times]), side="right")
    values = values[:, owner]
    times.setflags(write=False)
    values.setflags(write=False)
    return times, values, scans
