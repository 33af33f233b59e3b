"""Many members of one system side by side: one compiled Runge-Kutta step for all (heyoka).

All members share a time grid. A member crosses an interval of the grid in 2^level equal steps of an
embedded pair; its level follows from its own error estimate alone, so what a member computes does
not depend on its neighbours. What depends on time alone is evaluated once for all members. The
result lies on the grid without interpolation, which is why this beats adaptive steps where many
grid points are looked at.

Kinks (abs, sign, min, max) are lowered to selections and followed by the error control.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.augmented import AugmentedFlow
from certrack.integrators.many.lockstep_map import STEP_ROWS, StepMap
from certrack.integrators.pairs import DOP853, DORMAND_PRINCE
from certrack.integrators.registers import whole_registers

#: Members per call of the compiled step: their rows fit the second-level cache.
BLOCK_MEMBERS = 2048

#: More halvings of an interval than this, and the member is given up.
MAX_LEVEL = 11

#: After a step that was not accurate enough, at most so many halvings more at once: an estimate
#: far above the allowed error says little about how many are needed.
MAX_HALVINGS = 4

#: With half as many steps the error estimate may reach this part of the allowed one: were it all of
#: it, a member would go to and fro between two levels.
COARSEN_MARGIN = 0.5

#: Steps after which a group is asked whether any member still has a passing estimate.
CHECK_EVERY = 16

#: From this tolerance on the fifth-order pair is faster than the eighth-order one.
FIFTH_ORDER_FROM = 1e-7


class Lockstep:
    """A compiled :class:`AugmentedFlow`.

    Parameters
    ----------
    flow : AugmentedFlow
    tolerance : float
        Relative and absolute, per step.
    parallel : bool
        Let heyoka share every step among the cores.
    """

    def __init__(self, flow: AugmentedFlow, tolerance: float, *, parallel: bool = False) -> None:
        self.flow, self.rows = flow, flow.rows
        self.size = self.rows["memories"].stop
        self._tolerance, self._parallel = tolerance, parallel
        self._pair = DORMAND_PRINCE if tolerance >= FIFTH_ORDER_FROM else DOP853
        self._nodes = np.unique([*self._pair.C, 1.0])
        timeless, symbols = flow.without_time()
        names = [TIME, *flow.shared]
        self._evaluate = numpy_callable(names, list(symbols)) if symbols else None
        self._step = StepMap(timeless, self._pair, self._nodes, list(symbols.values()))
        self._restart = StepMap(timeless, None, np.zeros(1), list(symbols.values()))

    def run(
        self,
        starts: np.ndarray,
        parameters: np.ndarray,
        times: np.ndarray,
        shared: Callable[[float], np.ndarray],
        on_grid_point: Callable[[int, Callable[[int], np.ndarray]], None],
        max_state: float,
        restarts: frozenset[int] = frozenset(),
    ) -> tuple[np.ndarray, np.ndarray]:
        """Integrate all members over `times`.

        Parameters
        ----------
        starts : (S, N) array
        parameters : (P, N) array
        times : (T+1,) array
            Increasing.
        shared : callable
            Values of the shared symbols on the piece that begins at a time.
        on_grid_point : callable
            Gets the number of the grid time and a function that gives one row of all members,
            shape (N,); NaN for a member that has ended.
        max_state : float
            A member whose state passes it has escaped.
        restarts : grid numbers
            Where the rates or signals jump.

        Returns
        -------
        ends : (N,) array
            Last time reached by each member.
        run_alone : (N,) array of bool
            Whether the step limit stopped it.
        """
        count = starts.shape[1]
        columns = whole_registers(count)  # which member each column computes
        width = min(len(columns), BLOCK_MEMBERS)
        blocks = -(-len(columns) // width)
        columns = columns[np.minimum(np.arange(blocks * width), len(columns) - 1)]
        members = _MemberBlocks(self, blocks, width)
        members.set(starts[:, columns], parameters[:, columns])
        members.evaluate(times[0], shared(times[0]))
        members.clear_memories()  # they have seen a jump from signals that were nothing yet
        members.evaluate(times[0], shared(times[0]))
        ends = np.full(len(columns), times[0])
        alive = members.inside(max_state)
        for k in range(len(times) - 1):
            values = shared(times[k])
            if k in restarts:
                members.evaluate(times[k], values)
            on_grid_point(k, lambda row: members.row(row)[:count])
            members.advance(times[k], times[k + 1], values, alive)
            alive &= members.inside(max_state)
            members.remove(~alive)
            ends[alive] = times[k + 1]
        on_grid_point(len(times) - 1, lambda row: members.row(row)[:count])
        return ends[:count], members.run_alone[:count]

    def common(
        self, begin: float, step: float, nodes: np.ndarray, shared: np.ndarray
    ) -> np.ndarray:
        """What depends on time alone, at the nodes of a step; a row each."""
        if self._evaluate is None:
            return np.empty((0, len(nodes)))
        return rows(self._evaluate(begin + nodes * step, *shared), len(nodes))


class _MemberBlocks:
    """The members of one call in blocks of columns, before and after an interval."""

    def __init__(self, lockstep: Lockstep, blocks: int, width: int) -> None:
        self._lockstep, self._width = lockstep, width
        size = lockstep.size
        self._before = np.zeros((blocks, size + 1, width))  # the last row is the error estimate
        self._after = np.zeros_like(self._before)
        self._levels = np.zeros(blocks * width, dtype=int)
        self.run_alone = np.zeros(blocks * width, dtype=bool)
        self._coarsen_below = COARSEN_MARGIN * 2.0**-lockstep._pair.order
        self._root = 1.0 / lockstep._pair.order
        self._parameters: dict[tuple[int, int], np.ndarray] = {}

    def set(self, starts: np.ndarray, parameters: np.ndarray) -> None:
        """Begin with these states and parameters, a column per member."""
        rows, blocks = self._lockstep.rows, len(self._before)
        for name, table in (("states", starts), ("parameters", parameters)):
            parts = table.reshape(len(table), blocks, self._width)
            self._before[:, rows[name]] = parts.transpose(1, 0, 2)

    def row(self, index: int) -> np.ndarray:
        """One row of all members."""
        return self._before[:, index].reshape(-1)

    def clear_memories(self) -> None:
        self._before[:, self._lockstep.rows["memories"]] = 0.0

    def inside(self, max_state: float) -> np.ndarray:
        """Members whose states are finite and within `max_state`."""
        states = self._before[:, : self._lockstep.flow.watched]
        if (
            states.max() <= max_state and states.min() >= -max_state
        ):  # nearly always, and not for NaN
            return np.ones(len(self._levels), dtype=bool)
        inside: np.ndarray = (np.abs(states) <= max_state).all(axis=1).ravel()
        return inside

    def remove(self, gone: np.ndarray) -> None:
        """Make the columns of members that have ended NaN."""
        if gone.any():
            block, lane = np.divmod(np.flatnonzero(gone), self._width)
            self._before[block, :, lane] = np.nan

    def evaluate(self, time: float, shared: np.ndarray) -> None:
        """Evaluate rates and signals anew; memories see the jump of the signals."""
        restart = self._lockstep._restart
        table = self._table(restart, self._width, time, 0.0, shared)
        for before, after in zip(self._before, self._after, strict=True):
            self._call(restart, before[:-1], table, after)
        self._before, self._after = self._after, self._before

    def advance(self, begin: float, end: float, shared: np.ndarray, alive: np.ndarray) -> None:
        """All members that are alive from `begin` to `end`."""
        step = self._lockstep._step
        table = self._table(step, self._width, begin, end - begin, shared)
        levels = self._levels.reshape(len(self._before), -1)
        redo = np.ones(levels.shape, dtype=bool)
        for b in np.flatnonzero((levels == 0).any(axis=1)):
            after = self._after[b]
            self._call(step, self._before[b, :-1], table, after)
            np.greater(levels[b], 0, out=redo[b])
            redo[b] |= ~(after[-1] <= 1.0)
        members = np.flatnonzero(redo.ravel() & alive)
        if members.size:
            self._refine(members, begin, end, shared)
        self._before, self._after = self._after, self._before

    def _refine(self, members: np.ndarray, begin: float, end: float, shared: np.ndarray) -> None:
        """Members that need more than one step."""
        wanted = np.maximum(self._levels[members], 1)
        while members.size:
            level = int(wanted.min())
            now = wanted == level
            worst = self._substeps(members[now], level, begin, end, shared)
            done, group = worst <= 1.0, members[now]
            # the next interval may do with half the steps
            self._levels[group[done]] = level - (worst[done] < self._coarsen_below)
            with np.errstate(over="ignore", invalid="ignore"):
                more = np.ceil(np.log2(worst[~done]) * self._root)
            more = np.nan_to_num(more, nan=1.0, posinf=MAX_HALVINGS)
            finer = level + np.clip(more, 1, MAX_HALVINGS).astype(int)
            hopeless = finer > MAX_LEVEL
            self._give_up(group[~done][hopeless])
            members = np.concatenate([members[~now], group[~done][~hopeless]])
            wanted = np.concatenate([wanted[~now], finer[~hopeless]])

    def _substeps(
        self, group: np.ndarray, level: int, begin: float, end: float, shared: np.ndarray
    ) -> np.ndarray:
        """Cross the interval in 2^level steps; returns the worst error estimate per member."""
        step, steps = self._lockstep._step, 2**level
        h = (end - begin) / steps
        worst = np.zeros(len(group))
        for first in range(0, len(group), BLOCK_MEMBERS):
            part = group[first : first + BLOCK_MEMBERS]
            padded = part[whole_registers(len(part))]
            block, lane = np.divmod(padded, self._width)
            now = np.ascontiguousarray(self._before[block, :, lane].T)
            after, error = np.empty_like(now), np.zeros(len(padded))
            for i in range(steps):
                table = self._table(step, len(padded), begin + i * h, h, shared)
                self._call(step, now[:-1], table, after)
                np.maximum(error, after[-1], out=error)  # a NaN stays
                now, after = after, now
                if (i + 1) % CHECK_EVERY == 0 and not (error <= 1.0).any():
                    break
            worst[first : first + BLOCK_MEMBERS] = error[: len(part)]
            self._after[block, :, lane] = now.T
        return worst

    def _give_up(self, members: np.ndarray) -> None:
        if members.size:
            block, lane = np.divmod(members, self._width)
            states = self._before[block, : self._lockstep.flow.watched, lane]
            self._after[block, :, lane] = np.nan
            self.run_alone[members] = ~(np.abs(states) > ESCAPING).any(axis=1)
            self._levels[members] = 0

    def _table(
        self, step: StepMap, width: int, begin: float, h: float, shared: np.ndarray
    ) -> np.ndarray:
        """Runtime parameters: begin, length, tolerance, then what depends on time alone."""
        key = (id(step), width)
        if key not in self._parameters:
            self._parameters[key] = np.empty((STEP_ROWS + len(step.used), width))
        table = self._parameters[key]
        table[0], table[1], table[2] = begin, h, self._lockstep._tolerance
        values = self._lockstep.common(begin, h, step.nodes, shared)
        for row, place in zip(table[STEP_ROWS:], step.used, strict=True):
            row[:] = values[place]
        return table

    def _call(self, step: StepMap, inputs: np.ndarray, table: np.ndarray, out: np.ndarray) -> None:
        f = step.function
        f(inputs, pars=table[: f.nparams], outputs=out, batch_parallel=self._lockstep._parallel)
