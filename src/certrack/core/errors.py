"""Exceptions. Each message is one line: what, where, what was expected, what came, the remedy.

All are one tree with :class:`CertrackError` at the root, and all can be pickled, so that a worker
process hands them back with every field.
"""

from __future__ import annotations

import pickle
from typing import Any

#: Characters of a key and of a sentence in a message: they may quote a name of the user's.
MAX_KEY, MAX_SENTENCE = 200, 1000


class CertrackError(Exception):
    """Base of everything certrack raises on purpose."""

    def __reduce__(self) -> tuple[Any, ...]:
        fields = {name: picklable(value) for name, value in self.__dict__.items()}
        return _restored, (type(self), tuple(map(picklable, self.args)), fields)


class Cancelled(CertrackError):
    """The user stopped a long call by its `progress`."""


class InputError(CertrackError, ValueError):
    """An argument or a system-file key does not meet its requirement.

    Parameters
    ----------
    key : str
        The argument or dotted key, e.g. ``"plant.chain"``.
    expected : str
        The requirement, in words.
    got : object, optional
        What came instead; shown shortened.
    remedy : str, optional
        What the user can do about it.

    Attributes
    ----------
    file : str
        The file in which the key stands; empty if it does not come from a file.
    line : int or None
        Its line there, counted from 1; that of its table if the key is missing; None if unknown.
    """

    def __init__(self, key: str, expected: str, got: Any = None, remedy: str = "") -> None:
        self.key, self.expected, self.got, self.remedy = key, expected, got, remedy
        self.file = ""
        self.line: int | None = None
        super().__init__(key, expected)

    def within(self, file: str, line: int | None = None) -> InputError:
        """Name the file, and the line if it is known, in which the offending key stands."""
        self.file, self.line = file, line
        return self

    def under(self, key: str) -> InputError:
        """Say that the offending key stands under another one."""
        self.key = f"{key}.{self.key}"
        return self

    def __str__(self) -> str:
        file = self.file if self.line is None else f"{self.file}:{self.line}"
        where = ": ".join(part for part in (file, shorten(self.key, MAX_KEY)) if part)
        text = f"{where}: {shorten(self.expected, MAX_SENTENCE)}"
        if self.got is not None:
            text += f"; got {shorten(self.got)}"
        if self.remedy:
            text += f". {shorten(self.remedy, MAX_SENTENCE)}"
        return one_line(text)


class DesignError(InputError):
    """The data are well formed, but no controller of the requested kind exists for them."""


class MissingExtra(CertrackError):
    """An optional dependency is not installed."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs {package}, which is not installed: pip install 'certrack[{extra}]'"
        )


def _restored(
    kind: type[CertrackError], arguments: tuple[Any, ...], fields: dict[str, Any]
) -> CertrackError:
    """An error as it was pickled, without asking its constructor."""
    error = kind.__new__(kind)
    error.args = arguments
    error.__dict__.update(fields)
    return error


def picklable(value: Any) -> Any:
    """The value itself, or its text where it cannot be pickled: `got` may be anything."""
    try:
        pickle.dumps(value)
    except Exception:
        return shorten(value)
    return value


def one_line(text: str) -> str:
    """Text with every control character and line break made visible or a space."""
    return "".join(ch if ch.isprintable() else " " for ch in text)


def shorten(value: Any, limit: int = 80) -> str:
    """Representation of `value` that fits into a message."""
    try:
        text = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):  # an int of thousands of digits, a self-nested list
        text = f"a {type(value).__name__} too large to print"
    text = one_line(text[: 4 * limit])
    return text if len(text) <= limit else text[: limit - 3] + "..."
