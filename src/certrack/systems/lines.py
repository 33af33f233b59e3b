"""On which line of a TOML text a key stands, for messages.

``tomllib`` gives values without their places. This scanner follows the structure only: table
headers, dotted and quoted keys, lists over several lines, inline tables. It takes the text to be
TOML (the loader has read it), and never fails on one that is not.
"""

from __future__ import annotations

import re

_TOKEN = re.compile(
    r"""
      (?P<blank>[ \t\r]+|\#[^\n]*)
    | (?P<newline>\n)
    | (?P<string>\"\"\"(?:[^"\\]++|\\.|"(?!""))*+\"{3,5}+|'''.*?'{3,5}+
                |"(?:[^"\\\n]++|\\.)*+"|'[^'\n]*+')
    | (?P<mark>[\[\]{}=,.])
    | (?P<bare>[^\s\#"'\[\]{}=,.]+|.)
    """,
    re.VERBOSE | re.DOTALL,
)

#: What a list or inline table is made of, where only its end is looked for.
_INSIDE = re.compile(
    r"""[^\[\]{}"'\#]++|\#[^\n]*+|(?P<open>[\[{])|(?P<close>[\]}])
      | \"\"\"(?:[^"\\]++|\\.|"(?!""))*+\"{3,5}+|'''.*?'{3,5}+|"(?:[^"\\\n]++|\\.)*+"|'[^'\n]*+'""",
    re.VERBOSE | re.DOTALL,
)


def line_of(text: str, key: str) -> int | None:
    """Line of a key as messages write it, e.g. ``"plant.regressor[1]"``, counted from 1.

    If it is not there, the line of the innermost table, list or key around it; None if that is
    the file itself.
    """
    if not key:
        return None
    scanner = _Scanner(text, key)
    try:
        scanner.scan()
    except RecursionError:  # nested deeper than anything a system file can mean
        return None
    return scanner.line_of_key


class _Scanner:
    """One pass over the text that remembers the place of the key, or of what is around it."""

    def __init__(self, text: str, key: str) -> None:
        self.text, self.key = text, key
        self.length_of_match = 0
        self.line_of_key: int | None = None
        self.position, self.line = 0, 1
        self.kind, self.word = "newline", "\n"
        self.advance()

    def advance(self) -> None:
        """Go to the next token that is neither blank nor comment; its kind is empty at the end."""
        self.line += self.word.count("\n") if self.position else 0
        while match := _TOKEN.match(self.text, self.position):
            self.position = match.end()
            self.kind, self.word = str(match.lastgroup), match[0]
            if self.kind != "blank":
                return
        self.kind, self.word = "", ""

    def note(self, path: str, *, header: bool = False) -> None:
        """This path begins on this line; its own header says so better than one below it."""
        around = self.key == path or self.key.startswith((f"{path}.", f"{path}["))
        if around and len(path) >= self.length_of_match + (not header):
            self.length_of_match, self.line_of_key = len(path), self.line

    def scan(self) -> None:
        """Read the whole text."""
        table, tables_of_list = "", dict[str, int]()
        while self.kind:
            if self.word == "[" and self.kind == "mark":
                self.advance()
                is_list = self.word == "["
                table = self.dotted_key("")
                if is_list:
                    tables_of_list[table] = tables_of_list.get(table, -1) + 1
                    table = f"{table}[{tables_of_list[table]}]"
                self.note(table, header=True)
                while self.kind not in ("newline", ""):
                    self.advance()
            elif self.kind in ("bare", "string"):
                self.value(self.dotted_key(table))
            else:
                self.advance()

    def dotted_key(self, table: str) -> str:
        """Read a key up to its ``=`` or ``]``; note it and the tables that its dots name."""
        path = table
        while self.kind not in ("newline", "") and self.word not in ("=", "]"):
            if self.kind in ("bare", "string"):
                name = self.word.strip("\"'") if self.kind == "string" else self.word
                path = f"{path}.{name}" if path else name
                self.note(path)
            self.advance()
        if self.word == "=":
            self.advance()
        return path

    def value(self, path: str) -> None:
        """Read a value, and note the entries of its lists and inline tables."""
        opening = self.word if self.kind == "mark" else ""
        if opening not in ("[", "{"):
            while self.kind not in ("newline", "") and not self.at(",]}"):
                self.advance()
            return
        if not self.key.startswith((f"{path}[", f"{path}.")):
            self.skip_brackets()
            return
        self.advance()
        index = 0
        while self.kind and not self.at("]}"):
            if self.kind == "newline":
                self.advance()
            elif self.at(","):
                index += 1
                self.advance()
            elif opening == "[":
                self.note(f"{path}[{index}]")
                self.value(f"{path}[{index}]")
            else:
                self.value(self.dotted_key(path))
        self.advance()

    def skip_brackets(self) -> None:
        """Go behind the bracket that closes the current one."""
        depth, start = 1, self.position
        while depth and (match := _INSIDE.match(self.text, self.position)):
            depth += (match["open"] is not None) - (match["close"] is not None)
            self.position = match.end()
        self.line += self.text.count("\n", start, self.position)
        self.advance()

    def at(self, marks: str) -> bool:
        """Whether one of the marks is the current token."""
        return self.kind == "mark" and self.word in marks
