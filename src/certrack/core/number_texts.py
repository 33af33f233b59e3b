"""Numbers as tables and sentences show them. Needs nothing, so that every verb may load it."""

from __future__ import annotations

#: Digits of a bound in tables and sentences.
BOUND_TEXT_DIGITS = 5


def short_number(value: float, digits: int = 5) -> str:
    """A number with a short exponent, if any.

    >>> [short_number(value, 4) for value in (804940.0, 0.00012344, 0.5)]
    ['8.049e5', '1.234e-4', '0.5']
    """
    text = f"{value:.{digits}g}" if abs(value) >= 1e-3 or not value else f"{value:.{digits - 1}e}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}" if mark else text
