"""A system file with another law: everything else, and its comments, stay as the user wrote it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from certrack.core.errors import one_line
from certrack.systems.writer import to_text, toml_table

if TYPE_CHECKING:
    from certrack.systems.system import System


def with_law(text: str, system: System, remarks: Sequence[str] = ()) -> str:
    """The text of a system file with the law of `system` in the place of its own.

    Parameters
    ----------
    text : str
        Of a file that loads; the whole system is written if it is empty.
    system : System
        The file's system with another law.
    remarks : texts
        Written as comments above the table of the law.

    Returns
    -------
    str
    """
    import tomlkit

    document = tomlkit.parse(text if text.strip() else to_text(system))
    table = tomlkit.table()
    for remark in remarks:
        table.add(tomlkit.comment(one_line(remark)))
    parts = [item for key, item in document.body if key is not None and key.key == "law"]
    for key, value in law_entries(system).items():
        table.add(key, value)
    for part in parts:
        _keep_comments(table, part)
    for line in [line for part in parts for line in _after_the_keys(part)] or [tomlkit.nl()]:
        table.add(line)
    document["law"] = table
    if system.settings.estimates is None:
        simulation: Any = document.get("simulation", {})
        simulation.pop("estimates", None)
    return tomlkit.dumps(document)


def _keep_comments(table: Any, earlier: Any) -> None:
    """Comments beside keys that stay, in tables within the table, too."""
    from tomlkit.items import Table

    if not (isinstance(table, Table) and isinstance(earlier, Table)):
        return
    for key in [key for key in table if key in earlier]:
        item: Any
        before: Any
        item, before = (entry.value.item(key) for entry in (table, earlier))
        if isinstance(item, Table):
            _keep_comments(item, before)
        elif not isinstance(before, Table) and before.trivia.comment:
            item.comment(before.trivia.comment)


def _after_the_keys(table: Any) -> list[Any]:
    """Blank lines and comments below the last key: a heading of what follows in the file."""
    from tomlkit.items import Comment, Table, Whitespace

    lines: list[Any] = []
    while isinstance(table, Table):
        body = table.value.body
        count = len(body)
        while count and body[count - 1][0] is None:
            count -= 1
        trailing = [item for _, item in body[count:]]
        lines = [item for item in trailing if isinstance(item, Comment | Whitespace)]
        table = body[count - 1][1] if count and not trailing else None
    return lines


def law_entries(system: System) -> dict[str, Any]:
    """The keys and values of the table ``[law]``."""
    return toml_table(system.law)
