"""Numbers as short texts that are not below them: how a bound is printed."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, Context, Decimal


def rounded_up(value: float | str, digits: int) -> str:
    """The shortest text of at most `digits` digits that is not below the value.

    Parameters
    ----------
    value : float or str
        A float stands for its exact binary value, a text for its decimal value.
    digits : int

    Returns
    -------
    str
        ``"inf"`` or ``"nan"`` where the value is.

    Examples
    --------
    >>> rounded_up(0.026750001, 4), rounded_up(0.5, 4), rounded_up(12345.6, 3)
    ('0.02676', '0.5', '12400')
    """
    exact = Decimal(value)
    if not exact.is_finite():
        return str(float(value))
    up = Context(prec=digits, rounding=ROUND_CEILING).plus(exact).normalize()
    small = up and not -4 <= up.adjusted() < max(digits, 6)
    return f"{up:e}".replace("e+", "e") if small else f"{up:f}"


def printed_bound(value: float | None, digits: int = 6) -> str:
    """A bound as a table shows it; a dash where there is none."""
    return "-" if value is None or not math.isfinite(value) else rounded_up(value, digits)
