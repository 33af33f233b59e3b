"""What to write instead of what is no formula: the usual slips, recognised in the text."""

from __future__ import annotations

import ast
import keyword
import re

from certrack.core.errors import shorten

#: Signs of other keyboards, and what the language has for them.
OTHER_SIGNS = {"\N{MINUS SIGN}": "-", "\N{MULTIPLICATION SIGN}": "*", "\N{MIDDLE DOT}": "*"}
OTHER_SIGNS |= {"\N{SUPERSCRIPT TWO}": "**2", "\N{SUPERSCRIPT THREE}": "**3"}

_NUMBER = r"(?<![\w.])(?>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_PRODUCTS = (
    re.compile(rf"({_NUMBER})\s*((?:[A-Za-z_]\w*)?\(|[A-Za-z_]\w*)"),
    re.compile(r"([A-Za-z_]\w*)\s+(\w+)"),
    re.compile(r"(\))\s*(\w+|\()"),
)
_DECIMAL_COMMA = re.compile(r"(?<![\w.])(\d+),(\d+)(?![\w.])")


def syntax_remedy(text: str) -> str:
    """The remedy for a text that is no expression; empty if the slip is not known.

    >>> syntax_remedy("2t"), syntax_remedy("sin(t")
    ('Write 2*t', 'Close the bracket')
    """
    if not text.strip():
        return "Write 0 for nothing"
    for sign, written in OTHER_SIGNS.items():
        if sign in text:
            return f"Write {written} for {sign}"
    depth = 0
    for char in text:
        depth += (char == "(") - (char == ")")
        if depth < 0:
            return "A bracket is closed that was not opened"
    if depth:
        return "Close the bracket"
    return _product(text) or decimal_comma(text)


def node_remedy(node: ast.AST, text: str) -> str:
    """The remedy for a part of an expression that formulas do not have; empty if not known."""
    if isinstance(node, ast.BitXor):
        return "Write ** for powers"
    if isinstance(node, ast.Tuple):
        return decimal_comma(text)
    return _product(text) if isinstance(node, ast.Call) else ""


def decimal_comma(text: str) -> str:
    """The remedy where a comma stands between two numbers; empty if none does.

    >>> decimal_comma("0,5*t")
    'Write a decimal point, not a comma: 0.5'
    """
    slip = _DECIMAL_COMMA.search(text)
    if slip is None:
        return ""
    return f"Write a decimal point, not a comma: {shorten(f'{slip[1]}.{slip[2]}')}"


def _product(text: str) -> str:
    """The remedy where a sign of multiplication is left out."""
    for pattern in _PRODUCTS:
        for first, second in pattern.findall(text):
            if not (keyword.iskeyword(first) or keyword.iskeyword(second)):
                first = "(...)" if first == ")" else first
                second = f"{second}...)" if second.endswith("(") else second
                return f"Write {shorten(first)}*{shorten(second)}"
    return ""
