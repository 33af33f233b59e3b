"""What a key of the system file holds, said once: as metadata of the field that it fills.

The loader, its messages, the page on the system file, the comments of the starter file and the
forms of a designer all read these :class:`Key` s.

The classes that hold the values are frozen dataclasses, laws of a user's own among them, so that
``dataclasses.replace`` works on all of them. A field holds what its type says; the constructor
also takes what a user writes (lists, numbers, texts) and turns it into that, and
:func:`set_fields` is the one place where a field is set while its instance is being built.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError

#: kind of a key -> what a reader of the page is told.
KIND_WORDS = {
    "any": "numbers",
    "choice": "one of",
    "constants": "a number per name",
    "distribution": "number or distribution",
    "distributions": "list of numbers or distributions",
    "distributions by name": "a number or distribution per name",
    "flag": "true or false",
    "formula": "formula",
    "formulas": "list of formulas",
    "integer": "whole number",
    "interval": "[low, high]",
    "intervals": "list of [low, high]",
    "intervals by name": "[low, high] per name",
    "metric": "diagonal or matrix",
    "names": "list of names",
    "number": "number",
    "number or numbers": "number or list of numbers",
    "numbers": "list of numbers",
    "rows": "list of lists of numbers",
    "text": "text",
    "texts": "list of texts",
    "weights": "{error, input}: numbers, error also a list",
}

#: Kinds whose texts are formulas of the plant's constants that give numbers: one, lists, tables.
SCALARS = ("number", "distribution", "number or numbers")
LISTS = (
    *("distributions", "interval", "intervals", "metric"),
    *("number or numbers", "numbers", "rows"),
)
BY_NAME = ("distributions by name", "weights")


@dataclass(frozen=True)
class Key:
    """What a key of the system file holds.

    Parameters
    ----------
    kind : str
        One of :data:`KIND_WORDS`.
    help : str
        What it means, in one sentence without a full stop.
    shape : str
        Of lists: what the entries are, or how many, e.g. ``"one number per state"``.
    unit : str
        E.g. ``"1/s"``; empty if it depends on the plant or there is none.
    above, least, most : float, optional
        Strict lower limit, lower limit, upper limit of every number in it.
    nonzero, infinite : bool
        Zero is refused; ``inf`` is accepted.
    strict : bool
        Of intervals: low must be less than high, not only not above it.
    choices : tuple
        The words, or whole numbers, to choose from.
    required : bool
        Whether the file must have it.
    default : object
        The value if it is left out; None if :attr:`otherwise` says what then holds.
    otherwise : str
        What holds if it is left out, in words.
    path : str
        Its name below the table where that is not the name of the field, e.g. ``"ranges.theta"``.
    """

    kind: str
    help: str = ""
    shape: str = ""
    unit: str = ""
    above: float | None = None
    least: float | None = None
    most: float | None = None
    nonzero: bool = False
    infinite: bool = False
    strict: bool = False
    choices: tuple[Any, ...] = ()
    required: bool = False
    default: Any = None
    otherwise: str = ""
    path: str = ""

    def __post_init__(self) -> None:
        if self.kind not in KIND_WORDS:
            raise ValueError(f"no such kind of key: {self.kind}")
        if self.kind == "integer" and (self.least is None or self.most is None):
            raise ValueError("a key that holds a whole number needs both limits")

    @property
    def comment(self) -> str:
        """Its meaning and unit, as a comment in a system file says them."""
        return ", ".join(part for part in (self.help, self.unit) if part)

    @property
    def limits(self) -> str:
        """Its limits in words; empty if there are none."""
        if self.choices:
            return " | ".join(map(str, self.choices))
        words = [f"> {self.above:g}"] if self.above is not None else []
        if self.least is not None and self.most is not None:
            words.append(f"{_short(self.least)} to {_short(self.most)}")
        elif self.least is not None:
            words.append(f">= {self.least:g}")
        elif self.most is not None:
            words.append(f"<= {self.most:g}")
        words += ["low < high"] if self.strict else []
        words += ["not 0"] if self.nonzero else []
        words += ["or inf"] if self.infinite else []
        return " ".join(words)

    def as_dict(self) -> dict[str, Any]:
        """What JSON can hold of it: kind, shape, unit, limits, default and help; no empty entry."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        del values["path"]
        default = values.pop("default")
        shown = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()
            if value is not None and value is not False and value not in ("", ())
        }
        return shown if default is None else shown | {"default": checks.as_written(default)}

    def checked(
        self,
        key: str,
        value: Any,
        constants: Mapping[str, Any] | None = None,
        *,
        count: int | None = None,
    ) -> Any:
        """The value as the library holds it.

        Parameters
        ----------
        key : str
            Where it stands, for messages.
        value : object
            What the user gave.
        constants : mapping of names to numbers, optional
            Names that may occur in formulas of numbers.
        count : int, optional
            How many entries a list must have; any number if left out.

        Raises
        ------
        InputError
            If it is not what this key holds.
        NotImplementedError
            If only the class that holds it can check it: formulas, names by value, distributions.
        """
        match self.kind:
            case "number":
                return self._number(key, value, constants)
            case "number or numbers" if isinstance(value, str) or not hasattr(value, "__len__"):
                return self._number(key, value, constants)
            case "numbers" | "number or numbers":
                entries = checks.sequence(key, value, count, self.shape)
                return tuple(
                    self._number(f"{key}[{i}]", v, constants) for i, v in enumerate(entries)
                )
            case "integer":
                assert self.least is not None and self.most is not None
                return checks.integer(key, value, int(self.least), int(self.most))
            case "choice" if isinstance(self.choices[0], str):
                return checks.choice(key, value, self.choices)
            case "choice":
                return self._whole_choice(key, value)
            case "interval":
                return self._interval(key, value, constants)
            case "intervals":
                entries = checks.sequence(key, value, count, self.shape)
                return tuple(
                    self._interval(f"{key}[{i}]", v, constants) for i, v in enumerate(entries)
                )
            case "metric":
                return self._metric(key, value, constants)
            case "flag":
                if not isinstance(value, bool):
                    raise InputError(key, "must be true or false", checks.as_written(value))
                return value
            case "text":
                return checks.text(key, value)
            case "texts" | "names":
                entries = checks.sequence(key, value, count, self.shape)
                return tuple(checks.text(f"{key}[{i}]", v) for i, v in enumerate(entries))
        raise NotImplementedError(f"{key}: a {self.kind} is checked by the class that holds it")

    def evaluated(self, key: str, value: Any, constants: Mapping[str, Any]) -> Any:
        """The value with numbers instead of formulas of the constants; what does not fit stays."""
        fits = (
            self.kind == "any"
            or (self.kind in SCALARS and not isinstance(value, list))
            or (self.kind in LISTS and isinstance(value, list))
            or (self.kind in BY_NAME and isinstance(value, dict))
        )
        return _evaluated(key, value, constants) if fits else value

    def _number(self, key: str, value: Any, constants: Mapping[str, Any] | None) -> float:
        limits: dict[str, Any] = {"nonzero": self.nonzero, "infinite": self.infinite}
        if self.unit and self.least is not None and self.most is not None:
            number = checks.real(key, value, constants, **limits)
            if not self.least <= number <= self.most:
                wanted = f"must be {self.least:g} to {self.most:g} {self.unit}"
                raise InputError(key, wanted, checks.as_written(value))
            return number
        limits |= {"above": self.above, "least": self.least, "most": self.most}
        return checks.real(key, value, constants, **limits)

    def _interval(
        self, key: str, value: Any, constants: Mapping[str, Any] | None
    ) -> tuple[float, float]:
        low, high = checks.ordered_pair(key, value, constants, strict=self.strict)
        if self.above is not None and not low > self.above:
            wanted = "positive" if self.above == 0 else f"greater than {self.above:g}"
            raise InputError(key, f"must be {wanted}", low)
        return low, high

    def _metric(self, key: str, value: Any, constants: Mapping[str, Any] | None) -> Any:
        """A diagonal of positive numbers or a square matrix; its design checks definiteness."""
        rows = checks.sequence(key, value, None, self.shape)
        if any(not isinstance(row, str) and hasattr(row, "__len__") for row in rows):
            return tuple(
                checks.reals(f"{key}[{i}]", row, len(rows), "row", constants)
                for i, row in enumerate(rows)
            )
        return checks.reals(
            key, rows, None, "one number per regressor", constants, above=self.above
        )

    def _whole_choice(self, key: str, value: Any) -> int:
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if not is_number or value not in self.choices:
            raise InputError(key, "must be " + " or ".join(map(str, self.choices)), value)
        return int(value)


