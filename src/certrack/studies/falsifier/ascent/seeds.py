"""Inputs to begin an ascent with: constant ones, waves, and those of runs found before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy
from scipy.optimize import linprog

from certrack.core.arrays import Array
from certrack.core.expressions import TIME, parse
from certrack.core.lowering import numpy_callable, rows
from certrack.references.shapes import derivatives_between
from certrack.simulation.run import Run
from certrack.studies.falsifier.ascent.loop import RESTING_PIECES, AdversaryInputs, ControlledLoop
from certrack.systems.system import System

#: Waves have from one turn in so many horizons to so many turns in one.
SLOWEST_WAVE, FASTEST_WAVE = 0.5, 60.0

#: Means on long pieces let y_d drift away from its run: beyond this part of a bound it is shrunk.
LEAST_EXCESS = 1.01


def waves(loop: ControlledLoop, count: int, rng: np.random.Generator) -> AdversaryInputs:
    """Members at rest under shares that are constant at first, then waves of any frequency.

    Constants are at corners of their ranges.
    """
    steps, C, P = len(loop.widths), len(loop.acting), len(loop.ranges)
    time = (np.cumsum(loop.widths) / loop.horizon)[:, None, None]
    turns = np.exp(rng.uniform(np.log(SLOWEST_WAVE), np.log(FASTEST_WAVE), (C, count)))
    shares = np.sign(np.sin(2 * np.pi * (turns * time + rng.uniform(size=(C, count)))))
    still = np.arange(count) < 4
    constant = np.array([1.0, 1.0, -1.0, -1.0])[np.arange(count) % 4]
    shares = np.where(still | np.array(loop.held, dtype=bool)[:, None], constant, shares)
    corners = rng.integers(0, 2, (P, count))
    truths = np.take_along_axis(loop.ranges, corners, axis=1) if P else np.zeros((0, count))
    pieces = np.zeros((len(loop.piece_steps) + RESTING_PIECES, count))
    return AdversaryInputs(
        np.broadcast_to(shares, (steps, C, count)),
        np.zeros((len(loop.bounds) - 1, count)),
        pieces,
        truths,
    )


def of_run(loop: ControlledLoop, case: System, run: Run) -> tuple[AdversaryInputs, float]:
    """The inputs of a run until what is sought is largest in its tail, and the sense of that."""
    late = np.flatnonzero(run.t >= case.settings.tail_start)
    output = loop.sought.values(run)
    at = late[int(np.argmax(np.abs(output[late])))] if late.size else len(run.t) - 1
    begin = float(run.t[at]) - loop.horizon
    edges = begin + np.concatenate([[0.0], np.cumsum(loop.widths)])
    middle = np.maximum((edges[1:] + edges[:-1]) / 2, 0.0)
    x = np.array([np.interp(middle, run.t, row) for row in run.x])
    shares = np.zeros((len(middle), len(loop.acting), 1))
    names = ["t", *loop.system.plant.states]
    symbols = [TIME, *loop.system.plant.symbols]
    for j, k in enumerate(loop.acting):
        bound = parse("", loop.share_bound(k), names).expr
        omega = sympy.S.Zero if case.truth.omega is None else case.truth.omega[k].expr
        formulas = numpy_callable(symbols, [omega, bound])
        with np.errstate(all="ignore"):
            w, most = rows(formulas(middle, *x), len(middle))
            share = np.clip(np.nan_to_num(w / most), -1, 1)
        shares[:, j, 0] = share.mean() if loop.held[j] else share
    reference = _reference(loop, case, np.maximum(edges, 0.0))
    low, high = loop.ranges.T
    truths = np.clip([_true_value(case, name) for name in loop.truth_names], low, high)
    return AdversaryInputs(shares, reference[0], reference[1], truths.reshape(-1, 1)), float(
        np.sign(output[at]) or 1.0
    )


def _true_value(case: System, name: str) -> float:
    truth = case.truth
    assert truth.input_gain is not None
    if name.startswith("true_theta"):
        return float(truth.theta[int(name.rsplit("_", 1)[1])].expr)
    return float(truth.input_gain.expr)


def _reference(loop: ControlledLoop, case: System, edges: Array) -> tuple[Array, Array]:
    """The reference of a run on the pieces, and how it comes to rest."""
    m = len(loop.bounds) - 1
    places = np.concatenate([[0], np.cumsum(loop.piece_steps)])
    times = edges[places]
    values = case.reference.values(times, m - 1)
    begin = values[:, 0]
    pieces = np.diff(values[m - 1]) / loop.piece_widths
    pieces = np.concatenate([pieces, _stopping(loop, begin, pieces)])
    excess = _excess(loop, begin, pieces)
    if excess > LEAST_EXCESS:  # an adversary that begins with what is not admissible stays there
        begin, pieces = begin / excess, pieces / excess
    return begin[:, None], pieces[:, None]


def _excess(loop: ControlledLoop, begin: Array, pieces: Array) -> float:
    """The largest derivative between pieces, over its bound."""
    widths = np.concatenate([loop.piece_widths, loop.stopping_widths])
    times = np.concatenate([[0.0], np.cumsum(widths)])
    reached = np.abs(derivatives_between(times.tolist(), begin.tolist(), pieces.tolist()))
    largest = np.append(reached.max(axis=0), np.abs(pieces).max())
    return float((largest / np.maximum(loop.bounds, 1e-300)).max())


def _stopping(loop: ControlledLoop, begin: Array, pieces: Array) -> Array:
    """Pieces that bring a reference to rest, as far within its bounds as can be."""
    m, widths = len(begin), loop.stopping_widths
    times = np.concatenate([[0.0], np.cumsum(loop.piece_widths)])
    end = derivatives_between(times.tolist(), begin.tolist(), pieces.tolist())[-1]
    count = len(widths)
    columns = [
        derivatives_between([0.0, *np.cumsum(widths)], [0.0] * m, row)
        for row in np.eye(count).tolist()
    ]
    still = derivatives_between([0.0, *np.cumsum(widths)], list(end), [0.0] * count)
    G, offset = np.array(columns)[:, 1:].transpose(1, 2, 0), np.array(still)[1:]
    sizes = np.maximum(loop.bounds, 1e-300)
    A = (G / sizes[:-1, None]).reshape(-1, count)
    b = (offset / sizes[:-1]).ravel()
    A = np.vstack([A, np.eye(count) / sizes[-1]])
    b = np.concatenate([b, np.zeros(count)])
    ones = -np.ones((len(A), 1))
    solved = linprog(
        [*np.zeros(count), 1.0],
        A_ub=np.vstack([np.hstack([A, ones]), np.hstack([-A, ones])]),
        b_ub=np.concatenate([-b, b]),
        A_eq=np.hstack([G[-1, 1:] / sizes[1:-1, None], np.zeros((m - 1, 1))]) if m > 1 else None,
        b_eq=-offset[-1, 1:] / sizes[1:-1] if m > 1 else None,
        bounds=[(None, None)] * count + [(0, None)],
        method="highs",
    )
    return np.zeros(count) if solved.x is None else np.asarray(solved.x[:-1])


def all_members(members: Sequence[AdversaryInputs]) -> AdversaryInputs:
    """All of these side by side, their members numbered through."""
    return AdversaryInputs(
        *(
            np.concatenate(parts, axis=-1)
            for parts in zip(*(m.parts() for m in members), strict=True)
        )
    )
