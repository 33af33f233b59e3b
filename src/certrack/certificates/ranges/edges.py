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
LARGEST_SCALE, SMALLEST_SCALE_PART = 1e9, 1e-6

#: Digits of the scales that are tried.
SCALE_DIGITS = 5

T = TypeVar("T")


@dataclass(frozen=True)
class Edge(Generic[T]):
    """The largest scale for which something was found.

    Attributes
    ----------
    scale : str
        A short decimal; "0" where nothing was found at any scale.
    result : what was found there, or None
    reason : str
        Why nothing was found at the first scale beyond.
    unlimited : bool
        Whether the search ended at the largest scale that is asked for.
    """

    scale: str
    result: T | None
    reason: str
    unlimited: bool = False


def largest_scale(
    find: Callable[[Any], T | str],
    *,
    begin: float = 1.0,
    known: T | None = None,
    accuracy: float = 1e-3,
    fall: float = 4.0,
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
    fall : float
        Where nothing is found at `begin`, the next scale is smaller by this factor, the one after
        it by its square, and so on up to 4.
    """
    low, best, reason = 0.0, known, ""
    high = above = begin
    text = _decimal(begin) if known is not None else "0"
    if known is not None:
        low = begin
    else:
        while not low and high >= SMALLEST_SCALE_PART * begin:
            answer = find(rational(_decimal(high)))
            if isinstance(answer, str):
                reason, above, high = answer, high, high / fall
                fall = min(fall**2, 4.0)
            else:
                low, best, text = high, answer, _decimal(high)
        if not low:
            return Edge("0", None, reason)
        high = above if low < begin else low
    while high <= low:
        if low >= LARGEST_SCALE:
            return Edge(text, best, "", unlimited=True)
        trial = min(2 * low, LARGEST_SCALE) if low < 100 * begin else LARGEST_SCALE
        answer = find(rational(_decimal(trial)))
        if isinstance(answer, str):
            reason, high = answer, trial
        else:
            low, high, best, text = trial, trial, answer, _decimal(trial)
    while high > (1 + accuracy) * low:
        middle = (low * high) ** 0.5 if high > 4 * low else (low + high) / 2
        answer = find(rational(_decimal(middle)))
        if isinstance(answer, str):
            reason, high = answer, middle
        else:
            low, best, text = middle, answer, _decimal(middle)
    return Edge(text, best, reason)


def _decimal(scale: float) -> str:
    """The scale as a decimal of few digits, rounded down."""
    return format(Context(prec=SCALE_DIGITS, rounding=ROUND_FLOOR).plus(Decimal(scale)), "f")
