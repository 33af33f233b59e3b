"""Tables of the system file: their keys are known, none is missing, and formulas are numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import Key
from certrack.systems.keys import TABLES

#: Largest file that is read: a million samples of a reference fit.
MAX_FILE_BYTES = 20_000_000


def read_bytes(path: Path) -> bytes:
    """What is in a file that is not too large."""
    with path.open("rb") as stream:
        data = stream.read(MAX_FILE_BYTES + 1)
    if len(data) > MAX_FILE_BYTES:
        raise InputError(str(path), f"is larger than {MAX_FILE_BYTES // 1_000_000} MB")
    return data


def read_values(
    table: str,
    entries: Any,
    constants: Mapping[str, Any],
    keys: Mapping[str, Key] | None = None,
) -> dict[str, Any]:
    """Entries of a table, all known and none missing, with numbers instead of their formulas.

    The class or function that takes them checks the rest.
    """
    keys = TABLES[table] if keys is None else keys
    required = [name for name, key in keys.items() if key.required]
    checks.known_keys(table, entries, keys, required)
    return {
        name: keys[name].evaluated(f"{table}.{name}", value, constants)
        for name, value in entries.items()
    }


def refuse_keys_of_another(
    table: str, entries: Mapping[str, Any], what: str, keys: Mapping[str, Mapping[str, Key]]
) -> None:
    """Say at once which keys belong to another kind than the table's, and to which."""
    kind = entries["kind"]
    owners = {
        name: [other for other in keys if name in keys[other]]
        for name in entries
        if name not in keys[kind]
    }
    foreign = [name for name, kinds in owners.items() if kinds]
    if not foreign:
        return
    first, *others = foreign
    have = "has" if len(owners[first]) == 1 else "have"
    raise InputError(
        f"{table}.{first}",
        f"is not a key of the {kind} {what} ({', '.join(owners[first])} {have} it)",
        remedy=f"Nor: {', '.join(others)}" if others else "",
    )
