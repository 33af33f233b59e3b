"""What the command line prints: tables for people, JSON for programs."""

from __future__ import annotations

import json
import math
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import click

from certrack.cli.progress_lines import progress_lines, working

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar

    from certrack.core.progress import Progress
    from certrack.reports.tables import Table


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


def print_table(content: Table, *, ruled: bool = False) -> None:
    """Print a table; neither a number nor a word of a usual length is broken.

    `ruled`: with lines between its rows.
    """
    from rich.table import Table as RichTable

    heads = list(content.columns)
    room = console().width - 3 * len(heads) - 1
    columns = list(zip(heads, *content.rows, strict=True))
    if sum(max(map(len, column)) for column in columns) > room:
        heads = [_broken(head, entries) for head, *entries in columns]
        columns = list(zip(heads, *content.rows, strict=True))
    min_widths = [_longest_word(column) for column in columns]
    padding = 1 if sum(min_widths) <= room else 0  # rather no blanks than a broken word
    room += 2 * (1 - padding) * len(heads)
    result = RichTable(
        title=content.title or None,
        title_justify="left",
        title_style="bold",
        padding=(0, padding),
        show_lines=ruled,
    )
    for head, width in zip(heads, min_widths, strict=True):
        result.add_column(
            head, overflow="fold", min_width=width if sum(min_widths) <= room else None
        )
    for row in content.rows:
        result.add_row(*row)
    console().print(result)


#: Letters that the first column and one of the others need in a table of many columns.
LABEL_WIDTH, COLUMN_WIDTH = 28, 15


def print_wide_table(content: Table) -> None:
    """Print a table of a column for each of many things, in parts below each other."""
    from certrack.reports.tables import Table

    count = max(1, (console().width - LABEL_WIDTH) // COLUMN_WIDTH)
    for i in range(1, len(content.columns), count):
        part = slice(i, i + count)
        rows = tuple((row[0], *row[part]) for row in content.rows)
        print_table(Table(content.title, (content.columns[0], *content.columns[part]), rows))


def _longest_word(texts: Sequence[str]) -> int:
    return min(LONGEST_WORD, max(len(word) for text in texts for word in [*text.split(), ""]))


def _broken(head: str, entries: Sequence[str]) -> str:
    """The head of a column broken after words and hyphens, as narrow as its entries allow."""
    pieces = textwrap.wrap(head, 1, break_long_words=False)
    width = max(_longest_word(entries), *map(len, pieces), 1)
    return "\n".join(textwrap.wrap(head, width, break_long_words=False))


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
    from rich.console import Console

    return Console(stderr=error, highlight=False, markup=False)


@contextmanager
def _bar(*fields: str) -> Iterator[Bar]:
    """Progress bar on standard error with further columns."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Bar(
        *columns,
        *map(TextColumn, fields),
        TimeRemainingColumn(),
        console=console(error=True),
        transient=True,
    ) as bar:
        yield bar


@contextmanager
def progress(
    what: str,
    extreme: str = "worst",
    then: str = "",
    at: Callable[[float], str] | None = None,
) -> Iterator[Progress]:
    """Progress bar, or lines where there is no terminal; yields the `progress` of a long call.

    Parameters
    ----------
    what, extreme : str
        What is counted, and what the extreme is called that is looked for.
    then : str
        What goes on when all is counted.
    at : callable, optional
        Names what is at work when so much is done.
    """
    if not console(error=True).is_terminal:
        with progress_lines(what, extreme, then, at) as advance:
            yield advance
        return
    with _bar() as bar:
        task = bar.add_task(what, total=None)

        def advance(done: float, total: float | None, best: float | None, /) -> None:
            parts = [what] if best is None else [what, f"{extreme} {best:.4g}"]
            shown = ", ".join([*parts, *filter(None, [working(then, at, done, total)])])
            done = done if total is None else min(done, total)
            bar.update(task, completed=done, total=total, description=shown)

        yield advance


class Phases:
    """Progress of a call whose parts follow each other: each has its bar when it first reports."""

    def __init__(self, bars: ExitStack) -> None:
        self._bars = bars
        self._shown: tuple[str, Progress] | None = None

    def phase(
        self,
        what: str,
        extreme: str = "worst",
        then: str = "",
        at: Callable[[float], str] | None = None,
    ) -> Progress:
        """The `progress` of a part; its arguments are those of :func:`progress`."""

        def advance(done: float, total: float | None, best: float | None, /) -> None:
            if self._shown is None or self._shown[0] != what:
                self._bars.close()
                self._shown = what, self._bars.enter_context(progress(what, extreme, then, at))
            self._shown[1](done, total, best)

        return advance


@contextmanager
def phases() -> Iterator[Phases]:
    """The bars of a call whose parts follow each other."""
    with ExitStack() as bars:
        yield Phases(bars)


@contextmanager
def rate_progress(what: str) -> Iterator[Progress]:
    """Progress bar with rate and time left; yields the `progress` of a long call."""
    if not console(error=True).is_terminal:
        with progress_lines(what, "worst") as advance_line:
            yield advance_line
        return
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
