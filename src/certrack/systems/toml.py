"""TOML text to tables, within limits of size and nesting.

``tomllib`` keeps about a kilobyte for every table and for every prefix of a dotted key, so a file
of 40 kB could fill gigabytes. A pass of regular expressions, each of which takes time in proportion
to the text, therefore measures the text first. A system file has three levels and some hundred
keys; the limits are far above that, and far below what would be felt.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

from certrack.core.errors import InputError
from certrack.core.rationals import decimal_float

#: Parts of a dotted key, and brackets within brackets. The deepest key of a system file has four.
MAX_PARTS, MAX_BRACKETS = 16, 16

#: Tables, lists and keys in all.
MAX_ENTRIES = 100_000

#: Characters of a text in quotes, and of a number or bare key. Formulas have at most 10,000.
MAX_TEXT, MAX_WORD = 1_000_000, 5_000

#: Comments and texts in quotes, as TOML has them; what is between them holds no quote.
_QUOTED = re.compile(
    r"""
      \#[^\n]*+
    | \"\"\"(?:[^"\\]++|\\.|"(?!""))*+\"{3,5}+
    | '''(?:[^']++|'(?!''))*+'{3,5}+
    | "(?:[^"\\\n]++|\\.)*+"
    | '[^'\n]*+'
    """,
    re.VERBOSE | re.DOTALL,
)

#: Characters of a line that a message quotes.
MAX_QUOTED = 60

#: What ends a key or a number; a run of other characters is looked at from its beginning only.
_ENDS = r",=\[\]{}\n"
_DOTTED = re.compile(rf"(?<![^{_ENDS}])(?:[^{_ENDS}.]*+\.){{{MAX_PARTS}}}")
_LONG_WORD = re.compile(rf"(?<![^\s{_ENDS}])[^\s{_ENDS}]{{{MAX_WORD + 1}}}")
_BRACKET = re.compile(r"[\[\]{}]")


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises
    ------
    InputError
        If it is no TOML, or is larger or more deeply nested than any system file; it names the line
        where that is known.
    """
    _check_extent(text)
    try:
        return tomllib.loads(text, parse_float=decimal_float)
    except (tomllib.TOMLDecodeError, ValueError) as problem:
        place = re.search(r"at line (\d+)", str(problem))
        if place is None:
            raise _refusal(f"is not TOML: {problem}", None) from None
        line = int(place[1])
        raise _refusal(f"is not TOML: {problem}: {_quoted(text, line)}", line) from None
    except RecursionError:
        raise _refusal("is not TOML: nested too deeply", None) from None


def _check_extent(text: str) -> None:
    """Refuse a text whose tables would not fit into a sane amount of memory."""

    def blank(match: re.Match[str]) -> str:
        quoted = match[0]
        if quoted[0] == "#":
            return ""
        if len(quoted) > MAX_TEXT:
            raise _at(text, match.start(), f"a text is longer than {MAX_TEXT} characters")
        return '"' + "\n" * quoted.count("\n")

    bare = _QUOTED.sub(blank, text)
    if dotted := _DOTTED.search(bare):
        raise _at(bare, dotted.start(), f"a key has more than {MAX_PARTS} dotted parts")
    if word := _LONG_WORD.search(bare):
        what = f"a number or name is longer than {MAX_WORD} characters"
        raise _at(bare, word.start(), what)
    if sum(map(bare.count, "=[{")) > MAX_ENTRIES:
        raise _refusal(
            f"is not TOML of a system: more than {MAX_ENTRIES} keys, tables and lists", None
        )
    depth = 0
    for bracket in _BRACKET.finditer(bare):
        depth = depth + 1 if bracket[0] in "[{" else max(0, depth - 1)
        if depth > MAX_BRACKETS:
            raise _at(bare, bracket.start(), f"brackets are nested deeper than {MAX_BRACKETS}")


def _at(text: str, position: int, what: str) -> InputError:
    return _refusal(f"is not TOML of a system: {what}", text.count("\n", 0, position) + 1)


def _quoted(text: str, line: int) -> str:
    """A line of the text for a message, and what is often wrong with it."""
    lines = text.splitlines()
    written = " ".join(lines[line - 1].split()) if line <= len(lines) else ""
    shown = written if len(written) <= MAX_QUOTED else f"{written[:MAX_QUOTED]}..."
    return (
        f"{shown!r}. A number begins with a digit (0.5, not .5); formulas and texts are in quotes"
    )


def _refusal(what: str, line: int | None) -> InputError:
    error = InputError("", what)
    error.line = line
    return error
