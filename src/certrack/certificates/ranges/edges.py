"""The edge of what can be proven: the largest scale for which a proof is found.

Proofs are looked for on a grid of short decimals, so what is printed is what was proven.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import ROUND_FLOOR, Context, Decimal
from typing import Any, Generic, TypeVar

from certrack.certificates.arithmetic import rational

#: Nobody asks for more than this; and for less than the other, relative to where the search begins.
LARGEST_SCALE, SMALLEST_PART = 1e9, 1e-6

#: Digits of the scales that are tried.
DIGITS = 5

T = TypeVar("T")


@dataclass(frozen=True)
class Edge(Generic[T]):
    """The largest scale for which something was found.

    Attributes
    ----------
    scale : str
        A short decimal; "0" where nothing was found at any scale.
    found : what was found there, or None
    reason : str
        Why nothing was found at the first scale beyond.
    unlimited : bool
        Whether the search ended at the largest scale that is asked for.
    """

    scale: str
    found: T | None
    reason: str
    unlimited: bool = False


def largest_scale(
    find: Callable[[Any], T | str],
    *,
    begin: float = 1.0,
    known: T | None = None,
    accuracy: float = 1e-3,
) -> Edge[T]:
    """Search the edge between scales with and without a proof.

    Parameters
    ----------
    find : callable
        From a scale (a rational) to what is found, or to the reason why nothing is.
    begin : float
        Where the search begins.
    known : what is found at `begin`, if that is known
    accuracy : float
        Relative width of the last interval.
    """
    low, best, reason = 0.0, known, ""
    high = begin
    text = _short(begin) if known is not None else "0"
    if known is not None:
        low = begin
    else:
        while not low and high >= SMALLEST_PART * begin:
            found = find(rational(_short(high)))
            if isinstance(found, str):
                reason, high = found, high / 4
            else:
                low, best, text = high, found, _short(high)
        if not low:
            return Edge("0", None, reason)
        high = 4 * low if low < begin else low
    while high <= low:
        if low >= LARGEST_SCALE:
            return Edge(text, best, "", unlimited=True)
        trial = min(2 * low, LARGEST_SCALE) if low < 100 * begin else LARGEST_SCALE
        found = find(rational(_short(trial)))
        if isinstance(found, str):
            reason, high = found, trial
        else:
            low, high, best, text = trial, trial, found, _short(trial)
    while high > (1 + accuracy) * low:
        middle = (low * high) ** 0.5 if high > 4 * low else (low + high) / 2
        found = find(rational(_short(middle)))
        if isinstance(found, str):
            reason, high = found, middle
        else:
            low, best, text = middle, found, _short(middle)
    return Edge(text, best, reason)


def _short(scale: float) -> str:
    """The scale as a decimal of few digits, rounded down."""
    return format(Context(prec=DIGITS, rounding=ROUND_FLOOR).plus(Decimal(scale)), "f")
