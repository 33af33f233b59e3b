"""Numbers in few digits: bounds as texts that are not below them, and decimals that are near."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

from certrack.core.rationals import exact_rational

#: Digits of a fraction before it is rounded to those that are shown.
EXACT_DIGITS = 40


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
    return _short_text(value, digits, ROUND_CEILING)


def rounded_down(value: float | str, digits: int) -> str:
    """The same, not above the value: for strengths and margins."""
    return _short_text(value, digits, ROUND_FLOOR)


def rounded_range(low: float, high: float, digits: int = 6) -> str:
    """A range as text, its ends rounded outward; an exact end such as 0.3 or "1/3" as what it is.

    >>> rounded_range(0.3, 2.00000001)
    '[0.3, 2.00001]'
    >>> rounded_range(-0.0, 1.0)
    '[0, 1]'
    """
    floor, ceiling = (
        str(Context(prec=EXACT_DIGITS, rounding=rounding).divide(*map(Decimal, exact_pair(end))))
        for end, rounding in ((low, ROUND_FLOOR), (high, ROUND_CEILING))
    )
    return f"[{rounded_down(floor, digits)}, {rounded_up(ceiling, digits)}]"


def exact_pair(value: float) -> tuple[int, int]:
    """Numerator and denominator of what a float stands for."""
    exact = exact_rational(value)
    return exact.numerator, exact.denominator


def _short_text(value: float | str, digits: int, rounding: str) -> str:
    exact = Decimal(value)
    if not exact.is_finite():
        return str(float(value))
    short = Context(prec=digits, rounding=rounding).plus(exact).normalize()
    short = short or Decimal(0)  # not -0
    in_full = not short or -4 <= short.adjusted() < max(digits, 6)
    return f"{short:f}" if in_full else f"{short:e}".replace("e+", "e")


def in_digits(value: float, digits: int) -> float:
    """The float of the nearest decimal with so many digits.

    >>> in_digits(2 / 3, 3)
    0.667
    """
    return float(f"{value:.{digits}g}")


def printed_bound(value: float | None, digits: int = 6) -> str:
    """A bound as a table shows it; a dash where there is none."""
    return "-" if value is None or not math.isfinite(value) else rounded_up(value, digits)
