"""Every key of the system file as a field, and a text with one of them changed.

The form shows what the text says, as TOML without the quotes round formulas. A change goes into the
text at its place: comments, order and everything else stay as the user wrote them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from certrack.core.checks import number_or_text
from certrack.core.errors import InputError
from certrack.core.keys import Key
from certrack.systems.keys import TABLES

#: Sections of the form: heading, and the tables that it shows.
FORM_SECTIONS = {
    "Plant": ("", "plant", "plant.constants"),
    "Uncertainty": ("plant.uncertainty", "plant.ranges"),
    "Truth": ("truth", "truth.constants", "truth.motors", "truth.supply"),
    "Reference": ("reference",),
    "Law": ("law", "law.observer"),
    "Drive": ("implementation",),
    "Ensemble": ("ensemble", "ensemble.reference", "ensemble.constants"),
    "Run": ("simulation",),
}

#: Tables whose names the user chooses.
NAMED = ("plant.constants", "truth.constants", "plant.ranges", "ensemble.constants")

#: Kinds of keys that hold texts: what is typed is put in quotes.
TEXT_KINDS = ("text", "formula", "choice")

#: Entries of a reference that suit every kind of it.
KEPT_OF_REFERENCE = ("transient",)

#: A longer entry of a file is shown in the text only.
MAX_SHOWN = 2000


def form_of(text: str) -> list[dict[str, Any]]:
    """Sections of fields, with what a text that loads says in each.

    Parameters
    ----------
    text : str

    Returns
    -------
    list of dict
        Ready for JSON.
    """
    import tomlkit

    document = tomlkit.parse(text)
    return [
        {
            "title": title,
            "fields": [field for table in tables for field in _fields(document, table)],
        }
        for title, tables in FORM_SECTIONS.items()
    ]


def _fields(document: Any, table: str) -> Iterator[dict[str, Any]]:
    entries = table_at(document, table)
    kind = str(entries.get("kind", "")) if entries is not None else ""
    keys = dict(TABLES.get(f"{table}[{kind}]", TABLES.get(table, {})))
    for name, key in keys.items():
        if isinstance((entries or {}).get(name), Mapping) and key.kind not in ("weights",):
            continue
        yield _field(f"{table}.{name}" if table else name, name, key, (entries or {}).get(name))
    if table in NAMED:
        for name in entries or {}:
            if name not in keys:
                label, help_text = name, "a name usable in every formula"
                if table == "plant.ranges":
                    label, help_text = f"range of {name}", "its lowest and its highest value"
                yield _field(f"{table}.{name}", label, Key("any", help=help_text), entries[name])


def _field(path: str, name: str, key: Key, value: Any) -> dict[str, Any]:
    shown = "" if value is None else _as_typed(value)
    return {
        "path": path,
        "name": name,
        "kind": key.kind,
        "help": key.help,
        "unit": key.unit,
        "limits": key.limits,
        "shape": key.shape,
        "choices": [str(choice) for choice in key.choices],
        "left_out": "required" if key.required else key.otherwise or _default(key),
        "value": shown if len(shown) <= MAX_SHOWN else None,
    }


def _default(key: Key) -> str:
    value = key.default
    return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _as_typed(value: Any) -> str:
    """A value as the form shows it: TOML, but a text without quotes."""
    if isinstance(value, str):
        return str(value)
    if isinstance(value, bool):
        return str(value).lower()
    as_string = getattr(value, "as_string", None)
    written: str = as_string() if as_string is not None else str(value)
    return " ".join(written.split())


def with_entries(text: str, entries: Mapping[str, str]) -> str:
    """The text with entries changed, added or, where they are empty, left out.

    Parameters
    ----------
    text : str
        TOML.
    entries : mapping of paths to what was typed

    Raises
    ------
    InputError
        If the text is no TOML, or an entry is none.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        document = tomlkit.parse(text)
    except (TOMLKitError, ValueError) as problem:
        raise InputError("", f"is not TOML: {problem}", remedy="Mend the file first") from None
    for path, typed in entries.items():
        _set(document, path, typed.strip())
    return tomlkit.dumps(document)


def with_reference_table(text: str, entries: Mapping[str, Any]) -> str:
    """The text with other entries in its table ``[reference]``; a soft start stays."""
    import tomlkit

    document = tomlkit.parse(text)
    table: Any = document["reference"]
    for name in [name for name in table if name not in KEPT_OF_REFERENCE]:
        del table[name]
    for name, value in entries.items():
        table[name] = value
    return tomlkit.dumps(document)


def with_numbers(text: str, numbers: Mapping[str, float]) -> str:
    """The text with numbers of lists and tables changed, such as ``law.c[0]``."""
    import tomlkit

    document = tomlkit.parse(text)
    for path, value in numbers.items():
        head, *index = path.replace("]", "").split("[")
        *tables, name = head.split(".")
        owner: Any = document
        for table in tables:
            owner = owner[table]
        if not index:
            owner[name] = _short(value)
            continue
        if name not in owner:  # the identity that a metric is if it is left out
            owner[name] = [1.0] * (int(index[0]) + 1)
        owner = owner[name]
        for place in index[:-1]:
            owner = owner[int(place)]
        owner[int(index[-1])] = _short(value)
    return tomlkit.dumps(document)


def _short(value: float) -> int | float:
    """A whole number without a point where it is one."""
    return int(value) if value == int(value) and abs(value) < 1e6 else value


def _set(document: Any, path: str, typed: str) -> None:
    *tables, name = path.split(".")
    owner = document
    for table in tables:
        if table not in owner:
            if not typed:
                return
            import tomlkit

            owner[table] = tomlkit.table()
        owner = owner[table]
        if not isinstance(owner, Mapping):
            raise InputError(path, "is not a table of the file")
    if not typed:
        if name in owner:
            del owner[name]
        return
    owner[name] = _parsed(path, typed, _key_of(path, owner))


def _parsed(path: str, typed: str, key: Key | None) -> Any:
    """What was typed, as TOML: texts get their quotes, numbers may be formulas."""
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    of_texts = key is not None and not any(isinstance(c, int) for c in key.choices)
    if key is not None and of_texts and key.kind in TEXT_KINDS:
        return number_or_text(typed) if key.kind == "formula" else typed
    try:
        return tomlkit.value(typed)
    except (TOMLKitError, ValueError, IndexError):
        if typed[:1] in "[{":
            raise InputError(
                path, "is not TOML", typed, 'Write lists as [1, 2], formulas in quotes: ["2*K"]'
            ) from None
        return typed


def _key_of(path: str, owner: Any) -> Key | None:
    table, _, name = path.rpartition(".")
    keys = TABLES.get(f"{table}[{owner.get('kind', '')}]", TABLES.get(table, {}))
    return keys.get(name)


def table_at(document: Any, path: str) -> Any:
    """A table of the file, such as ``plant.ranges``; None if there is none."""
    owner = document
    for name in filter(None, path.split(".")):
        owner = owner.get(name) if isinstance(owner, Mapping) else None
    return owner if isinstance(owner, Mapping) else None
