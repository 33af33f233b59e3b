"""Many members of one system side by side: one compiled Runge-Kutta step for all (heyoka).

All members share a time grid. A member crosses an interval of the grid in 2^level equal steps of an
embedded pair; its level follows from its own error estimate alone, so what a member computes does
not depend on its neighbours. What depends on time alone is evaluated once for all members. The
result lies on the grid without interpolation, which is why this beats adaptive steps where many
grid points are looked at.

Kinks (abs, sign, min, max) are lowered to selections and followed by the error control.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows, to_heyoka
from certrack.core.select import STEP_BEGIN, STEP_LENGTH
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.flow import Flow
from certrack.integrators.pairs import DOP853, DORMAND_PRINCE, Pair, heyoka_step, heyoka_sum

#: Vector lanes; the number of members at work is always a multiple, because heyoka evaluates a
#: remainder by scalar functions, whose last bits differ.
LANES = 8

#: Members per call of the compiled step: their rows fit the second-level cache.
BLOCK = 2048

#: More halvings of an interval than this, and the member is given up.
MAX_LEVEL = 11

#: From this tolerance on the fifth-order pair is faster than the eighth-order one.
COARSE = 1e-7


class Lockstep:
    """A compiled :class:`Flow`.

    Parameters
    ----------
    flow : Flow
    tolerance : float
        Relative and absolute, per step.
    parallel : bool
        Let heyoka share every step among the cores.
    """

    def __init__(self, flow: Flow, tolerance: float, *, parallel: bool = False) -> None:
        self.flow, self.rows = flow, flow.rows
        self.size = self.rows["memories"].stop
        self._tolerance, self._parallel = tolerance, parallel
        self._pair = DORMAND_PRINCE if tolerance >= COARSE else DOP853
        self._nodes = np.unique([*self._pair.C, 1.0])
        common, found = flow.without_time()
        names = [TIME, *flow.shared]
        self._evaluate = numpy_callable(names, list(found)) if found else None
        self._step = _Map(common, self._pair, self._nodes, list(found.values()))
        self._restart = _Map(common, None, np.zeros(1), list(found.values()))

    def run(
        self,
        starts: np.ndarray,
        parameters: np.ndarray,
        times: np.ndarray,
        shared: Callable[[float], np.ndarray],
        look: Callable[[int, Callable[[int], np.ndarray]], None],
        limit: float,
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
        look : callable
            Gets the number of the grid time and a function that gives one row of all members,
            shape (N,); NaN for a member that has ended.
        limit : float
            A member whose state passes it has escaped.
        restarts : grid numbers
            Where the rates or signals jump.

        Returns
        -------
        ends : (N,) array
            Last time reached by each member.
        stuck : (N,) array of bool
            Whether the step limit stopped it.
        """
        count = starts.shape[1]
        whole = -(-count // LANES) * LANES
        fill = np.minimum(np.arange(whole), count - 1)
        lanes = min(whole, BLOCK)
        members = np.minimum(np.arange(-(-whole // lanes) * lanes), whole - 1)
        crowd = _Crowd(self, len(members) // lanes, lanes)
        crowd.set(starts[:, fill[members]], parameters[:, fill[members]])
        crowd.restart(times[0], shared(times[0]))
        crowd.forget()
        crowd.restart(times[0], shared(times[0]))
        ends = np.full(len(members), times[0])
        alive = crowd.inside(limit)
        for k in range(len(times) - 1):
            values = shared(times[k])
            if k in restarts:
                crowd.restart(times[k], values)
            look(k, lambda row: crowd.row(row)[:count])
            crowd.cross(times[k], times[k + 1], values, alive)
            alive &= crowd.inside(limit)
            crowd.bury(~alive)
            ends[alive] = times[k + 1]
        look(len(times) - 1, lambda row: crowd.row(row)[:count])
        return ends[:count], crowd.stuck[:count]

    def common(
        self, begin: float, step: float, nodes: np.ndarray, shared: np.ndarray
    ) -> np.ndarray:
        """What depends on time alone, at the nodes of a step; a row each."""
        if self._evaluate is None:
            return np.empty((0, len(nodes)))
        return rows(self._evaluate(begin + nodes * step, *shared), len(nodes))


class _Crowd:
    """The members of one call: blocks of columns, before and after an interval."""

    def __init__(self, step: Lockstep, blocks: int, lanes: int) -> None:
        self._of, self._lanes = step, lanes
        size = step.size
        self._before = np.zeros((blocks, size + 1, lanes))  # the last row is the error estimate
        self._after = np.zeros_like(self._before)
        self._levels = np.zeros(blocks * lanes, dtype=int)
        self.stuck = np.zeros(blocks * lanes, dtype=bool)
        self._down = 0.5 * 2.0**-step._pair.order
        self._root = 1.0 / step._pair.order
        self._parameters: dict[tuple[int, int], np.ndarray] = {}

    def set(self, starts: np.ndarray, parameters: np.ndarray) -> None:
        rows, blocks = self._of.rows, len(self._before)
        for name, table in (("states", starts), ("parameters", parameters)):
            parts = table.reshape(len(table), blocks, self._lanes)
            self._before[:, rows[name]] = parts.transpose(1, 0, 2)

    def row(self, index: int) -> np.ndarray:
        """One row of all members."""
        return self._before[:, index].reshape(-1)

    def forget(self) -> None:
        self._before[:, self._of.rows["memories"]] = 0.0

    def inside(self, limit: float) -> np.ndarray:
        """Members whose states are finite and within the limit."""
        states = self._before[:, : self._of.flow.watched]
        if states.max() <= limit and states.min() >= -limit:  # nearly always, and not for NaN
            return np.ones(len(self._levels), dtype=bool)
        found: np.ndarray = (np.abs(states) <= limit).all(axis=1).ravel()
        return found

    def bury(self, lost: np.ndarray) -> None:
        if lost.any():
            block, lane = np.divmod(np.flatnonzero(lost), self._lanes)
            self._before[block, :, lane] = np.nan

    def restart(self, time: float, shared: np.ndarray) -> None:
        """Evaluate rates and signals anew; memories see the jump of the signals."""
        table = self._table(self._of._restart, self._lanes, time, 0.0, shared)
        for before, after in zip(self._before, self._after, strict=True):
            self._call(self._of._restart, before[:-1], table, after)
        self._before, self._after = self._after, self._before

    def cross(self, begin: float, end: float, shared: np.ndarray, alive: np.ndarray) -> None:
        """All members that are alive from `begin` to `end`."""
        step = self._of
        table = self._table(step._step, self._lanes, begin, end - begin, shared)
        levels = self._levels.reshape(len(self._before), -1)
        redo = np.ones(levels.shape, dtype=bool)
        for b in np.flatnonzero((levels == 0).any(axis=1)):
            after = self._after[b]
            self._call(step._step, self._before[b, :-1], table, after)
            np.greater(levels[b], 0, out=redo[b])
            redo[b] |= ~(after[-1] <= 1.0)
        members = np.flatnonzero(redo.ravel() & alive)
        if members.size:
            self._halve(members, begin, end, shared)
        self._before, self._after = self._after, self._before

    def _halve(self, members: np.ndarray, begin: float, end: float, shared: np.ndarray) -> None:
        """Members that need more than one step."""
        wanted = np.maximum(self._levels[members], 1)
        while members.size:
            level = int(wanted.min())
            now = wanted == level
            worst = self._group(members[now], level, begin, end, shared)
            done, group = worst <= 1.0, members[now]
            # the next interval may do with half the steps
            self._levels[group[done]] = level - (worst[done] < self._down)
            with np.errstate(over="ignore", invalid="ignore"):
                more = np.ceil(np.log2(worst[~done]) * self._root)
            more = np.clip(np.nan_to_num(more, nan=1.0, posinf=4.0), 1, 4).astype(int)
            left, wanted = members[~now], wanted[~now]
            again = level + more
            hopeless = again > MAX_LEVEL
            self._give_up(group[~done][hopeless])
            members = np.concatenate([left, group[~done][~hopeless]])
            wanted = np.concatenate([wanted, again[~hopeless]])

    def _group(
        self, group: np.ndarray, level: int, begin: float, end: float, shared: np.ndarray
    ) -> np.ndarray:
        """Cross the interval in 2^level steps; returns the worst error estimate per member."""
        step, size = self._of, 2**level
        h = (end - begin) / size
        worst = np.zeros(len(group))
        for first in range(0, len(group), BLOCK):
            part = group[first : first + BLOCK]
            lanes = -(-len(part) // LANES) * LANES
            padded = part[np.minimum(np.arange(lanes), len(part) - 1)]
            block, lane = np.divmod(padded, self._lanes)
            now = np.ascontiguousarray(self._before[block, :, lane].T)
            then, error = np.empty_like(now), np.zeros(lanes)
            for i in range(size):
                table = self._table(step._step, lanes, begin + i * h, h, shared)
                self._call(step._step, now[:-1], table, then)
                np.maximum(error, then[-1], out=error)  # a NaN stays
                now, then = then, now
                if i % 16 == 15 and not (error <= 1.0).any():
                    break
            worst[first : first + BLOCK] = error[: len(part)]
            self._after[block, :, lane] = now.T
        return worst

    def _give_up(self, members: np.ndarray) -> None:
        if members.size:
            block, lane = np.divmod(members, self._lanes)
            states = self._before[block, : self._of.flow.watched, lane]
            self._after[block, :, lane] = np.nan
            self.stuck[members] = ~(np.abs(states) > ESCAPING).any(axis=1)
            self._levels[members] = 0

    def _table(
        self, step: _Map, lanes: int, begin: float, h: float, shared: np.ndarray
    ) -> np.ndarray:
        """Runtime parameters: begin, length, tolerance, then what depends on time alone."""
        key = (id(step), lanes)
        if key not in self._parameters:
            self._parameters[key] = np.empty((3 + len(step.used), lanes))
        table = self._parameters[key]
        table[0], table[1], table[2] = begin, h, self._of._tolerance
        values = self._of.common(begin, h, step.nodes, shared)
        for row, place in zip(table[3:], step.used, strict=True):
            row[:] = values[place]
        return table

    def _call(self, step: _Map, inputs: np.ndarray, table: np.ndarray, out: np.ndarray) -> None:
        f = step.function
        f(inputs, pars=table[: f.nparams], outputs=out, batch_parallel=self._of._parallel)


class _Map:
    """The step of `pair` as one compiled map of all rows; without a pair, the restart.

    Attributes
    ----------
    function : heyoka.cfunc
    nodes : (K,) array
        Where on the step the stages lie.
    used : list of (i, k)
        Which shared symbol at which node each further runtime parameter is.
    """

    def __init__(
        self, flow: Flow, pair: Pair | None, nodes: np.ndarray, shared: Sequence[sympy.Symbol]
    ) -> None:
        import heyoka as hy

        self.nodes = nodes
        places = [(i, k) for i in range(len(shared)) for k in range(len(nodes))]
        inputs, outputs = _formulas(flow, pair, nodes, shared, places)
        present = {int(re.sub(r"\D", "", str(name))) for name in hy.get_params(outputs)}
        self.used = [place for i, place in enumerate(places) if 3 + i in present]
        inputs, outputs = _formulas(flow, pair, nodes, shared, self.used)
        self.function = hy.cfunc(outputs, inputs, batch_size=LANES, force_avx512=True)


def _formulas(
    flow: Flow,
    pair: Pair | None,
    nodes: np.ndarray,
    shared: Sequence[sympy.Symbol],
    used: Sequence[tuple[int, int]],
) -> tuple[list[Any], list[Any]]:
    """Input and output rows of a map; `used` says which runtime parameters it may refer to."""
    import heyoka as hy

    unused = hy.expression(0.0)
    position = {place: hy.par[3 + i] for i, place in enumerate(used)}
    names = [
        *flow.states,
        *flow.parameters,
        *(f"kept_integral_{i}" for i in range(len(flow.integrands))),
        *(f"kept_slope_{i}" for i in range(len(flow.rates))),
        *(begin for begin, _ in flow.sides),
        *(symbol for symbol, _ in flow.memories),
    ]
    inputs = [hy.expression(str(name)) for name in names]
    known: dict[sympy.Symbol, Any] = dict(zip(names, inputs, strict=True))
    x, rows = inputs[: len(flow.states)], flow.rows
    integrals, slopes = inputs[rows["integrals"]], inputs[rows["slopes"]]
    begin, h, tolerance = hy.par[0], hy.par[1], hy.par[2]
    known |= {STEP_BEGIN: begin, STEP_LENGTH: h}

    def at(node: float, states: Sequence[Any]) -> dict[sympy.Symbol, Any]:
        """What formulas refer to at a node of the step."""
        column = int(np.searchsorted(nodes, node))
        times = {s: position.get((i, column), unused) for i, s in enumerate(shared)}
        return known | dict(zip(flow.states, states, strict=True)) | times

    def rates(node: float, states: Sequence[Any]) -> list[Any]:
        return to_heyoka([*flow.rates, *flow.integrands], at(node, states), kinks=True)

    size = len(flow.rates)
    if pair is None:
        ends, error = x, hy.expression(0.0)
        totals = integrals
        last = rates(0.0, x)[:size]
    else:
        first = [*slopes, *rates(0.0, x)[size:]]  # the slopes are those at the last step's end
        stages, ends = heyoka_step(pair, h, x, first, rates)
        totals = [
            v + heyoka_sum(h, pair.B, [k[size + i] for k in stages[:-1]])
            for i, v in enumerate(integrals)
        ]
        last = list(stages[-1][:size])
        error = _estimate(hy, pair, h, x, ends, stages, tolerance)
    end_node = 0.0 if pair is None else 1.0
    place = at(end_node, ends) | dict(zip(flow.slopes, last, strict=True))
    signals = to_heyoka(flow.signals, place, kinks=True)
    place |= {end: value for (_, end), value in zip(flow.sides, signals, strict=True)}
    memories = to_heyoka([formula for _, formula in flow.memories], place, kinks=True)
    outputs = [*ends, *inputs[rows["parameters"]], *totals, *last, *signals, *memories, error]
    return inputs, outputs


def _estimate(
    hy: Any,
    pair: Pair,
    h: Any,
    x: Sequence[Any],
    ends: Sequence[Any],
    slopes: Sequence[Sequence[Any]],
    tolerance: Any,
) -> Any:
    """Root mean square of the estimated errors over tolerance (1 + |x|); a step passes at 1."""

    def magnitude(value: Any) -> Any:
        return hy.select(hy.gte(value, 0.0), value, -value)

    scales = []
    for begin, end in zip(x, ends, strict=True):
        a, b = magnitude(begin), magnitude(end)
        scales.append(1.0 / (tolerance + tolerance * hy.select(hy.gt(a, b), a, b)))

    def squares(weights: np.ndarray) -> Any:
        errors = [heyoka_sum(h, weights, [k[i] for k in slopes]) for i in range(len(x))]
        scaled = [error * scale for error, scale in zip(errors, scales, strict=True)]
        return hy.sum([value * value for value in scaled]) * (1.0 / len(scaled))

    if len(pair.errors) == 1:
        return hy.sqrt(squares(pair.errors[0]))
    fifth, third = map(squares, pair.errors)
    return fifth / hy.sqrt(fifth + 0.01 * third + 1e-300)
