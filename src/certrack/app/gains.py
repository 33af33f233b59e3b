"""What a slider moves: the numbers of a law, each with its path in the file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from certrack.core.errors import InputError
from certrack.core.keys import Key, keys_of
from certrack.laws import LqrWeights
from certrack.systems.system import System

#: Fields of the laws in the order of the panel, and the heading above them.
GROUPS = {
    "poles": ("c", "K", "integral", "coupling"),
    "adaptation": ("gain_rate", "Gamma", "leak_gain", "leak_theta"),
    "prior guesses": ("delta0", "theta0"),
    "observer": ("bandwidth", "weights"),
    "damping": ("k", "p"),
    "weights": ("error", "input"),
    "feed-forward": ("r",),
}

#: Symbols of fields where the name of the key is none.
SYMBOLS = {
    "Gamma": "\N{GREEK CAPITAL LETTER GAMMA}",
    "delta0": "\N{GREEK SMALL LETTER DELTA}0",
    "theta0": "\N{GREEK SMALL LETTER THETA}0",
    "gain_rate": "gain rate",
    "leak_gain": "leak of \N{GREEK SMALL LETTER DELTA}",
    "leak_theta": "leak of \N{GREEK SMALL LETTER THETA}",
    "coupling": "\N{GREEK SMALL LETTER RHO}",
    "integral": "c0",
}

#: What the paper calls fields whose key has another name.
PAPER_SYMBOLS = {
    "Gamma": "\N{GREEK CAPITAL LETTER GAMMA}",
    "gain_rate": "\N{GREEK SMALL LETTER GAMMA}\N{COMBINING MACRON}",
    "leak_gain": "\N{GREEK SMALL LETTER GAMMA}\N{COMBINING MACRON}1",
    "leak_theta": "\N{GREEK SMALL LETTER GAMMA}\N{COMBINING MACRON}2",
}

#: Units that the keys do not state, because they follow from others.
UNITS = {"leak_gain": "1/s", "leak_theta": "1/s"}

#: Tables below that of a law that hold numbers, too.
BELOW = ("observer", "lqr")

#: The weights of a linear law, which are no fields with keys of their own.
WEIGHTS = {
    "error": Key("numbers", help="weight of the error x_1 - y_d, or of each state", above=0),
    "input": Key("number", help="weight of the input", above=0),
}

_PATH = re.compile(r"law\.(?:(observer|lqr)\.)?(\w+)((?:\[\d+\])*)")


@dataclass(frozen=True)
class Gain:
    """One number of a law.

    Attributes
    ----------
    path : str
        As messages and files write it, e.g. ``"law.c[0]"``.
    label : str
        Its symbol; digits at the end are an index.
    value : float
    unit, help, group : str
    linked : bool
        Whether it moves with the bandwidth.
    logarithmic : bool
        Whether it has a slider: a number that is not zero, whose sign stays.
    positive : bool
        Whether it must be above zero.
    """

    path: str
    label: str
    value: float
    unit: str
    help: str
    group: str
    linked: bool
    logarithmic: bool
    positive: bool

    def record(self) -> dict[str, Any]:
        """Ready for JSON."""
        return dict(vars(self))


def movable_gains(system: System) -> list[Gain]:
    """Every number of the law that is finite, in the order of the panel."""
    law = system.law
    listed = [*_numbers_of(law, "law", system.plant.r)]
    for table in BELOW:
        owner = getattr(law, table, None)
        if owner is not None:
            listed += _numbers_of(owner, f"law.{table}", system.plant.r)
    order = list(GROUPS)
    return sorted(listed, key=lambda gain: order.index(gain.group))


def _numbers_of(owner: Any, table: str, r: int) -> Iterator[Gain]:
    keys = _keys_of_owner(owner)
    for group, names in GROUPS.items():
        for name in names:
            if name not in keys:
                continue
            value = getattr(owner, name)
            if name == "Gamma" and value is None:
                value = (1.0,) * r
            for index, number in _entries(value):
                yield _gain(f"{table}.{name}", name, index, number, keys[name], group)


def _keys_of_owner(owner: Any) -> dict[str, Key]:
    return WEIGHTS if isinstance(owner, LqrWeights) else keys_of(owner)


def _entries(value: Any, index: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], float]]:
    """Finite numbers of a field with their places in it."""
    if isinstance(value, (tuple, list)):
        for i, entry in enumerate(value):
            yield from _entries(entry, (*index, i))
    elif isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value):
        yield index, float(value)


def _gain(path: str, name: str, index: tuple[int, ...], value: float, key: Key, group: str) -> Gain:
    digits = "".join(str(i + 1) for i in index)
    symbol = SYMBOLS.get(name, name.removesuffix("0"))
    return Gain(
        path=path + "".join(f"[{i}]" for i in index),
        label=symbol if digits == "1" and name in ("Gamma", "theta0") else symbol + digits,
        value=value,
        unit=key.unit or UNITS.get(name, ""),
        help=f"{key.help} ({PAPER_SYMBOLS[name]} of the paper)"
        if name in PAPER_SYMBOLS
        else key.help,
        group=group,
        linked=name == "c",
        logarithmic=value != 0,
        positive=key.above == 0,
    )


def with_gains(system: System, gains: Mapping[str, float]) -> System:
    """The system with other numbers of its law.

    Raises
    ------
    InputError
        If a path names no number of the law, or the law refuses one.
    """
    if not gains:
        return system
    law = system.law
    changes: dict[str, dict[str, Any]] = {}
    for path, value in gains.items():
        match = _PATH.fullmatch(path)
        owner = None if match is None else getattr(law, match[1], None) if match[1] else law
        if match is None or owner is None or match[2] not in _keys_of_owner(owner):
            raise InputError(path, "is not a gain of this law")
        of_owner, name = changes.setdefault(match[1] or "", {}), match[2]
        before = of_owner.get(name, getattr(owner, name))
        if name == "Gamma" and before is None:
            before = (1.0,) * system.plant.r
        index = [int(i) for i in re.findall(r"\d+", match[3])]
        of_owner[name] = _replaced(path, before, index, value)
    of_law = changes.pop("", {})
    for table, entries in changes.items():
        of_law[table] = replace(getattr(law, table), **entries)
    return system.replace(law=replace(law, **of_law))


def _replaced(path: str, value: Any, index: list[int], number: float) -> Any:
    """A field with one number of it replaced."""
    if not index:
        if isinstance(value, (tuple, list)):
            raise InputError(path, "is a list: name one of its numbers")
        return number
    first, *further = index
    if not isinstance(value, (tuple, list)) or first >= len(value):
        raise InputError(path, "is not a gain of this law")
    changed = _replaced(path, value[first], further, number)
    return (*value[:first], changed, *value[first + 1 :])
