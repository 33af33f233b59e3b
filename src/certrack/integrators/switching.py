"""The modes of a system with switching surfaces, in numbers: which hold now, and until when.

The formulas are those of :mod:`certrack.loops.switching`. An integrator follows the rates of one
mode; :meth:`Surfaces.watch` says by its sign whether the mode still holds, and
:meth:`Surfaces.settled` which one holds where it does not: on every surface that the state is on,
the solution leaves to a side whose rates lead away from it, or slides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import sympy

from certrack.core.errors import CertrackError
from certrack.core.lowering import numpy_callable, rows
from certrack.loops.switching import Switching

#: A surface is reached within this part of 1 + |x|, which is near rounding.
ON_SURFACE = 1e-13

#: A state that slides may have drifted this far, as a part of 1 + |x|, by the errors of its steps;
#: where it is further away the surface has jumped, as at a break of the reference.
DRIFTED = 1e-6

#: Steps of this length, s, tell on which side a solution leaves that touches a surface.
LOOK_AHEAD = 1e-6

#: What such a step moves f by is rounding below this part of 1 + |x|, times the slopes of f.
LOOK_AHEAD_ROUNDING = 1e-15

#: More events in a row that do not move the time by `RUSH` altogether have no end.
MAX_RUSH, RUSH = 60, 1e-7

#: Evaluates a formula's values for one state: gets the callable, the state and the modes.
At = Callable[[Any, np.ndarray, np.ndarray], np.ndarray]


class SlidingRefused(CertrackError):
    """A motion on surfaces that is not simulated."""


@dataclass(frozen=True)
class ModeRecord:
    """The modes along a run.

    Attributes
    ----------
    surfaces : texts
        The formulas f_k.
    begins : (M,) array, s
        From when on each set of modes holds.
    modes : (M, 2 K) array
        Sides, then what is stuck.
    """

    surfaces: tuple[str, ...]
    begins: np.ndarray
    modes: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """The modes at times, shape (2 K, N)."""
        k = np.searchsorted(self.begins, np.asarray(t, dtype=float), side="right") - 1
        chosen: np.ndarray = self.modes[np.clip(k, 0, None)].T
        return chosen

    def stuck(self, t: np.ndarray) -> np.ndarray:
        """Whether the run slides along each surface at times, shape (K, N)."""
        return self.at(t)[len(self.surfaces) :] > 0

    def intervals(self, k: int, end: float) -> list[tuple[float, float]]:
        """From when to when surface k was slid along, in a run that ends at `end`."""
        held = self.modes[:, len(self.surfaces) + k] > 0
        change = np.diff(held.astype(int), prepend=0, append=0)
        times = np.append(self.begins, end)
        pairs = zip(
            times[change > 0].tolist(), times[change[: len(times)] < 0].tolist(), strict=True
        )
        return [(a, b) for a, b in pairs if b > a]


#: So many intervals a note states; the others are counted.
NOTED_INTERVALS = 4


def sticking_notes(modes: ModeRecord, end: float) -> list[str]:
    """What a run notes of the surfaces that it slid along, one line each."""
    notes = []
    for k, name in enumerate(modes.surfaces):
        spans = modes.intervals(k, end)
        if spans:
            shown = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in spans[:NOTED_INTERVALS])
            more = len(spans) - NOTED_INTERVALS
            others = f" and {more} more times" if more > 0 else ""
            total = sum(b - a for a, b in spans)
            notes.append(
                f"Stuck at {name} = 0 (sign() there): {shown}{others}; {total:.6g} s in all."
            )
    return notes


class Surfaces:
    """The switching surfaces of one compiled loop; its functions are called with one member.

    Parameters
    ----------
    switching : Switching
    arguments : sequence
        What the formulas are functions of, the states being ``arguments[place]``; modes come last.
    place : int
    """

    def __init__(self, switching: Switching, arguments: Sequence[Any], place: int = 1) -> None:
        everything = [*arguments, switching.modes]
        self.switching, self.place = switching, place
        self.count = len(switching.surfaces)
        self._signals = numpy_callable(everything, [*switching.surfaces, *switching.values])
        self._details = numpy_callable(
            everything,
            [
                *switching.surfaces,
                *switching.values,
                *switching.drifts,
                *switching.effects,
                *switching.crossed,
                *switching.gradients,
            ],
        )
        self._rates = numpy_callable(everything, switching.rates)

    @property
    def names(self) -> tuple[str, ...]:
        """The surfaces as texts."""
        return tuple(sympy.sstr(f) for f in self.switching.surfaces)

    def watch(self, arguments: Sequence[Any], modes: np.ndarray, count: int) -> np.ndarray:
        """What is negative where a mode holds no more, shape (K, N).

        Parameters
        ----------
        arguments : sequence
        modes : (2 K,) or (2 K, N) array
        count : int
            N.
        """
        K = self.count
        with np.errstate(all="ignore"):
            values = rows(self._signals(*arguments, modes), count)
        sides, stuck = modes[:K].reshape(K, -1), modes[K:].reshape(K, -1)
        signals: np.ndarray = np.where(stuck > 0, 1.0 - np.abs(values[K:]), sides * values[:K])
        return signals

    def threshold(self, arguments: Sequence[Any], modes: np.ndarray) -> np.ndarray:
        """How far below zero :meth:`watch` may be by rounding, (K,)."""
        K = self.count
        x, parts = arguments[self.place], self._parts(arguments, modes)
        size = ON_SURFACE * (1.0 + np.abs(x).max(initial=0.0)) * np.abs(parts[5]).sum(axis=1)
        limit: np.ndarray = np.where(modes[K:] > 0, 0.0, size)
        return limit

    def _parts(self, arguments: Sequence[Any], modes: np.ndarray) -> list[np.ndarray]:
        """f, s, drift, effect, crossed (K each) and the gradients (K, S), at one state."""
        K = self.count
        with np.errstate(all="ignore"):
            values = np.array(self._details(*arguments, modes), dtype=float)
        parts = [values[i * K : (i + 1) * K] for i in range(5)]
        return [*parts, values[5 * K :].reshape(K, -1)]

    def projected(
        self, arguments: Sequence[Any], modes: np.ndarray, close: Sequence[int]
    ) -> np.ndarray:
        """The state moved onto surfaces that it is close to, by a Newton step on all of them."""
        x = np.array(arguments[self.place], dtype=float)
        f, *_, slopes = self._parts(arguments, modes)
        others = []
        for k in close:
            if self.switching.surfaces[k] in self.switching.states:  # exactly
                x[self.switching.states.index(self.switching.surfaces[k])] = 0.0
            elif np.isfinite(f[k]):
                others.append(k)
        if others:
            shift = np.linalg.lstsq(slopes[others], f[others], rcond=None)[0]
            x[: len(shift)] -= np.where(np.isfinite(shift), shift, 0.0)
        return x

    def settled(
        self, arguments: Sequence[Any], modes: np.ndarray, reached: Sequence[int] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state, moved onto the surfaces it is on, and the modes that hold from here on.

        Parameters
        ----------
        arguments : sequence
        modes : (2 K,) array
            Until now.
        reached : numbers
            Surfaces that the state has just come to, within the accuracy of the event.

        Returns
        -------
        state, modes : arrays

        Raises
        ------
        SlidingRefused
            If the motion from here is one that is not simulated.
        """
        K, modes, place = self.count, modes.copy(), self.place
        arguments = list(arguments)
        x = arguments[place]
        f, *_, slopes = self._parts(arguments, modes)
        size = (1.0 + np.abs(x).max(initial=0.0)) * np.abs(slopes).sum(axis=1)
        on = [
            k
            for k in range(K)
            if k in reached or abs(f[k]) <= (DRIFTED if modes[K + k] else ON_SURFACE) * size[k]
        ]
        arguments[place] = x = self.projected(arguments, modes, on)
        for k in range(K):
            if k not in on and f[k]:
                modes[k], modes[K + k] = np.sign(f[k]), 0.0
        for _ in range(K + 1):  # what one surface does may change another
            before = modes.copy()
            done: set[int] = set()
            for k in on:
                partner = self.switching.partners[k]
                if k in done:
                    continue
                if partner is not None and partner in on:
                    modes = self._pair(arguments, modes, k, partner)
                    done |= {k, partner}
                else:
                    modes = self._single(arguments, modes, k)
            if np.array_equal(before, modes):
                break
        self._refuse_many(modes)
        return x, modes

    def _single(self, arguments: Sequence[Any], modes: np.ndarray, k: int) -> np.ndarray:
        """The mode of a surface that the state is on."""
        K = self.count
        _, _, drift, effect, *_ = self._parts(arguments, modes)
        up, down = drift[k] + effect[k], drift[k] - effect[k]
        modes = modes.copy()
        if up <= 0.0 <= down and effect[k] < 0.0:  # both sides lead to it
            modes[K + k] = 1.0
            return modes
        modes[K + k] = 0.0
        if effect[k] > 0.0 and up > 0.0 > down:  # both lead away: towards where the mean leads
            modes[k] = 1.0 if drift[k] >= 0.0 else -1.0
        elif up > 0.0 or down < 0.0:
            modes[k] = 1.0 if up > 0.0 else -1.0
        else:
            modes[k] = self._touching(arguments, modes, k)
        return modes

    def _touching(self, arguments: Sequence[Any], modes: np.ndarray, k: int) -> float:
        """The side on which a solution leaves whose f_k and f_k' are zero here."""
        leads = []
        for side in (1.0, -1.0):
            tried = modes.copy()
            tried[k], tried[self.count + k] = side, 0.0
            leads.append(side * self._ahead(arguments, tried, k))
        if leads[0] == leads[1] == 0.0:
            return float(modes[k])  # it rests
        if max(leads) < 0.0:
            raise SlidingRefused("both sides turn back to the surface, by their second derivatives")
        return 1.0 if leads[0] >= leads[1] else -1.0

    def _ahead(self, arguments: Sequence[Any], modes: np.ndarray, k: int) -> float:
        """f_k after a step of Heun's method, less what rounding blurs; time is argument 0."""
        now, h = list(arguments), LOOK_AHEAD
        x = np.asarray(now[self.place], dtype=float)
        with np.errstate(all="ignore"):
            first = np.array(self._rates(*now, modes), dtype=float)
            now[0], now[self.place] = arguments[0] + h, x + h * first
            second = np.array(self._rates(*now, modes), dtype=float)
        now[self.place] = x + h * (first + second) / 2
        parts = self._parts(now, modes)
        size = 1.0 + np.abs(x).max(initial=0.0)
        blur = LOOK_AHEAD_ROUNDING * size * np.abs(parts[5][k]).sum()
        value = float(parts[0][k])
        return value if abs(value) > blur else 0.0

    def _pair(self, arguments: Sequence[Any], modes: np.ndarray, i: int, j: int) -> np.ndarray:
        """The modes of two surfaces that interact, where the state is on both."""
        K = self.count
        _, s, drift, effect, crossed, _ = self._parts(arguments, modes)
        base = np.array([drift[i], drift[j]])
        base -= np.array([crossed[i] * s[j], crossed[j] * s[i]])
        matrix = np.array([[effect[i], crossed[i]], [crossed[j], effect[j]]])
        for choice in product((0.0, 1.0, -1.0), repeat=2):
            value = np.array(choice)
            slides = value == 0.0
            if (slides & (np.diag(matrix) >= 0)).any():
                continue
            if slides.any():
                free = np.flatnonzero(slides)
                try:
                    right = -(base + matrix @ value)[free]
                    value[free] = np.linalg.solve(matrix[np.ix_(free, free)], right)
                except np.linalg.LinAlgError:
                    continue
            speed = base + matrix @ value
            if (np.abs(value) <= 1.0).all() and (slides | (value * speed > 0)).all():
                chosen = modes.copy()
                for k, side, held in zip((i, j), value, slides, strict=True):
                    chosen[k], chosen[K + k] = (modes[k], 1.0) if held else (side, 0.0)
                return chosen
        return self._single(arguments, self._single(arguments, modes, i), j)

    def _refuse_many(self, modes: np.ndarray) -> None:
        """Surfaces that interact may be slid along at the same time if they are partners."""
        K, partners = self.count, self.switching.partners
        for pair in self.switching.bound:
            i, j = pair
            if modes[K + i] and modes[K + j] and partners[i] != j:
                raise SlidingRefused("more than two surfaces that interact")


class Rush:
    """Counts events that follow one another so fast that they have no end."""

    def __init__(self) -> None:
        self._times: list[float] = []

    def add(self, t: float) -> None:
        """An event at t.

        Raises
        ------
        SlidingRefused
        """
        self._times = [*self._times[-MAX_RUSH:], t]
        if len(self._times) > MAX_RUSH and t - self._times[0] <= RUSH * max(1.0, abs(t)):
            raise SlidingRefused("its events have no end")
