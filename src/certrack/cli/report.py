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
import numpy as np
from rich.console import Console, Group
from rich.table import Table

from certrack.core.rounding import printed_bound
from certrack.simulation.metrics import METRIC_LABELS
from certrack.simulation.moves import MOVE_LABELS

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from certrack.core.progress import Progress
    from certrack.studies.ensembles.ensemble import Ensemble


def to_json(values: Any) -> str:
    """JSON with arrays as lists and missing numbers as null."""
    return json.dumps(_json_ready(values), indent=2, allow_nan=False)


def _json_ready(value: Any) -> Any:
    """The value with arrays as lists and numbers that JSON does not have as None."""
    if isinstance(value, np.ndarray):
        return _json_ready(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _json_ready(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_ready(entry) for entry in value]
    if isinstance(value, np.generic):
        return _json_ready(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


#: Longer words than this may be broken in a table.
LONGEST_WORD = 24


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 5
) -> Table:
    """A table of text and numbers; neither a number nor a word of a usual length is broken."""
    result = Table(title=title or None, title_justify="left", title_style="bold")
    cells = [[_cell(value, digits) for value in row] for row in rows]
    room = console().width - 3 * len(columns) - 1
    heads = list(columns)
    if sum(max(map(len, column)) for column in zip(heads, *cells, strict=True)) > room:
        heads = [_broken(head, entries) for head, *entries in zip(heads, *cells, strict=True)]
    min_widths = [_longest_word(column) for column in zip(heads, *cells, strict=True)]
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


def short_number(value: float, digits: int = 5) -> str:
    """A number with a short exponent, if any.

    >>> [short_number(value, 4) for value in (804940.0, 0.00012344, 0.5)]
    ['8.049e5', '1.234e-4', '0.5']
    """
    text = f"{value:.{digits}g}" if abs(value) >= 1e-3 or not value else f"{value:.{digits - 1}e}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}" if mark else text


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


#: Letters that the labels of the metrics and the numbers of one run need in a table.
LABEL_WIDTH, RUN_WIDTH = 20, 15


def metrics_table(summaries: Mapping[str, Mapping[str, Any]]) -> Group:
    """Metrics of one or several runs, one column each, below each other where there are many."""
    names = list(summaries)
    count = max(1, (console().width - LABEL_WIDTH) // RUN_WIDTH)
    groups = (names[i : i + count] for i in range(0, len(names), count))
    return Group(*(_metrics_table({name: summaries[name] for name in group}) for group in groups))


def _metrics_table(summaries: Mapping[str, Mapping[str, Any]]) -> Table:
    rows = [
        [label, *(summary[key] for summary in summaries.values())]
        for key, label in METRIC_LABELS.items()
    ]
    rows.append(["outcome", *(summary["outcome"] for summary in summaries.values())])
    rows.append(["integrator", *(summary["integrator"] for summary in summaries.values())])
    return table("", ["metric", *summaries], rows)


#: More moves than this are counted in a table, not shown.
SHOWN_MOVES = 12


def moves_table(moves: Sequence[Mapping[str, Any]]) -> Table:
    """Metrics of each move, a row each; of many the first, and the largest of all."""
    rows = [[move[key] for key in MOVE_LABELS] for move in moves[:SHOWN_MOVES]]
    if len(moves) > SHOWN_MOVES:
        last = [
            max((m[key] for m in moves if m[key] is not None), default=None) for key in MOVE_LABELS
        ]
        rows.append([f"largest of {len(moves)}", "", "", "", *last[4:]])
    return table("moves", list(MOVE_LABELS.values()), rows, digits=4)


def ensemble_table(ensemble: Ensemble) -> Table:
    """Quantiles of every metric."""
    rows = []
    for key, label in METRIC_LABELS.items():
        entries = ensemble.statistics.metrics[key].summary()
        shown = [entries[name] for name in ("5%", "50%", "95%", "99%", "max")]
        rows.append([label, *shown, entries["missing"]])
    return table("", ["metric", "5%", "median", "95%", "99%", "largest", "none"], rows, digits=4)


def ensemble_notes(ensemble: Ensemble, file: str) -> list[str]:
    """Outcomes, violations and the worst member in words."""
    outcomes = ", ".join(f"{n} {name}" for name, n in sorted(ensemble.statistics.outcomes.items()))
    lines = [f"outcomes: {outcomes}", *_replaced_omega(ensemble)]
    unsettled = ensemble.statistics.metrics["settling_time"].missing
    if unsettled:
        lines.append(f"{unsettled} of {ensemble.members} members are never settled within the band")
    violations = ensemble.violations()
    if violations is None:
        lines.append(f"no limit: {ensemble.limit_origin}")
    else:
        inside = violations.get("started_inside")
        text = (
            f"tail error beyond {limit_text(violations['limit'], violations['origin'])}: "
            f"{violations['count']} of {ensemble.members if inside is None else inside} members"
        )
        if inside is not None:
            text += (
                f" that start where no limit of the input is met, and {violations['others']} of "
                f"{ensemble.members - inside} others"
            )
        if violations["interval"] is not None:
            low, high = violations["interval"]
            text += f", probability within [{low:.3g}, {high:.3g}] (95 %, Clopper-Pearson)"
        lines.append(text)
    value, index = ensemble.statistics.worst[0]
    lines += [
        f"worst member {index}: tail error {value:.5g}; to replay it:",
        f"  certrack simulate {file} --member {index} --seed {ensemble.seed}",
    ]
    return [*lines, *_corner_lines(ensemble, file)]


def _corner_lines(ensemble: Ensemble, file: str) -> list[str]:
    """What the corners of the ranges gave."""
    from certrack.studies.ensembles.corners import MAX_RANGES, ranges_of

    corners = ensemble.corners
    if corners is None:
        too_many = len(ranges_of(ensemble.system)) > MAX_RANGES
        return [f"corners of plant.ranges: not run, of more than {MAX_RANGES}"] if too_many else []
    worst = corners.worst
    values = ", ".join(f"{name} = {v:.5g}" for name, v in corners.constants[worst].items())
    beyond = "" if corners.beyond is None else f", {corners.beyond} beyond the limit"
    counts = f"{corners.lost} of {len(corners.errors)} lost{beyond}"
    error = f"tail error {corners.errors[worst]:.5g}" if corners.lost == 0 else "lost"
    return [
        f"corners of plant.ranges, apart from the members: worst {worst} ({values}): {error}; "
        f"{counts}; to replay it:",
        f"  certrack simulate {file} --corner {worst} --seed {ensemble.seed}",
    ]


def _replaced_omega(ensemble: Ensemble) -> list[str]:
    """Say where the members have other disturbances than the file's."""
    disturbance = ensemble.system.varied.disturbance
    omega = ensemble.system.truth.omega or ()
    if disturbance == "file" or not any(w.expr != 0 for w in omega):
        return []
    return [
        f"disturbances: random admissible ones ({disturbance}) in the place of truth.omega; "
        'ensemble.disturbance = "file" keeps it'
    ]


#: Digits of a bound in tables and sentences.
BOUND_TEXT_DIGITS = 5


def limit_text(limit: float, origin: str) -> str:
    """A limit of the tail error and its origin; a certified bound is rounded up."""
    certified = "certifi" in origin
    number = printed_bound(limit, BOUND_TEXT_DIGITS) if certified else f"{limit:.5g}"
    return f"{number} ({origin})"
