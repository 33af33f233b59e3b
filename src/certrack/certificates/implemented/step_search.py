"""The z of :mod:`slow` that make the bound small: a linear program, and steps of few digits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import flint
import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.period import Period
from certrack.certificates.implemented.slow import (
    SlowTerms,
    StepFunction,
    slow_columns,
)
from certrack.certificates.implemented.superposition import search_split

#: Steps of z, at most; digits of each; by how much of the largest |g| two of them differ.
MOST_STEPS_OF_Z, STEP_DIGITS, LEAST_STEP = 300, 9, 1e-7

#: What rates of the uncertain terms take off, among the parts of a bound.
RATES_PART = "uncertain, as they are slow"

#: A z that is written where none gains more than this factor.
UNUSED: StepFunction = ((0, "0"),)
WORTH_WRITING = flint.fmpq(1_000_001, 1_000_000)


@dataclass(frozen=True)
class ByRates:
    """A z for each uncertain term with a rate, bounds of a split loop, and of |e_1|."""

    slow: tuple[StepFunction, ...]
    split: tuple[tuple[str, ...], ...]
    bound: Any


def by_rates(
    period: Period, bounds: OutputBounds, doublings: int, claimed: tuple[list[Any], Any], plain: Any
) -> ByRates:
    """What rates make of the bound of |e_1|; without a z where that is not smaller.

    Parameters
    ----------
    period, bounds, doublings
        Of the proof without rates.
    claimed : (X, U)
        Its bounds of the states and of the input.
    plain : ball
        Its bound of |e_1|.
    """
    if not slow_columns(period.drive):
        return ByRates((), (), plain)
    try:
        split = search_split(bounds, *claimed)
        terms = SlowTerms.of(period, bounds, doublings, *claimed, split)
        steps = search_steps(terms)
        smaller = terms.bound(steps)
        for i in range(len(steps)):  # where a z gains nothing, none is written
            fewer = (*steps[:i], UNUSED, *steps[i + 1 :])
            if terms.bound(fewer) <= smaller * WORTH_WRITING:
                steps = fewer
        smaller, unsplit = terms.bound(steps), replace(terms, parts={})
        if split and unsplit.bound(steps) <= smaller * WORTH_WRITING:
            split, smaller = (), unsplit.bound(steps)
    except NoCertificate:  # too many numbers, or jumps in every period
        return ByRates((), (), plain)
    return ByRates(steps, split, smaller) if smaller < plain else ByRates((), (), plain)


def search_steps(terms: SlowTerms) -> tuple[StepFunction, ...]:
    """One z for each column, of the row that is largest without them."""
    responses = terms.responses
    gains = terms.bounds.gains.w[terms.chosen][:, responses.columns]
    sizes = np.array([float(size.mid()) for size in terms.sizes])
    row = int(np.argmax([float(v.mid()) for v in terms.values] + gains @ sizes))
    steps = tuple(_best_z(terms, i, row, _prices(terms, i)) for i in range(len(sizes)))
    for i, j in enumerate(responses.columns):
        if (parts := terms.parts.get(j)) is not None:
            prices = (float(parts.size.mid()), float(parts.speed.mid()), 0.0)
            other = (*steps[:i], _best_z(terms, i, row, prices), *steps[i + 1 :])
            steps = min(steps, other, key=lambda z: float(terms.bound(z)))
    return steps


def _prices(terms: SlowTerms, i: int) -> tuple[float, float, float]:
    """Bounds of the slow part, of its rate and of its jumps."""
    slow = terms.bounds.drive.uncertain[terms.responses.columns[i]].slow
    assert slow is not None
    size = float(terms.sizes[i].mid()) - float(slow.fast)
    return size, float(terms.speeds[i].mid()), float(slow.jump)


def _best_z(terms: SlowTerms, i: int, row: int, prices: tuple[float, float, float]) -> StepFunction:
    responses = terms.responses
    lengths = responses.lengths[row]
    time = lengths.sum(axis=1)
    middle = (responses.begin[row, ..., i] + responses.end[row, ..., i]) / 2
    g = (middle * lengths).sum(axis=1) / np.maximum(time, 1e-300)
    g[0] = g[1] if not time[0] else g[0]
    last = float(responses.end[row, -1, -1, i])
    starts = _blocks(g, time)
    medians = np.array([np.median(part) for part in np.split(g, starts[1:])])
    weights = np.add.reduceat(time, starts)
    windows = terms.apart(i)
    owner = starts // windows if windows else None
    z = _least(medians, weights, last, prices, owner)
    return _few(starts, z, float(np.abs(g).max()))


def _blocks(g: np.ndarray, time: np.ndarray) -> np.ndarray:
    """First periods of blocks in which g varies, and time passes, about equally much."""
    grown = np.cumsum(np.abs(np.diff(g, prepend=g[:1]))) + 1e-300
    measure = grown / grown[-1] + np.cumsum(time) / time.sum()
    ends = np.searchsorted(measure, np.linspace(0, measure[-1], MOST_STEPS_OF_Z + 1)[1:-1])
    inside = ends[(ends > 1) & (ends < len(g))]
    return np.unique(np.concatenate([[0], inside]))


def _least(
    g: np.ndarray,
    weights: np.ndarray,
    last: float,
    prices: tuple[float, float, float],
    owner: np.ndarray | None,
) -> np.ndarray:
    """z with the least size TV(z) + rate sum weights |g - z| + jump sum of the windows' largest.

    Of what is a window apart, one at most lies in each: that sum is about what :mod:`apart` bounds.
    """
    size, rate, jump = prices
    k = len(g)
    windows = 0 if owner is None else int(owner[-1]) + 1
    one, first, final = sparse.eye(k), np.eye(1, k), np.eye(1, k, k - 1)
    between = sparse.diags([-np.ones(k - 1), np.ones(k - 1)], [0, 1], shape=(k - 1, k))
    moves = sparse.vstack([first, between, -final])
    beyond = np.zeros(k + 1)
    beyond[-1] = -last  # last - z_last
    steps, gaps = sparse.eye(k + 1), sparse.eye(k)
    blocks = [[moves, -steps, None, None], [-moves, -steps, None, None]]
    blocks += [[one, None, -gaps, None], [-one, None, -gaps, None]]
    limits = [beyond, -beyond, g, -g]
    if owner is not None:
        largest = sparse.csr_matrix((np.ones(k), (np.arange(k), owner)), shape=(k, windows))
        blocks.append([None, None, gaps, -largest])
        limits.append(np.zeros(k))
    if not windows:
        blocks = [row[:3] for row in blocks]
    cost = np.concatenate(
        [np.zeros(k), np.full(k + 1, size), rate * weights, np.full(windows, jump)]
    )
    free = [(None, None)] * k + [(0, None)] * (len(cost) - k)
    scale = cost.max() or 1.0
    smaller = linprog(
        cost / scale,
        A_ub=sparse.bmat(blocks, format="csr"),
        b_ub=np.concatenate(limits),
        bounds=free,
        method="highs",
    )
    return g if smaller.x is None else smaller.x[:k]


def _few(starts: np.ndarray, z: np.ndarray, largest: float) -> StepFunction:
    """The steps with few digits, equal neighbours as one."""
    steps: list[tuple[int, str]] = []
    for start, value in zip(starts.tolist(), z.tolist(), strict=True):
        if not steps or abs(value - float(steps[-1][1])) > LEAST_STEP * largest:
            steps.append((start, f"{value + 0.0:.{STEP_DIGITS}g}"))
    return tuple(steps)
