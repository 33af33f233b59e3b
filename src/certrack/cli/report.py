"""What the command line prints: tables for people, JSON for programs."""

from __future__ import annotations

import json
import math
import textwrap
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.table import Table

from certrack.core.number_texts import BOUND_TEXT_DIGITS as BOUND_TEXT_DIGITS
from certrack.core.number_texts import short_number as short_number

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from certrack.core.progress import Progress


def to_json(values: Any) -> str:
    """JSON with arrays as lists and missing numbers as null."""
    return json.dumps(_json_ready(values), indent=2, allow_nan=False)


def _json_ready(value: Any) -> Any:
    """The value with arrays as lists and numbers that JSON does not have as None."""
    if hasattr(value, "tolist"):  # an array or a number of NumPy
        return _json_ready(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _json_ready(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_ready(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


#: Longer words than this may be broken in a table.
LONGEST_WORD = 24


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 5
) -> Table:
    """A table of text and numbers; neither a number nor a word of a usual length is broken."""
    cells = [[_cell(value, digits) for value in row] for row in rows]
    room = console().width - 3 * len(columns) - 1
    heads = list(columns)
    if sum(max(map(len, column)) for column in zip(heads, *cells, strict=True)) > room:
        heads = [_broken(head, entries) for head, *entries in zip(heads, *cells, strict=True)]
    min_widths = [_longest_word(column) for column in zip(heads, *cells, strict=True)]
    padding = 1 if sum(min_widths) <= room else 0  # rather no blanks than a broken word
    room += 2 * (1 - padding) * len(columns)
    result = Table(
        title=title or None, title_justify="left", title_style="bold", padding=(0, padding)
    )
    for head, width in zip(heads, min_widths, strict=True):
        result.add_column(
            head, overflow="fold", min_width=width if sum(min_widths) <= room else None
        )
    for row in cells:
        result.add_row(*row)
    return result


def _longest_word(texts: Sequence[str]) -> int:
    return min(LONGEST_WORD, max(len(word) for text in texts for word in [*text.split(), ""]))


def _broken(head: str, entries: Sequence[str]) -> str:
    """The head of a column broken after words and hyphens, as narrow as its entries allow."""
    pieces = textwrap.wrap(head, 1, break_long_words=False)
    width = max(_longest_word(entries), *map(len, pieces), 1)
    return "\n".join(textwrap.wrap(head, width, break_long_words=False))


def _cell(value: object, digits: int) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return short_number(value, digits) if math.isfinite(value) else "-"
    return str(value)


def print_lines(lines: Iterable[str]) -> None:
    """Print lines; on a terminal, longer ones than its width are broken between words."""
    out = console()
    for line in lines:
        indent = line[: len(line) - len(line.lstrip())] + "  "
        wrapped = textwrap.wrap(
            line,
            out.width,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        click.echo("\n".join(wrapped) if out.is_terminal else line)


def console(*, error: bool = False) -> Console:
    """Console on standard output or standard error."""
    return Console(stderr=error, highlight=False, markup=False)


@contextmanager
def _bar(*fields: str) -> Iterator[Bar]:
    """Progress bar on standard error with further columns; silent where nobody watches."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar

    log = console(error=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Bar(
        *columns,
        *map(TextColumn, fields),
        TimeRemainingColumn(),
        console=log,
        transient=True,
        disable=not log.is_terminal,
    ) as bar:
        yield bar


@contextmanager
def progress(what: str, extreme: str = "worst") -> Iterator[Progress]:
    """Progress bar; yields the `progress` of a long call that looks for an extreme."""
    with _bar() as bar:
        task = bar.add_task(what, total=None)

        def advance(done: float, total: float | None, best: float | None, /) -> None:
            shown = what if best is None else f"{what}, {extreme} {best:.4g}"
            done = done if total is None else min(done, total)
            bar.update(task, completed=done, total=total, description=shown)

        yield advance


@contextmanager
def rate_progress(what: str) -> Iterator[Progress]:
    """Progress bar with rate and time left; yields the `progress` of a long call."""
    with _bar("{task.fields[rate]}") as bar:
        task = bar.add_task(what, total=None, rate="")
        start: tuple[float, float] | None = None

        def advance(done: float, total: float | None, _best: float | None, /) -> None:
            nonlocal start
            now = time.monotonic()
            start = start or (now, done)
            count, seconds = done - start[1], now - start[0]
            rate = f"{count / seconds:,.0f}/s" if count and seconds else ""
            bar.update(task, completed=done, total=total, rate=rate)

        yield advance
