"""Ranges of named constants: the uncertainty as a data sheet states it.

A constant p with a range may have any value in it; the law is made with the nominal one, the value
of ``[plant.constants]``. Constants that are formulas of others follow them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, number, parse, symbol

#: A range: name of the constant, lower and upper end.
ConstantRange = tuple[str, Expression, Expression]

#: Keys of [plant.ranges] that are not names of constants.
OTHER_RANGES = ("input_gain", "theta")

#: A part of the value, as a data sheet states it, and a value that needs no brackets.
_PERCENT = re.compile(r"[\s+/±-]*(\d+(?:\.\d+)?)\s*%\s*")
_DECIMAL = re.compile(r"[\w.]+")


def checked_ranges(
    ranges: Any, constants: Mapping[str, Expression], values: Mapping[str, sympy.Expr]
) -> tuple[ConstantRange, ...]:
    """Ranges by name, each around the nominal value of its constant.

    Parameters
    ----------
    ranges : mapping of names to pairs, or rows (name, low, high)
    constants : the plant's, as written
    values : their nominal values

    Raises
    ------
    InputError
        If a name is no constant, a constant is a formula of one with a range, a range is empty or
        reversed, or the nominal value lies outside it.
    """
    rows = dict(_rows(ranges, constants))
    checks.known_keys("plant.ranges", rows, constants)
    checked: list[ConstantRange] = []
    for name, pair in rows.items():
        key = f"plant.ranges.{name}"
        if name in OTHER_RANGES:
            message = "a constant of this name cannot have a range: the key means another thing"
            raise InputError(key, message, remedy="Rename the constant")
        checks.ordered_pair(key, list(pair), values, strict=True)
        low, high = (number(f"{key}[{i}]", end, values) for i, end in enumerate(pair))
        if not (low.expr.is_Rational and high.expr.is_Rational):
            raise InputError(key, "the ends must be decimals or fractions", [low.text, high.text])
        if not low.expr <= values[name] <= high.expr:
            message = f"must contain the constant's own value {float(values[name]):g}"
            raise InputError(key, message, [low.text, high.text])
        checked.append((name, low, high))
    _refuse_formulas_of_each_other(rows, constants)
    return tuple(checked)


def _rows(ranges: Any, constants: Mapping[str, Expression]) -> list[tuple[str, Any]]:
    if isinstance(ranges, Mapping):
        pairs = checks.name_value_pairs("plant.ranges", ranges)
    else:
        pairs = [(name, ends) for name, *ends in ranges]
    for name, ends in pairs:
        if isinstance(ends, (str, int, float)) and name in constants:
            message = "must be a list of 2: [low, high]"
            remedy = _as_a_pair(ends, constants[name].text)
            raise InputError(f"plant.ranges.{name}", message, ends, remedy)
    return [
        (name, checks.sequence(f"plant.ranges.{name}", v, 2, "[low, high]")) for name, v in pairs
    ]


def _as_a_pair(ends: Any, value: str) -> str:
    """How a part of the value, such as "20 %", is written as a range around it."""
    stated = _PERCENT.fullmatch(str(ends))
    part = float(stated[1]) if stated else 20.0
    value = value if _DECIMAL.fullmatch(value) else f"({value})"
    pair = f'["{1 - part / 100:g}*{value}", "{1 + part / 100:g}*{value}"]'
    return f"Within {part:g} % it is {pair}"


def _refuse_formulas_of_each_other(
    ranged: Mapping[str, Any], constants: Mapping[str, Expression]
) -> None:
    """Refuse a range for a constant that another ranged one determines."""
    for name in ranged:
        depends = dependents({name}, constants)
        for other in ranged:
            if other in depends:
                message = f"is a formula of {name}, which has a range too"
                raise InputError(f"plant.ranges.{other}", message, constants[other].text)


def dependents(names: set[str], constants: Mapping[str, Expression]) -> set[str]:
    """The constants that are formulas, directly or not, of the named ones."""
    dependent: set[str] = set()
    for name, value in constants.items():
        used = set(map(str, parse(f"plant.constants.{name}", value, None).expr.free_symbols))
        if name not in names and used & (names | dependent):
            dependent.add(name)
    return dependent


def open_constants(constants: Mapping[str, Expression], ranged: set[str]) -> dict[str, sympy.Expr]:
    """Every constant as a formula of those with a range, which stay symbols."""
    values: dict[str, sympy.Expr] = {}
    for name, value in constants.items():
        if name in ranged:
            values[name] = symbol(name)
        else:
            values[name] = parse(f"plant.constants.{name}", value, values).expr
    return values


#: Ranges at whose ends coefficients are looked at: 2^10 corners take a tenth of a second.
MAX_RANGES_AT_ENDS = 10


def check_sign_at_ends(
    key: str,
    formula: Expression,
    ranges: Sequence[ConstantRange],
    values: Mapping[str, sympy.Expr],
) -> None:
    """Refuse a coefficient that vanishes, changes its sign or has no value at an end of the ranges.

    What it does between the ends is for the certificates to see.
    """
    open_formula = parse(key, formula, values).expr
    inside = [row for row in ranges if symbol(row[0]) in open_formula.free_symbols]
    if not inside or len(inside) > MAX_RANGES_AT_ENDS:
        return
    names = [symbol(name) for name, _, _ in inside]
    signs = set()
    for corner in product(*((low.expr, high.expr) for _, low, high in inside)):
        value = open_formula.subs(dict(zip(names, corner, strict=True)))
        signs.add(sympy.sign(value) if value.is_finite else sympy.nan)
    if len(signs) != 1 or signs & {sympy.nan, sympy.S.Zero}:
        name, low, high = inside[0]
        message = f"{key} = {formula.text} must be finite and of one sign on the whole range"
        raise InputError(f"plant.ranges.{name}", message, [low.text, high.text], "Narrow the range")
