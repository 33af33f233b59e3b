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
from certrack.core.expressions import TIME
from certrack.integrators.base import ESCAPING, Outcome
from certrack.integrators.event_location import TIME_ROUNDING, first_root
from certrack.integrators.registers import whole_registers
from certrack.integrators.sampled.step_control import (
    END_ROUNDING,
    ERROR_SHARE,
    MAX_FACTOR,
    MAX_INTERVAL_STEPS,
    SHORTEST_STEP,
    next_factor,
)
from certrack.integrators.switching import ON_SURFACE, ModeRecord, Refused, Rush, Surfaces
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
    found = switching(loop.plant.rates, loop.plant.states)
    if found is None:
        return loop, None
    names = [TIME, loop.plant.states, INPUT, [*loop.parameters, *loop.pieces]]
    (slope,) = found.resolved([loop.slope])
    plant = replace(loop.plant, rates=found.rates)
    moded = replace(loop, plant=plant, slope=slope, pieces=(*loop.pieces, *found.modes))
    return moded, Surfaces(found, names)


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

    def cross(
        self, begin: float, end: float, on_step: OnStep | None
    ) -> tuple[Array, Array]:
        """States and totals of all members at `end`."""
        run, h = self._run, end - begin
        x, u, p = run.x, run.u, run.parameters
        count, step = x.shape[1], run.step_map
        half, _, _ = step(begin, h / 2, run.allowed, x, u, run.totals, p)
        after, totals, error = step(begin, h, run.allowed, x, u, run.totals, p)
        rest, modes = self._split(p)
        three = np.concatenate([x, half, after], axis=1)
        t = np.repeat([begin, begin + h / 2, end], count)
        kept = self._surfaces.watch(
            [t, three, np.tile(u, 3), np.tile(rest, 3)], np.tile(modes, 3), 3 * count
        ).reshape(-1, 3, count)
        start, middle, last = kept[:, 0], kept[:, 1], kept[:, 2]
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
            done = self._alone(i, begin, end, on_step)
            after[:, i], totals[:, i] = np.nan, np.nan
            if done is not None:
                after[:, i], totals[:, i] = done
        return after, totals

    def _note(self, t: float, p: Array) -> None:
        modes = self._split(p)[1]
        if not self._record or not np.array_equal(self._record[-1][1], modes):
            self._record.append((t, modes.copy()))

    def _alone(
        self, i: int, begin: float, end: float, on_step: OnStep | None
    ) -> tuple[Array, Array] | None:
        """One member from event to event; None where it is given up."""
        run, surfaces = self._run, self._surfaces
        one = _Member(run, i)
        rush, t, h, reached = Rush(), begin, end - begin, ()
        shortest = SHORTEST_STEP * end
        for _ in range(MAX_INTERVAL_STEPS):
            rest, modes = self._split(one.p)
            try:
                place = [t, one.x, one.u, rest]
                state, modes = surfaces.settled(place, modes, reached)
            except Refused:
                return self._given_up(one, i, Outcome.chattering)
            one.x, one.p[-self._end :] = state, modes
            limit = surfaces.threshold([t, one.x, one.u, rest], modes)
            if on_step is not None and not i:
                self._note(t, one.p)
            reached = ()
            while True:  # a step that is accurate
                final = t + h >= end * (1 - END_ROUNDING)
                h = end - t if final else max(h, shortest)
                x, totals, error = one.step(t, h)
                factor = float(next_factor(np.array(error), MAX_FACTOR))
                if error <= (1.0 if h > shortest else 1.0 / ERROR_SHARE):
                    break
                if h <= shortest:
                    return self._given_up(one, i, Outcome.undefined)
                h *= factor

            def holds(since: float, t: float = t, limit: Array = limit) -> Array:
                state = one.step(t, since)[0] if since else one.x
                rest, modes = self._split(one.p)
                kept: Array = surfaces.watch([t + since, state, one.u, rest], modes, 1)[:, 0]
                return kept + limit

            event = self._event(holds, h, TIME_ROUNDING * end)
            if event is not None:
                at, row = event
                if at < h:
                    x, totals, _ = one.step(t, at)
                try:
                    rush.add(t)
                except Refused:
                    return self._given_up(one, i, Outcome.chattering)
                reached = () if modes[surfaces.count + row] else (row,)
                t = min(t + at, end)
            else:
                t = end if final else t + h
                h *= factor
            one.x, one.totals = x, totals
            if on_step is not None and not i:
                on_step(t, x[:, None], totals[:, None], run.u)
            if t >= end:
                if event is not None:
                    rest, modes = self._split(one.p)
                    try:
                        place = [t, one.x, one.u, rest]
                        one.x, one.p[-self._end :] = surfaces.settled(place, modes, reached)
                    except Refused:
                        return self._given_up(one, i, Outcome.chattering)
                run.parameters[-self._end :, i] = one.p[-self._end :]
                return one.x, one.totals
            if event is not None:
                h = end - t
        return self._given_up(one, i, Outcome.step_limit)

    @staticmethod
    def _event(holds: Any, h: float, rounding: float) -> tuple[float, int] | None:
        """The first time in a step at which a mode ends, and the surface."""
        since = np.array([0.0, h / 2, h])
        values = np.array([holds(at) for at in since.tolist()]).T
        found: tuple[float, int] | None = None
        for row, samples in enumerate(values):
            at = first_root(lambda at, row=row: float(holds(at)[row]), since, samples, rounding)  # type: ignore[misc]
            if at is not None and (found is None or at < found[0]):
                found = at, row
        return found

    def _given_up(self, one: _Member, i: int, reason: Outcome) -> None:
        wild = np.abs(one.x).max() > ESCAPING
        self._run.outcomes[i] = Outcome.escaped if wild else reason
        self._run.run_alone[i] = not wild


class _Member:
    """One member of a run, by the run's map."""

    def __init__(self, run: SampledRun, i: int) -> None:
        self._run = run
        self.x, self.totals, self.p = run.x[:, i].copy(), run.totals[:, i].copy(), run.parameters[:, i].copy()
        self.u = run.u[i]
        self._lanes = 1 if run.x.shape[1] == 1 else len(whole_registers(1))

    def step(self, t: float, h: float) -> tuple[Array, Array, float]:
        """State, totals and error after a step."""

        def column(values: Array) -> Array:
            return np.repeat(values[:, None], self._lanes, axis=1)

        run = self._run
        x, totals, error = run.step_map(
            t,
            h,
            run.allowed,
            column(self.x),
            np.full(self._lanes, self.u),
            column(self.totals),
            column(self.p),
        )
        return x[:, 0].copy(), totals[:, 0].copy(), float(error[0])


def values_of(problem_pieces: Sequence[float], surfaces: Surfaces | None) -> Array:
    """Piece values followed by the modes at the start."""
    pieces = np.asarray(problem_pieces, dtype=float)
    if surfaces is None:
        return pieces
    return np.concatenate([pieces, np.ones(surfaces.count), np.zeros(surfaces.count)])
