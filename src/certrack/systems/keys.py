"""Every key of the system file, and what is written from them.

The keys are those of the dataclass fields and reference kinds that they fill; here they are put in
the order of the file. ``python -m certrack.systems.keys PAGE STARTER`` writes the tables of the
page docs/system-file.md and the comments of starter.toml anew; ``make keys`` calls it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from certrack.core.keys import KIND_WORDS, Key, keys_of
from certrack.laws import LAWS, Law
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references.keys import FORMULA_KEYS, REFERENCE_KINDS
from certrack.systems.system import Settings, System


def _keys_below(owner: Any, below: str = "") -> dict[str, Key]:
    """Keys of a class that stand in its table, or in the named table below that."""
    keys: dict[str, Key] = {}
    for field, key in keys_of(owner).items():
        table, _, name = (key.path or field).rpartition(".")
        if table == below:
            keys[name] = key
    return keys


def law_keys(law: type[Law]) -> dict[str, Key]:
    """Keys of ``[law]`` for one law, a user's own among them."""
    kind = Key("choice", help="which law", choices=tuple(LAWS), required=True)
    undescribed = {
        entry.name: Key("any", required=entry.default is MISSING) for entry in fields(law)
    }
    return {"kind": kind, **undescribed, **keys_of(law)}


def reference_keys(kind: str) -> dict[str, Key]:
    """Keys of ``[reference]`` for one kind of reference."""
    choice = Key("choice", help="shape of y_d", choices=tuple(REFERENCE_KINDS), required=True)
    return {"kind": choice, **REFERENCE_KINDS[kind].keys}


#: Tables of the file and their keys. Where the keys depend on the kind, it stands in brackets.
TABLES: dict[str, dict[str, Key]] = {
    "": keys_of(System),
    "plant": _keys_below(Plant),
    "plant.ranges": _keys_below(Plant, "ranges"),
    "plant.uncertainty": _keys_below(Uncertainty),
    "truth": _keys_below(Truth),
    "reference": dict(FORMULA_KEYS),
    **{f"reference[{kind}]": reference_keys(kind) for kind in REFERENCE_KINDS},
    **{f"law[{kind}]": law_keys(law) for kind, law in LAWS.items()},
    "simulation": _keys_below(Settings),
    "implementation": _keys_below(Implementation),
    "ensemble": _keys_below(Population),
    "ensemble.reference": _keys_below(Population, "reference"),
}

#: Path -> key, e.g. ``"plant.chain"``, ``"law[adaptive].Gamma"``.
KEYS: dict[str, Key] = {
    f"{table}.{name}" if table else name: key
    for table, keys in TABLES.items()
    for name, key in keys.items()
}


def as_dicts() -> dict[str, dict[str, Any]]:
    """All keys in a form that JSON holds, for the forms of a designer."""
    return {path: key.as_dict() for path, key in KEYS.items()}


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
        title = f"### `[{table}]`" if table else "### Above the first table"
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
