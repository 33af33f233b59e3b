"""Claims on a region, where a bound of w grows faster than the state: theorem and search.

Where |w| <= b(|x|) with a b that grows faster than |x|, no bound can hold from every start. From
some it does: the bounds X(k) of :mod:`start` need no more of b than that it is continuous and never
falls, and a last vector X_t above its own right-hand side bounds all that comes. In the long run
limsup |x| = L obeys L <= F(L), as w of long ago is forgotten, so

    L <= X_t,  L <= F(X_t),  L <= F(F(X_t)) ...

down to the largest fixed point below X_t; from above it nothing of this follows. What is proven
far away does not matter, for no run gets there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import flint

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text
from certrack.certificates.implemented.fixed_point import (
    FIXED_POINT_MARGIN,
    FIXED_POINT_STEPS,
    SMALLEST_BOUND,
    STANDS_STILL,
    OutputBounds,
)
from certrack.certificates.implemented.input_limits import is_limited
from certrack.core.rounding import in_digits
from certrack.systems.system import System

#: Digits of the scale of the largest box, and the scales between which it is looked for.
BOX_DIGITS, SMALLEST_BOX, LARGEST_BOX = 3, 1e-6, 1e6

#: Bounds of all states and of the input.
Vector = tuple[Sequence[Any], Any]


def is_regional(system: System) -> bool:
    """Whether a bound of w grows faster than the state, so that no claim is of every start."""
    return system.plant.uncertainty.is_regional


def is_of_starts(system: System) -> bool:
    """Whether a claim is of some starts: limits of the input, or bounds of w, do not admit all."""
    return is_limited(system) or is_regional(system)


def descend(bounds: OutputBounds, above: Vector, until: Callable[[list[Any]], bool]) -> list[Any]:
    """X_t, F(X_t) ... until they are as wanted, or stand still: bounds of limsup |x| and |u|.

    Parameters
    ----------
    bounds : OutputBounds
    above : X_t and the input's
        Bounds from some time on.
    until : callable
        Of the n + 1 bounds so far.

    Returns
    -------
    n + 1 exact balls
    """
    X, U = above
    v = [flint.arb(entry) for entry in (*X, U)]
    for _ in range(FIXED_POINT_STEPS):
        if until(v):
            break
        image = bounds.image(v[:-1], v[-1])[1:-1]
        after = [min(a, b) for a, b in zip(v, image, strict=True)]
        still = all(b >= a * (1 - STANDS_STILL) for a, b in zip(v, after, strict=True))
        v = after
        if still:
            break
    return v


def in_the_long_run(bounds: OutputBounds, starts: Sequence[Any]) -> tuple[list[float], float]:
    """States' and input's bounds that every one of the start proofs leads down to, widened."""
    lowest = [descend(bounds, _bounds_of_later(start), lambda _: False) for start in starts]
    largest = [float(max(entries).mid()) for entries in zip(*lowest, strict=True)]
    wide = [v * (1 + FIXED_POINT_MARGIN) + SMALLEST_BOUND for v in largest]
    return wide[:-1], wide[-1]


def not_reached(bounds: OutputBounds, wanted: Vector, start: Any) -> str:
    """Empty if the bounds of a start lead down to those that are claimed of the long run."""
    X, U = wanted
    limits = [flint.arb(entry) for entry in (*X, U)]

    def reached(v: list[Any]) -> bool:
        return all(a <= b for a, b in zip(v, limits, strict=True))

    if reached(descend(bounds, _bounds_of_later(start), reached)):
        return ""
    return "the bounds from the start do not lead down to those of the long run"


def _bounds_of_later(start: Any) -> Vector:
    return [from_text(text) for text in start.states], from_text(start.input)


def largest_region(
    system: System, holds: Callable[[tuple[tuple[str, str], ...]], bool]
) -> tuple[tuple[str, str], ...]:
    """The largest box of starts of which bounds are proven: of the ensemble's shape, or a cube.

    Parameters
    ----------
    system : System
    holds : callable
        Whether the states have bounds from a box.

    Returns
    -------
    n pairs of texts
        A multiple of the shape, around zero.

    Raises
    ------
    NoCertificate
        If there is none.
    """
    if system.truth.states:
        raise NoCertificate("the simulated plant has states of its own")
    drawn = system.varied.x0
    shape = [1.0] * system.plant.n
    if drawn is not None:
        shape = [max(abs(entry.low), abs(entry.high)) for entry in drawn]

    def box(scale: float) -> tuple[tuple[str, str], ...]:
        ends = [in_digits(scale * size, BOX_DIGITS + 2) for size in shape]
        return tuple((repr(-end), repr(end)) for end in ends)

    low, high = 0.0, 1.0
    while high <= LARGEST_BOX and holds(box(high)):
        low, high = high, 2 * high
    while not low and high > SMALLEST_BOX:
        middle = high / 2
        low, high = (middle, high) if holds(box(middle)) else (0.0, middle)
    if not low:
        raise NoCertificate("the states have no bounds from a box of starts around zero")
    while high - low > 10.0**-BOX_DIGITS * low:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(box(middle)) else (low, middle)
    return box(low)
