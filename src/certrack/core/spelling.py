"""Which known word a misspelt one was probably meant to be."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def closest(name: str, known: Iterable[str]) -> str:
    """The known word nearest to `name`, letters' case and order of its parts apart; empty if none.

    >>> closest("Sin", ["sin", "cos"]), closest("gain_input", ["input_gain"]), closest("q", ["tau"])
    ('sin', 'input_gain', '')
    """
    words = sorted(known)
    parts = sorted(name.lower().split("_"))
    turned = [word for word in words if sorted(word.lower().split("_")) == parts]
    near = difflib.get_close_matches(name, words, n=1)
    lowered = {word.lower(): word for word in words}
    near += [lowered[word] for word in difflib.get_close_matches(name.lower(), lowered, n=1)]
    return next(iter(turned + near), "")


def hint(name: str, known: Iterable[str]) -> str:
    """The question with which a remedy begins; empty if no known word is near."""
    word = closest(name, known)
    return f"Did you mean {word}? " if word else ""
