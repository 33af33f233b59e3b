"""The inputs of a controlled loop, made worse turn by turn.

The adjoint gives the slopes of e_1 at the end, or of another output that is sought. Two kinds of
step take turns, and neither leaves what is admissible:

* shares and constants go along their slopes, and stop at the ends of their ranges: a long step is a
  pattern of signs, and corners;
* the reference goes a part of the way to the one that the slopes like best, a linear program: those
  on the way are within its bounds too (the method of Frank and Wolfe).

A step that makes nothing worse is taken back, and the next one is shorter; else it is longer. Of a
linear loop the first two steps go all the way to the worst there is. Members that stay behind are
given up, half of them at a time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certrack.certificates.worst_profile import worst_profile
from certrack.core.arrays import Array
from certrack.studies.falsifier.ascent.loop import RESTING_PIECES, AdversaryInputs, ControlledLoop

#: The first step of shares, over the slopes' root mean square; shortest and longest step.
BEGINNING_STEP, TINIEST_STEP, FULL_STEP = 100.0, 1e-3, 1e6

#: By what a step that was good is longer, and one that was not is shorter.
BETTER_FACTOR, WORSE_FACTOR = 3.0, 0.3

#: The smallest part of the way to the best reference that is tried.
LEAST_WAY = 1e-3

#: A step is good if it gains more than this part of the error.
WORTH_A_CLIMB = 1e-6


class Climb:
    """Members on their way up.

    Parameters
    ----------
    loop : ControlledLoop
    inputs : AdversaryInputs
        Those to begin with.
    senses : (N,) array
        1 or -1: which side of the error is to grow.

    Attributes
    ----------
    errors : (N,) array
        e_1, or what else is sought, times the sense.
    runs : int
        Runs spent, there and back.
    last_gain : float
        By what part the last turn made the largest error larger.
    """

    def __init__(self, loop: ControlledLoop, inputs: AdversaryInputs, senses: Array) -> None:
        self.loop, self.inputs, self.senses, self.runs = loop, inputs, senses, 0
        self.errors, self.slopes = self._at(inputs)
        self.last_gain = 0.0
        self._step = np.full(inputs.count, BEGINNING_STEP)
        self._part = np.ones(inputs.count)
        self._goals: AdversaryInputs | None = None
        self._old = np.ones(inputs.count, dtype=bool)

    def _at(self, inputs: AdversaryInputs) -> tuple[Array, AdversaryInputs]:
        """Errors, those of runs that escaped the least of all, and their slopes."""
        self.runs += inputs.count
        errors, slopes = self.loop.slopes(inputs)
        errors = np.where(np.isfinite(errors), self.senses * errors, -np.inf)
        return errors, AdversaryInputs(
            *(np.nan_to_num(self.senses * part) for part in slopes.parts())
        )

    def leap(self) -> None:
        """All the way to the best of everything at once, where that is better."""
        best = self._along(FULL_STEP)
        self._try(self._to_reference(best, np.ones_like(self._part)))

    def turn(self) -> None:
        """A step of shares and constants, and one of the reference."""
        before = float(self.errors.max())
        good = self._try(self._along(self._step))
        self._step = np.clip(
            self._step * np.where(good, BETTER_FACTOR, WORSE_FACTOR), TINIEST_STEP, FULL_STEP
        )
        good = self._try(self._to_reference(self.inputs, self._part))
        part = np.where(good, np.minimum(1.0, 2 * self._part), self._part / 2)
        self._part = np.maximum(LEAST_WAY, part)
        self.last_gain = float(self.errors.max()) / before - 1 if before > 0 else 0.0

    def _try(self, inputs: AdversaryInputs) -> Array:
        """Take what is better."""
        errors, slopes = self._at(inputs)
        good = errors > self.errors + WORTH_A_CLIMB * np.abs(self.errors)
        self.errors = np.where(good, errors, self.errors)
        self.inputs = inputs.where(good, self.inputs)
        self.slopes = slopes.where(good, self.slopes)
        self._old |= good
        return good

    def _along(self, step: Array | float) -> AdversaryInputs:
        """Shares and constants along their slopes."""
        now, slopes = self.inputs, self.slopes
        rise = slopes.shares.copy()
        for j, held in enumerate(self.loop.held):
            if held:
                rise[:, j] = rise[:, j].mean(axis=0)
        size = np.sqrt((rise**2).mean(axis=(0, 1), keepdims=True)) + 1e-300 if rise.size else 1.0
        shares = np.clip(now.shares + step * rise / size, -1, 1)
        low, high = self.loop.ranges[:, :1], self.loop.ranges[:, 1:]
        across = (high - low) * slopes.truths
        size = np.sqrt((across**2).mean(axis=0, keepdims=True)) + 1e-300 if across.size else 1.0
        truths = np.clip(now.truths + step * (high - low) * across / size, low, high)
        return AdversaryInputs(shares, now.begin, now.pieces, truths)

    def _to_reference(self, now: AdversaryInputs, part: Array) -> AdversaryInputs:
        """The inputs with their reference on its way to the best one."""
        if self._goals is None:
            self._goals = self.inputs
        begin, pieces = self._goals.begin.copy(), self._goals.pieces.copy()
        for i in np.flatnonzero(self._old):
            slopes, widths = self.slopes, self.loop.piece_widths
            gains = np.concatenate([slopes.begin[:, i], slopes.pieces[: len(widths), i]])
            program = worst_profile(gains, self.loop.bounds, widths, RESTING_PIECES)
            if program is not None:
                begin[:, i] = program.start
                pieces[:, i] = program.pieces
        self._old[:] = False
        self._goals = AdversaryInputs(now.shares, begin, pieces, now.truths)
        return now.towards(self._goals, part)

    def keep(self, members: Array) -> None:
        """Go on with these members alone."""
        self.inputs, self.slopes = self.inputs.subset(members), self.slopes.subset(members)
        self._goals = None if self._goals is None else self._goals.subset(members)
        self.senses, self.errors = self.senses[members], self.errors[members]
        self._step, self._part, self._old = (
            v[members] for v in (self._step, self._part, self._old)
        )


def climb(
    loop: ControlledLoop,
    inputs: AdversaryInputs,
    senses: Array,
    turns: int,
    tell: Callable[[Climb], None] = lambda _: None,
) -> Climb:
    """Members after so many turns in which the worse half was given up, again and again, to two.

    Parameters
    ----------
    loop, inputs, senses
        As in :class:`Climb`.
    turns : int
        For each number of members.
    tell : callable
        Called after each turn.
    """
    members = Climb(loop, inputs, senses)
    members.leap()
    while True:
        for _ in range(turns):
            members.turn()
            tell(members)
        count = len(members.errors)
        if count <= 2:
            return members
        members.keep(np.sort(np.argsort(-members.errors, kind="stable")[: (count + 1) // 2]))
