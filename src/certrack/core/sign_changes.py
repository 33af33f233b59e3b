"""Where formulas of t change sign: by subdivision, with enclosures that no change can hide from.

An interval on which the enclosure of the formula excludes zero has no change of sign, and one on
which the enclosure of its derivative does has at most one, which bisection then locates to the last
bit. All others are halved, until they are as short as :data:`RESOLUTION` says: changes of sign
that lie closer together than that are one.
"""

from __future__ import annotations

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.enclosures import IntervalArray, Known, enclose
from certrack.core.errors import InputError

#: Intervals are halved down to this part of the time.
RESOLUTION = 1e-13

#: More intervals than this at once: the changes of sign are too many, or the formula is zero, but
#: for rounding, for a while.
MAX_INTERVALS = 100_000

#: Halvings that take any interval to neighbouring floats.
BISECTIONS = 64


def sign_changes(formula: sympy.Expr, nodes: Array, known: Known) -> Array:
    """Times in the order of time at which the sign of a formula of t may change.

    Parameters
    ----------
    formula : sympy.Expr
        Whose derivative may jump at the nodes and, but for a few intervals that are then short,
        anywhere else.
    nodes : (K+1,) array, s
        Increasing; from the begin to the end of the search.
    known : mapping
        Numbers of all symbols but t.

    Raises
    ------
    InputError
        If they are too many.

    Returns
    -------
    (M,) array, s
        Strictly inside. Where the formula touches zero without a change there may be some, too.
    """
    begins, ends = nodes[:-1], nodes[1:]
    shortest = RESOLUTION * max(abs(nodes[0]), abs(nodes[-1]))
    parts = [np.empty(0)]
    while len(begins):
        enclosure = _tightened(formula, begins, ends, known)
        low, high = enclosure.low, enclosure.high
        open_ = (low[0] <= 0) & (high[0] >= 0) & ~((low[0] == 0) & (high[0] == 0))
        monotone = (low[1] >= 0) | (high[1] <= 0)
        tiny = (ends - begins) <= shortest
        settled = open_ & (monotone | tiny)
        parts.append(_bracketed(formula, begins[settled], ends[settled], known))
        undecided = open_ & ~settled
        begins, ends = begins[undecided], ends[undecided]
        middle = (begins + ends) / 2
        if 2 * len(begins) > MAX_INTERVALS:
            raise InputError(
                "simulation.duration",
                f"holds more than {MAX_INTERVALS // 2} changes of sign of a formula of t under "
                "abs, sign, min or max, or the formula is zero but for rounding",
                sympy.sstr(formula),
                "Shorten the run, or write the formula smoother",
            )
        begins, ends = np.concatenate([begins, middle]), np.concatenate([middle, ends])
    times = np.unique(np.concatenate(parts))
    inside = (times > nodes[0]) & (times < nodes[-1])
    return times[inside]


def signs(formula: sympy.Expr, times: Array, known: Known) -> Array:
    """Sign of a formula at each time, -1, 0 or 1."""
    point = enclose(formula, times, times, known, 1)
    return np.where(point.low[0] > 0, 1.0, np.where(point.high[0] < 0, -1.0, 0.0))


def _tightened(formula: sympy.Expr, begins: Array, ends: Array, known: Known) -> IntervalArray:
    """The enclosure, its value also by the mean value theorem: closer on short intervals."""
    enclosure = enclose(formula, begins, ends, known, 1)
    middle = (begins + ends) / 2
    centre = enclose(formula, middle, middle, known, 1)
    reach = np.maximum(np.abs(enclosure.low[1]), np.abs(enclosure.high[1]))
    with np.errstate(invalid="ignore"):  # infinity less infinity: nothing is known
        reach = reach * (1 + 1e-15) + 1e-16 * centre.sizes[0]
        low = np.fmax(enclosure.low[0], centre.low[0] - reach)
        high = np.fmin(enclosure.high[0], centre.high[0] + reach)
    return IntervalArray(
        np.array([low, enclosure.low[1]]), np.array([high, enclosure.high[1]]), enclosure.sizes
    )


def _bracketed(formula: sympy.Expr, begins: Array, ends: Array, known: Known) -> Array:
    """The change of sign on each interval whose ends differ in it, and ends that are zero."""
    first, last = (_values(formula, times, known) for times in (begins, ends))
    zeros = np.concatenate([begins[(first == 0) & (last != 0)], ends[(last == 0) & (first != 0)]])
    change = first * last < 0
    a, b, rising = begins[change], ends[change], first[change] < 0
    for _ in range(BISECTIONS):
        middle = (a + b) / 2
        above = _values(formula, middle, known) > 0
        before = above != rising
        a, b = np.where(before, middle, a), np.where(before, b, middle)
    return np.concatenate([zeros, b])


def _values(formula: sympy.Expr, times: Array, known: Known) -> Array:
    """The formula at times: the middle of its enclosure there."""
    point = enclose(formula, times, times, known, 1)
    with np.errstate(invalid="ignore"):
        middle: Array = np.nan_to_num((point.low[0] + point.high[0]) / 2)
    return middle
