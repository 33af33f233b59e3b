"""Tables of text and numbers, as data: the command line and pages print the same cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table whose entries are text already."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 5
) -> Table:
    """A table of texts and of numbers with so many digits; a dash where there is none."""
    cells = tuple(tuple(_cell(value, digits) for value in row) for row in rows)
    return Table(title, tuple(columns), cells)


def _cell(value: object, digits: int) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return short_number(value, digits) if math.isfinite(value) else "-"
    return str(value)


#: What is smaller is dust of a division, such as of an interpolated quantile of zeros.
SMALLEST_SHOWN = 1e-300


def short_number(value: float, digits: int = 5) -> str:
    """A number with a short exponent, if any.

    >>> [short_number(value, 4) for value in (804940.0, 0.00012344, 0.5, -0.0)]
    ['8.049e5', '1.234e-4', '0.5', '0']
    """
    value = 0.0 if abs(value) < SMALLEST_SHOWN else value  # of -0, too
    text = f"{value:.{digits}g}" if abs(value) >= 1e-3 or not value else f"{value:.{digits - 1}e}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}" if mark else text


#: Digits of a bound in tables and sentences.
BOUND_TEXT_DIGITS = 5
