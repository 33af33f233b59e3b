"""A plant that switches and slides, between two events of a sampled loop.

All members try the interval in one step of the mode they are in. Those whose mode does not hold
until its end, and those whose step was not accurate enough, cross it each by itself: from one event
of theirs to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import CertrackError
from certrack.core.expressions import TIME
from certrack.integrators.base import ESCAPING, Outcome
from certrack.integrators.event_location import EVENT_TIME_ROUNDING, first_root
from certrack.integrators.registers import whole_registers
from certrack.integrators.sampled.step_control import (
    END_ROUNDING,
    ERROR_SHARE,
    MAX_FACTOR,
    MAX_INTERVAL_STEPS,
    SHORTEST_STEP,
    next_factor,
)
from certrack.integrators.switching import ON_SURFACE, ModeRecord, Rush, SlidingRefused, Surfaces
from certrack.loops.plant import INPUT
from certrack.loops.sampled import SampledLoop
from certrack.loops.switching import switching

if TYPE_CHECKING:
    from certrack.integrators.sampled.run import OnStep, SampledRun


def with_modes(loop: SampledLoop) -> tuple[SampledLoop, Surfaces | None]:
    """The loop with its plant's modes as the last symbols of its pieces, and their surfaces.

    Parameters
    ----------
    loop : SampledLoop

    Returns
    -------
    loop : SampledLoop
        The same where the plant does not switch.
    surfaces : Surfaces or None
    """
    switched = switching(loop.plant.rates, loop.plant.states)
    if switched is None:
        return loop, None
    names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
    (slope,) = switched.resolved([loop.slope])
    plant = replace(loop.plant, rates=switched.rates)
    moded = replace(loop, plant=plant, slope=slope, pieces=(*loop.pieces, *switched.modes))
    return moded, Surfaces(switched, names)


class Crossing:
    """Takes the members of a run from one event of the loop to the next.

    Parameters
    ----------
    run : SampledRun
    surfaces : Surfaces
    """

    def __init__(self, run: SampledRun, surfaces: Surfaces) -> None:
        self._run, self._surfaces = run, surfaces
        self._end = 2 * surfaces.count
        self._record: list[tuple[float, Array]] = []

    def modes(self) -> ModeRecord:
        """The modes of the first member, if its steps were asked for."""
        p = self._run.parameters[:, 0]
        begins, modes = zip(*(self._record or [(0.0, self._split(p)[1])]), strict=True)
        return ModeRecord(self._surfaces.names, np.array(begins), np.array(modes))

    def _split(self, p: Array) -> tuple[Array, Array]:
        """Parameters and pieces, and modes."""
        return p[: -self._end], p[-self._end :]

    def cross(self, begin: float, end: float, on_step: OnStep | None) -> tuple[Array, Array]:
        """States and totals of all members at `end`."""
        run, h = self._run, end - begin
        x, u, p = run.x, run.u, run.parameters
        count, step = x.shape[1], run.step_map
        half, _, _ = step(begin, h / 2, run.allowed, x, u, run.totals, p)
        after, totals, error = step(begin, h, run.allowed, x, u, run.totals, p)
        others, modes = self._split(p)
        three = np.concatenate([x, half, after], axis=1)
        t = np.repeat([begin, begin + h / 2, end], count)
        signals = self._surfaces.watch(
            [t, three, np.tile(u, 3), np.tile(others, 3)], np.tile(modes, 3), 3 * count
        ).reshape(-1, 3, count)
        start, middle, last = signals[:, 0], signals[:, 1], signals[:, 2]
        nothing = np.where(
            modes[self._surfaces.count :] > 0, 0.0, ON_SURFACE * (1.0 + np.abs(x).max(axis=0))
        )
        curve = start - 2 * middle + last
        dips = (middle < start) & (middle < last) & (middle <= curve)
        stays = ((start >= nothing) & (middle >= 0.0) & (last >= 0.0) & ~dips).all(axis=0)
        alone = np.flatnonzero(~(stays & (error <= 1.0)) & run.alive)
        if on_step is not None and not (len(alone) and alone[0] == 0):
            self._note(begin, p[:, 0])
            on_step(end, after, totals, u)
        for i in alone.tolist():
            try:
                after[:, i], totals[:, i] = self._alone(i, begin, end, on_step)
            except _Lost as lost:
                after[:, i], totals[:, i] = np.nan, np.nan
                run.outcomes[i] = lost.outcome
                run.run_alone[i] = lost.outcome is not Outcome.escaped
        return after, totals

    def _note(self, t: float, p: Array) -> None:
        modes = self._split(p)[1]
        if not self._record or not np.array_equal(self._record[-1][1], modes):
            self._record.append((t, modes.copy()))

    def _alone(
        self, i: int, begin: float, end: float, on_step: OnStep | None
    ) -> tuple[Array, Array]:
        """One member from event to event: its state and totals at `end`."""
        run, surfaces = self._run, self._surfaces
        one, rush = _Member(run, i), Rush()
        t, h = begin, end - begin
        reached: tuple[int, ...] = ()
        for _ in range(MAX_INTERVAL_STEPS):
            self._settle(one, t, reached)
            if on_step is not None and not i:
                self._note(t, one.p)
            if t >= end:
                run.parameters[-self._end :, i] = one.p[-self._end :]
                return one.x, one.totals
            h, x, totals, longer = one.accurate_step(t, h, end)
            others, modes = self._split(one.p)
            limit = surfaces.threshold([t, one.x, one.u, others], modes)

            def holds(since: float, t: float = t, limit: Array = limit) -> Array:
                state = one.step(t, since)[0] if since else one.x
                others, modes = self._split(one.p)
                signals: Array = surfaces.watch([t + since, state, one.u, others], modes, 1)[:, 0]
                return signals + limit

            event = self._event(holds, h, EVENT_TIME_ROUNDING * end)
            reached = ()
            if event is None:
                t, h = (end if t + h >= end * (1 - END_ROUNDING) else t + h), longer
            else:
                at, row = event
                if at < h:
                    x, totals, _ = one.step(t, at)
                reached = () if modes[surfaces.count + row] else (row,)
                t = min(t + at, end)
                h = end - t
                try:
                    rush.add(t)
                except SlidingRefused:
                    raise _lost(one, Outcome.chattering) from None
            one.x, one.totals = x, totals
            if on_step is not None and not i:
                on_step(t, x[:, None], totals[:, None], run.u)
        raise _lost(one, Outcome.step_limit)

    def _settle(self, one: _Member, t: float, reached: Sequence[int]) -> None:
        """Put a member into the mode that holds from now on."""
        others, modes = self._split(one.p)
        try:
            one.x, one.p[-self._end :] = self._surfaces.settled(
                [t, one.x, one.u, others], modes, reached
            )
        except SlidingRefused:
            raise _lost(one, Outcome.chattering) from None

    @staticmethod
    def _event(holds: Any, h: float, rounding: float) -> tuple[float, int] | None:
        """The first time in a step at which a mode ends, and the surface."""
        since = np.array([0.0, h / 2, h])
        values = np.array([holds(at) for at in since.tolist()]).T
        earliest: tuple[float, int] | None = None
        for row, samples in enumerate(values):
            at = first_root(lambda at, row=row: float(holds(at)[row]), since, samples, rounding)  # type: ignore[misc]
            if at is not None and (earliest is None or at < earliest[0]):
                earliest = at, row
        return earliest


class _Lost(CertrackError):
    """A member that cannot go on."""

    outcome = Outcome.step_limit


def _lost(one: _Member, outcome: Outcome) -> _Lost:
    """The error that ends a member where it is; large states are escaping."""
    error = _Lost(outcome.value)
    error.outcome = Outcome.escaped if np.abs(one.x).max() > ESCAPING else outcome
    return error


class _Member:
    """One member of a run, by the run's map."""

    def __init__(self, run: SampledRun, i: int) -> None:
        self._run = run
        self.x, self.totals = run.x[:, i].copy(), run.totals[:, i].copy()
        self.p, self.u = run.parameters[:, i].copy(), run.u[i]
        self._lanes = 1 if run.x.shape[1] == 1 else len(whole_registers(1))

    def step(self, t: float, h: float) -> tuple[Array, Array, float]:
        """State, totals and error after a step."""

        def column(values: Array) -> Array:
            return np.repeat(values[:, None], self._lanes, axis=1)

        run, u = self._run, np.full(self._lanes, self.u)
        x, totals, error = run.step_map(
            t, h, run.allowed, column(self.x), u, column(self.totals), column(self.p)
        )
        return x[:, 0].copy(), totals[:, 0].copy(), float(error[0])

    def accurate_step(self, t: float, h: float, end: float) -> tuple[float, Array, Array, float]:
        """Length, state and totals of a step of at most h that is accurate; the next length."""
        shortest = SHORTEST_STEP * end
        while True:
            final = t + h >= end * (1 - END_ROUNDING)
            h = end - t if final else max(h, shortest)
            x, totals, error = self.step(t, h)
            factor = float(next_factor(np.array(error), MAX_FACTOR))
            if error <= (1.0 if h > shortest else 1.0 / ERROR_SHARE):
                return h, x, totals, h * factor
            if h <= shortest:
                raise _lost(self, Outcome.undefined)
            h *= factor


def values_of(pieces: Array, surfaces: Surfaces | None) -> Array:
    """Piece values followed by the modes at the start."""
    if surfaces is None:
        return pieces
    return np.concatenate([pieces, np.ones(surfaces.count), np.zeros(surfaces.count)])
