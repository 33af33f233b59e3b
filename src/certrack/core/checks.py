"""Refuse early: turn what the user gave into what the library needs, or say exactly why not."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from certrack.core.errors import InputError
from certrack.core.expressions import MAX_MAGNITUDE, Expression, number
from certrack.core.rationals import RationalFloat, float_above, float_below, float_of
from certrack.core.spelling import hint

Constants = Mapping[str, Any]

#: Whole numbers up to this are floats.
LARGEST_EXACT_INTEGER = 2**53


def sequence(key: str, value: Any, length: int | None, what: str) -> list[Any]:
    """A list of the given length (any length if None)."""
    unordered = (str, bytes, Mapping, set, frozenset)
    is_list = isinstance(value, Iterable) and not isinstance(value, unordered)
    try:
        entries = list(value) if is_list else None
    except TypeError:  # an array without dimensions
        entries = None
    if entries is None or (length is not None and len(entries) != length):
        count = "a list" if length is None else f"a list of {length}"
        raise InputError(key, f"must be {count}: {what}", as_written(value))
    return entries


#: Lists in each other up to which a value is written anew for a message, which shows no more.
MAX_SHOWN_DEPTH = 40


def as_written(value: Any, depth: int = MAX_SHOWN_DEPTH) -> Any:
    """The value as the user wrote it, for messages; lists in each other down to a depth."""
    if isinstance(value, Expression):
        return number_or_text(value.text)
    if isinstance(value, RationalFloat):
        return value.text
    if depth and isinstance(value, (list, tuple)):
        return [as_written(entry, depth - 1) for entry in value]
    return value


def number_or_text(text: str) -> int | float | str:
    """The number that a text is the shortest form of, or else the text itself."""
    for kind in (int, float):
        try:
            value = kind(text)
        except ValueError:
            continue
        if repr(value) == text and math.isfinite(value):
            return value
    return text


def real(
    key: str,
    value: Any,
    names: Constants | None = None,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    nonzero: bool = False,
    infinite: bool = False,
    side: int = 0,
) -> float:
    """A number, or a formula of the constants, within the stated limits.

    Parameters
    ----------
    above, least : float, optional
        Strict and non-strict lower limit.
    most : float, optional
        Upper limit.
    nonzero : bool
        Refuse zero.
    infinite : bool
        Accept ``inf``.
    side : int
        An irrational number becomes the float above it (1), below it (-1) or nearest to it (0).

    Returns
    -------
    float
        One that stands for the rational of the text, wherever that is one.
    """
    if infinite and isinstance(value, (str, float)) and value in ("inf", math.inf):
        return math.inf
    if type(value) is int and abs(value) <= LARGEST_EXACT_INTEGER:
        result = float(value)
    elif isinstance(value, RationalFloat) or (type(value) is float and abs(value) <= MAX_MAGNITUDE):
        result = value
    else:
        result = _float_beside(number(key, value, names).expr, side)
    if above is not None and not result > above:
        wanted = "positive" if above == 0 else f"greater than {above:g}"
        raise InputError(
            key, f"must be {wanted}" + (" or inf" if infinite else ""), as_written(value)
        )
    if least is not None and not result >= least:
        wanted = "zero or positive" if least == 0 else f"at least {least:g}"
        raise InputError(key, f"must be {wanted}", as_written(value))
    if most is not None and not result <= most:
        raise InputError(key, f"must be at most {most:g}", as_written(value))
    if nonzero and result == 0:
        raise InputError(key, "must not be zero", as_written(value))
    return result


def _float_beside(expr: Any, side: int) -> float:
    if not side or expr.is_Rational:
        return float_of(expr)
    return float_above(expr) if side > 0 else float_below(expr)


def reals(
    key: str,
    value: Any,
    length: int | None,
    what: str,
    names: Constants | None = None,
    **limits: Any,
) -> tuple[float, ...]:
    """A list of numbers, each within the limits of :func:`real`."""
    entries = sequence(key, value, length, what)
    return tuple(real(f"{key}[{i}]", v, names, **limits) for i, v in enumerate(entries))


def finite_array(key: str, value: Any, dimensions: int) -> np.ndarray:
    """An array of finite numbers, for lists too long to be read one by one."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError):
        array = np.empty(0, dtype=object)  # rows of different lengths
    if array.dtype.kind not in "iuf" or array.ndim != dimensions or not np.isfinite(array).all():
        wanted = "a list" if dimensions == 1 else "rows of equal length"
        raise InputError(key, f"must be {wanted} of finite numbers", as_written(value))
    return array.astype(float)


def ordered_pair(
    key: str, value: Any, names: Constants | None = None, *, strict: bool = False
) -> tuple[float, float]:
    """A pair [low, high] with low <= high, or low < high; irrational ends are rounded outward."""
    ends = sequence(key, value, 2, "[low, high]")
    low, high = (real(f"{key}[{i}]", v, names, side=2 * i - 1) for i, v in enumerate(ends))
    if strict and low >= high:
        raise InputError(key, "low must be less than high", [low, high])
    if low > high:
        raise InputError(key, "low must not exceed high", as_written(value))
    return low, high


def integer(key: str, value: Any, least: int, most: int) -> int:
    """A whole number within [least, most]."""
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not is_whole or not least <= value <= most:
        raise InputError(key, f"must be a whole number from {least} to {most}", as_written(value))
    return int(value)


def name_value_pairs(key: str, constants: Any) -> list[tuple[str, Any]]:
    """Constants as pairs of different names, from a mapping or from pairs."""
    is_mapping = isinstance(constants, Mapping)
    pairs = sequence(key, constants.items() if is_mapping else constants, None, "name and number")
    if not all(isinstance(pair, (tuple, list)) and len(pair) == 2 for pair in pairs):
        raise InputError(key, "must be a mapping of names to numbers", constants)
    used: set[str] = set()
    for name, _ in pairs:
        if not isinstance(name, str):
            raise InputError(key, "names must be texts", name)
        if name in used:
            raise InputError(f"{key}.{name}", "names must be different from each other", name)
        used.add(name)
    return [(name, value) for name, value in pairs]


def choice(key: str, value: Any, options: Iterable[str], remedy: str = "") -> str:
    """One of the listed words."""
    options = list(options)
    if not isinstance(value, str) or value not in options:
        raise InputError(key, "must be one of " + ", ".join(options), as_written(value), remedy)
    return value


def text(key: str, value: Any) -> str:
    """One line of printable text."""
    if not isinstance(value, str) or not value.isprintable():
        raise InputError(key, "must be one line of printable text", as_written(value))
    return value


def known_keys(key: str, table: Any, allowed: Iterable[str], required: Iterable[str] = ()) -> None:
    """Refuse a table with unknown or missing keys."""
    if not isinstance(table, Mapping):
        raise InputError(key, f"must be a table [{key}]", as_written(table))
    allowed = list(allowed)
    for name in table:
        if name not in allowed:
            where = f"{key}.{name}" if key else str(name)
            remedy = f"{hint(str(name), allowed)}Known here: {', '.join(allowed)}"
            raise InputError(where, "unknown key", remedy=remedy)
    for name in required:
        if name not in table:
            raise InputError(f"{key}.{name}" if key else name, "is missing")
