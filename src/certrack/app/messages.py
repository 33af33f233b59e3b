"""What a page may ask: each message checked before anything is done about it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from certrack.app.frames import MAX_DESIGN, MAX_REVISION, MAX_VIEW
from certrack.core import checks
from certrack.core.errors import InputError

#: Bytes of a message; a longer one closes the connection.
MAX_MESSAGE = 1 << 20

#: Bytes of the text of a system, wherever it comes from: a message has room for it and its escapes.
MAX_TEXT_BYTES = MAX_MESSAGE // 2

#: Gains, and entries of a form, that one message may change.
MAX_ENTRIES_CHANGED = 2000

#: Lists and tables in each other that a message may have: the deepest that a page sends has four.
MAX_MESSAGE_DEPTH = 16

#: Columns of pixels that a plot may have.
LEAST_PIXELS, MOST_PIXELS = 50, 8000

#: The long computations that a page may start, and the formats it may have; those of the dossier
#: with the ending of its file.
TASKS = ("falsify", "ensemble", "margins", "tune", "optimum")
REPORTS = {"report": ".html", "report-pdf": ".pdf", "report-md": ".md", "report-tex": ".tex"}
EXPORTS = ("toml", "certificate", *REPORTS, "c", "st", "fmu", "netcdf", "png", "svg", "pdf")


@dataclass(frozen=True)
class Hello:
    """The first message: which protocol the page speaks."""

    protocol: int


@dataclass(frozen=True)
class GainMove:
    """Gains and a window of time: the newest wins.

    Attributes
    ----------
    design, view : int
        Counters: of every change of gains or text, and of every change of the window.
    revision : int
        The text that the gains are of.
    gains : mapping of paths to numbers
        What differs from that text.
    window : (low, high) or None, s
        None for the whole run.
    pixels : int
        Width of the plots.
    resting : bool
        Whether the gesture is over, so that the text is to follow.
    law : bool
        Whether the page shows plant and law as formulas, so that they are to follow, too.
    """

    design: int
    view: int
    revision: int
    gains: Mapping[str, float]
    window: tuple[float, float] | None
    pixels: int
    resting: bool
    law: bool = False


@dataclass(frozen=True)
class Open:
    """A system: a shipped one, a file of the folder, or the commented empty plant."""

    revision: int
    source: str
    name: str


@dataclass(frozen=True)
class NewText:
    """The text of a system file as the user has it now."""

    revision: int
    text: str
    name: str


@dataclass(frozen=True)
class FormEdit:
    """Entries of a text to be changed: TOML by path; an empty one is left out of the file.

    The text has the gains that its sliders have before.
    """

    revision: int
    text: str
    name: str
    entries: Mapping[str, str]
    gains: Mapping[str, float]


@dataclass(frozen=True)
class StartTask:
    """A long computation about the design that the page shows."""

    task: str
    options: Mapping[str, Any]
    design: int
    revision: int
    gains: Mapping[str, float]


@dataclass(frozen=True)
class CancelTask:
    """End the long computation."""


@dataclass(frozen=True)
class Export:
    """The design that the page shows, in a format."""

    format: str
    design: int
    revision: int
    gains: Mapping[str, float]


@dataclass(frozen=True)
class ListFiles:
    """Shipped systems and files of the folder."""


@dataclass(frozen=True)
class Save:
    """Write the text to a file of the folder.

    Attributes
    ----------
    known : str
        Digest of the file that may be replaced; empty where there must be none.
    """

    name: str
    text: str
    known: str


Message = (
    Hello
    | GainMove
    | Open
    | NewText
    | FormEdit
    | StartTask
    | CancelTask
    | Export
    | ListFiles
    | Save
)


def parse_message(text: str) -> Message:
    """One message of a page.

    Raises
    ------
    InputError
        If it is none.
    """
    if len(text) > MAX_MESSAGE or len(text.encode("utf-8", "replace")) > MAX_MESSAGE:
        raise InputError("message", f"is longer than {MAX_MESSAGE} bytes")
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("message", "is not JSON") from None
    if not isinstance(values, dict):
        raise InputError("message", "must be an object", values)
    _require_shallow(values)
    kind = checks.choice("type", values.get("type"), _READERS)
    try:
        message: Message = _READERS[kind](values)
    except KeyError as missing:
        raise InputError(f"message.{missing.args[0]}", "is missing") from None
    return message


def _require_shallow(values: Any) -> None:
    """Refuse what whoever walks through it, here or in a worker, could not come to the end of."""
    level = [values]
    for _ in range(MAX_MESSAGE_DEPTH):
        tables = (entry.values() if isinstance(entry, dict) else entry for entry in level)
        level = [v for entries in tables for v in entries if isinstance(v, (dict, list))]
        if not level:
            return
    raise InputError("message", f"has lists in each other, more than {MAX_MESSAGE_DEPTH} of them")


def _move(values: dict[str, Any]) -> GainMove:
    window = values.get("window")
    return GainMove(
        _counter(values, "design", MAX_DESIGN),
        _counter(values, "view", MAX_VIEW),
        _revision(values),
        _gains(values.get("gains", {})),
        None if window is None else checks.ordered_pair("window", window, strict=True),
        checks.integer("pixels", values["pixels"], LEAST_PIXELS, MOST_PIXELS),
        values.get("resting") is True,
        values.get("law") is True,
    )


def _gains(entries: Any) -> dict[str, float]:
    table = _table("gains", entries)
    for path, value in table.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(path, "must be a number", value)
    return {path: checks.real(path, value) for path, value in table.items()}


def _form_edit(values: dict[str, Any]) -> FormEdit:
    entries = _table("entries", values["entries"])
    texts = {path: _long_text(path, value) for path, value in entries.items()}
    gains = _gains(values.get("gains", {}))
    return FormEdit(_revision(values), *_text_and_name(values), texts, gains)


def _text_and_name(values: dict[str, Any]) -> tuple[str, str]:
    return _long_text("text", values["text"]), checks.text("name", values.get("name", ""))


def _start_task(values: dict[str, Any]) -> StartTask:
    return StartTask(
        checks.choice("task", values["task"], TASKS),
        _table("options", values.get("options", {})),
        *_shown(values),
    )


def _shown(values: dict[str, Any]) -> tuple[int, int, dict[str, float]]:
    """Counters and gains of what the page shows."""
    gains = _gains(values.get("gains", {}))
    return _counter(values, "design", MAX_DESIGN), _revision(values), gains


def _revision(values: dict[str, Any]) -> int:
    return _counter(values, "revision", MAX_REVISION)


def _table(key: str, entries: Any) -> dict[str, Any]:
    if not isinstance(entries, dict) or len(entries) > MAX_ENTRIES_CHANGED:
        raise InputError(key, f"must be a table of at most {MAX_ENTRIES_CHANGED} entries")
    return entries


def _long_text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(key, "must be a text", value)
    try:
        require_text_size(key, value.encode())
    except UnicodeEncodeError:
        raise InputError(key, "must be a text without lone surrogates") from None
    return value


def require_text_size(name: str, data: bytes) -> None:
    """Refuse the text of a system that is larger than a page may have.

    Raises
    ------
    InputError
        If it is.
    """
    if len(data) > MAX_TEXT_BYTES:
        limit = f"is larger than {MAX_TEXT_BYTES >> 10} kB"
        raise InputError(name, limit, remedy="Use the command line, or files of samples")


def _counter(values: dict[str, Any], name: str, most: int) -> int:
    return checks.integer(name, values[name], 0, most)


_READERS: Mapping[str, Any] = {
    "hello": lambda v: Hello(checks.integer("protocol", v["protocol"], 0, 10**6)),
    "set": _move,
    "open": lambda v: Open(
        _revision(v),
        checks.choice("source", v["source"], ("catalog", "file", "empty")),
        checks.text("name", v.get("name", "")),
    ),
    "text": lambda v: NewText(_revision(v), *_text_and_name(v)),
    "edit": _form_edit,
    "task": _start_task,
    "cancel": lambda _: CancelTask(),
    "export": lambda v: Export(checks.choice("format", v["format"], EXPORTS), *_shown(v)),
    "files": lambda _: ListFiles(),
    "save": lambda v: Save(
        checks.text("name", v["name"]),
        _long_text("text", v["text"]),
        checks.text("known", v.get("known", "")),
    ),
}
