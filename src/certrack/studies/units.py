"""Do the units of the states fit the equations x_i' = g_i x_{i+1} + ...?"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction

#: A unit as powers of its symbols, e.g. {"m": 1, "s": -2}.
Powers = dict[str, Fraction]

#: One factor of a unit: letters, then perhaps a power.
_FACTOR = re.compile(r"([^\W\d_]+|%|°|Ω|1)\s*(?:\^|\*\*)?\s*(-?\d+)?")
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")


def powers(text: str) -> Powers | None:
    """The powers of a unit's symbols; None where the text cannot be read.

    Examples
    --------
    >>> powers("m/s^2") == powers("m s^-2") == {"m": 1, "s": -2}
    True
    """
    result: Powers = {}
    above, *below = text.translate(_SUPERSCRIPTS).replace("**", "^").split("/")
    for sign, part in [(1, above), *((-1, part) for part in below)]:
        for word in re.split(r"[*·.\s]+", part.strip().strip("()")):
            match = _FACTOR.fullmatch(word)
            if match is None:
                return None
            symbol, power = match.groups()
            if symbol != "1":
                total = result.get(symbol, Fraction(0)) + sign * Fraction(power or 1)
                result[symbol] = total
    return {symbol: power for symbol, power in result.items() if power}


def misfits(units: Sequence[str], chain: Sequence[float]) -> list[tuple[int, str]]:
    """Where x_i' = x_{i+1} and the unit of x_{i+1} is not that of x_i per second.

    Parameters
    ----------
    units : texts
        Of the states, then perhaps of the input.
    chain : numbers
        g_1 ... g_{n-1}; one that is not 1 may carry a unit of its own.

    Returns
    -------
    list of (i, text)
        i from 0, and the unit that is expected for x_{i+1}.
    """
    wrong = []
    for i, g in enumerate(chain):
        here, after = powers(units[i]), powers(units[i + 1])
        if g != 1 or here is None or after is None:
            continue
        expected = dict(here)
        expected["s"] = expected.get("s", Fraction(0)) - 1
        if {symbol: power for symbol, power in expected.items() if power} != after:
            wrong.append((i, _per_second(units[i])))
    return wrong


def _per_second(unit: str) -> str:
    parts = powers(unit) or {}
    power = parts.get("s", Fraction(0)) - 1
    others = "*".join(s if p == 1 else f"{s}^{p}" for s, p in parts.items() if s != "s") or "1"
    if power == 0:
        return others
    return (
        f"{others}/s"
        if power == -1
        else f"{others}/s^{-power}"
        if power < 0
        else f"{others}*s^{power}"
    )