def keyed(kind: str, default: Any = MISSING, **description: Any) -> Any:
    """Dataclass field that a key of the system file fills; without a default it is required.

    Parameters
    ----------
    kind : str
        See :class:`Key`.
    default : object, optional
        Of the field. None where the key may be left out and `otherwise` says what then holds.
    **description
        The rest of :class:`Key`.
    """
    required = description.pop("required", default is MISSING)
    shown = None if default is MISSING else default
    key = Key(kind, required=required, default=None if required else shown, **description)
    if default is MISSING:
        return field(metadata={"key": key})
    return field(default=default, metadata={"key": key})


def keys_of(owner: Any) -> dict[str, Key]:
    """Field names of a dataclass and the keys that fill them."""
    return {entry.name: entry.metadata["key"] for entry in fields(owner) if "key" in entry.metadata}


def require_compared(where: str, owner: Any) -> None:
    """Refuse a dataclass of a user's whose equality leaves out what its instances are made of.

    Results are remembered, and compiled code is shared, for what is equal.

    Raises
    ------
    InputError
    """
    left_out = [entry.name for entry in fields(owner) if entry.init and not entry.compare]
    if left_out:
        message = f"of equal ones {', '.join(left_out)} may differ: what is computed is shared"
        remedy = "Leave compare=False out, and make it a number, a text or a tuple of them"
        raise InputError(where, message, owner.__name__, remedy)


def set_fields(instance: object, **values: Any) -> None:
    """Set fields of a frozen dataclass while it is being built."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def check_fields(instance: Any, table: str, *names: str) -> None:
    """Check the named fields (all that have a key, if none is named) by themselves and set them.

    A field that is None where None is its default is left as it is.
    """
    keys = keys_of(instance)
    defaults = {entry.name: entry.default for entry in fields(instance)}
    for name in names or keys:
        value, key = getattr(instance, name), keys[name]
        if value is None and defaults[name] is None:
            continue
        where = ".".join(filter(None, (table, key.path or name)))
        set_fields(instance, **{name: key.checked(where, value)})


def _short(value: float) -> str:
    """A limit as text: large powers of two as 2^k."""
    power = int(math.log2(value)) if value >= 2**20 else 0
    return f"2^{power}" if power and value == 2**power else f"{value:g}"


def _evaluated(key: str, value: Any, constants: Mapping[str, Any]) -> Any:
    """Formulas in nested lists and tables replaced by their numbers."""
    if isinstance(value, list):
        return [_evaluated(f"{key}[{i}]", entry, constants) for i, entry in enumerate(value)]
    if isinstance(value, dict):
        return {name: _evaluated(f"{key}.{name}", v, constants) for name, v in value.items()}
    if not isinstance(value, str):
        return value
    return math.inf if value == "inf" else checks.real(key, value, constants)
