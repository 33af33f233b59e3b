"""What is written from the table of keys: the tables of the page, the comments of the starter file.

``python -m certrack.systems.documentation PAGE STARTER`` writes both anew in the files
docs/system-file.md and starter.toml; ``make keys`` calls it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from certrack.core.keys import KIND_WORDS, Key
from certrack.references.keys import REFERENCE_KINDS
from certrack.systems.keys import TABLES

BEGIN, END = "<!-- keys: written by make keys -->", "<!-- end of keys -->"
HEADINGS = ("key", "value", "unit", "if left out", "meaning")


def page_section() -> str:
    """The tables of the page on the system file, as Markdown."""
    return "\n\n".join(_page_tables())


def _page_tables() -> Iterator[str]:
    for title, rows in _merged_tables().items():
        yield "\n".join([title, "", _row(HEADINGS), _row(["---"] * len(HEADINGS)), *rows])


def _merged_tables() -> dict[str, list[str]]:
    """Headings and rows of the page's tables; a key that several kinds share is one row."""
    owners: dict[tuple[str, str, Key], list[str]] = {}
    total: dict[str, int] = {}
    for path, keys in TABLES.items():
        table, _, kind = path.rstrip("]").partition("[")
        title = f"## `[{table}]`" if table else "## Above the first table"
        title += " with a `kind`" if table == "reference" and kind else ""
        total[title] = total.get(title, 0) + 1
        for name, key in keys.items():
            owners.setdefault((title, name, key), []).append(kind)
    tables: dict[str, list[str]] = {}
    for (title, name, key), kinds in owners.items():
        only = "" if len(kinds) == total[title] else ", ".join(kinds)
        tables.setdefault(title, []).append(_key_row(name, key, only))
    return tables


def _key_row(name: str, key: Key, only: str) -> str:
    value = " ".join(filter(None, (KIND_WORDS[key.kind], key.limits)))
    value += f": {key.shape}" if key.shape else ""
    left_out = [key.otherwise or _default(key.default)]
    if key.required:
        left_out = ["**required**", key.otherwise]
    meaning = f"{key.help} ({only})" if only else key.help
    return _row([f"`{name}`", value, key.unit, " ".join(filter(None, left_out)), meaning])


def _default(value: Any) -> str:
    if isinstance(value, tuple):
        return f"`[{', '.join(map(str, value))}]`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    text = f"{value:g}" if isinstance(value, (int, float)) else str(value)
    return f"`{re.sub(r'e([+-])0*', lambda e: 'e' + e[1].strip('+'), text)}`"


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def with_section(page: str) -> str:
    """The page with its tables written anew."""
    before, after = page.partition(BEGIN)[0], page.partition(END)[2]
    return f"{before}{BEGIN}\n\n{page_section()}\n\n{END}{after}"


_STARTER_LINE = re.compile(r"(?P<code>(?:# )?(?P<name>\w+) = .*?)(?P<gap> *)(?:# (?P<comment>.*))?")

#: Column of the comments of the starter file.
COLUMN = 37


def with_comments(starter: str) -> str:
    """The starter file with the comments of its keys written anew."""
    lines, table = [], ""
    for line in starter.splitlines():
        header = re.match(r"\[([\w.]+)\]", line)
        match = _STARTER_LINE.fullmatch(line)
        table = header[1] if header else table
        comment = _starter_comment(table, match["name"], match["code"]) if match else None
        if match and comment:
            line = f"{match['code']:<{COLUMN - 2}}  # {comment}"
        lines.append(line)
    return "\n".join(lines) + "\n"


def _starter_comment(table: str, name: str, code: str) -> str | None:
    """Comment of a key; None where the file has words of its own."""
    if table == "law":
        table = "law[adaptive]"
    if table == "reference" and name == "kind":
        kind = code.split('"')[1]
        return ", ".join(name for name in REFERENCE_KINDS[kind].keys if name != "bound")
    key = TABLES.get(table, {}).get(name)
    if key is None:
        return None
    comment = f"{key.comment}: {key.limits}" if key.kind == "choice" else key.comment
    is_left_out = code.startswith("#") and key.otherwise
    return f"{comment}; {key.otherwise} if left out" if is_left_out else comment


def rewrite(page: str, starter: str) -> None:
    """Write the tables of the page and the comments of the starter file."""
    for path, write in ((Path(page), with_section), (Path(starter), with_comments)):
        path.write_text(write(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    rewrite(*sys.argv[1:])
