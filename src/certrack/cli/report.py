"""What the command line prints: tables for people, JSON for programs."""

from __future__ import annotations

import json
import math
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console, Group
from rich.table import Table

from certrack.certificates import Certificate, Certificates

if TYPE_CHECKING:
    from rich.progress import Progress

    from certrack.studies.ensembles.ensemble import Ensemble
    from certrack.studies.margins import Margins


def to_json(values: Any) -> str:
    """JSON with arrays as lists and missing numbers as null."""
    return json.dumps(_plain(values), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


#: Longer words than this may be broken in a table.
LONGEST_WORD = 24


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 5
) -> Table:
    """A table of text and numbers; neither a number nor a word of a usual length is broken."""
    made = Table(title=title or None, title_justify="left", title_style="bold")
    cells = [[_cell(value, digits) for value in row] for row in rows]
    room = console().width - 3 * len(columns) - 1
    heads = list(columns)
    if sum(max(map(len, both)) for both in zip(heads, *cells, strict=True)) > room:
        heads = [_broken(head, entries) for head, *entries in zip(heads, *cells, strict=True)]
    least = [_longest_word(both) for both in zip(heads, *cells, strict=True)]
    for head, width in zip(heads, least, strict=True):
        made.add_column(head, overflow="fold", min_width=width if sum(least) <= room else None)
    for row in cells:
        made.add_row(*row)
    return made


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
        return _number(value, digits) if math.isfinite(value) else "-"
    return str(value)


def _number(value: float, digits: int) -> str:
    """A number with a short exponent, if any.

    >>> _number(804940.0, 4), _number(0.00012344, 4), _number(0.5, 4)
    ('8.049e5', '1.234e-4', '0.5')
    """
    text = f"{value:.{digits}g}" if abs(value) >= 1e-3 or not value else f"{value:.{digits - 1}e}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}" if mark else text


def console(*, error: bool = False) -> Console:
    """Console on standard output or standard error."""
    return Console(stderr=error, highlight=False, markup=False)


@contextmanager
def _bar(*more: str) -> Iterator[Progress]:
    """Progress bar on standard error with further columns; silent where nobody watches."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    log = console(error=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(
        *columns,
        *map(TextColumn, more),
        TimeRemainingColumn(),
        console=log,
        transient=True,
        disable=not log.is_terminal,
    ) as bar:
        yield bar


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int, float], None]]:
    """Progress bar; yields a function of the work done and the best so far."""
    worst = 0.0
    with _bar() as bar:
        task = bar.add_task(what, total=total)

        def advance(done: int, value: float) -> None:
            nonlocal worst
            worst = max(worst, value)
            bar.update(task, completed=min(done, total), description=f"{what}, worst {worst:.4g}")

        yield advance


@contextmanager
def rate_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Progress bar with rate and time left; yields a function of the work done and in all."""
    with _bar("{task.fields[rate]}") as bar:
        task = bar.add_task(what, total=None, rate="")
        begun: tuple[float, int] | None = None

        def advance(done: int, total: int) -> None:
            nonlocal begun
            now = time.monotonic()
            begun = begun or (now, done)
            fresh, spent = done - begun[1], now - begun[0]
            rate = f"{fresh / spent:,.0f}/s" if fresh and spent else ""
            bar.update(task, completed=done, total=total, rate=rate)

        yield advance


@contextmanager
def count_progress(what: str) -> Iterator[Callable[[str, int], None]]:
    """Counter of work whose end is not known; yields a function of what is done and how often."""
    with _bar() as bar:
        task = bar.add_task(what, total=None)

        def advance(part: str, done: int) -> None:
            bar.update(task, completed=done, description=f"{what}: {part}")

        yield advance


@contextmanager
def share_progress(what: str) -> Iterator[Callable[[float], None]]:
    """Progress bar of a share of the work; yields a function of it."""
    with _bar() as bar:
        task = bar.add_task(what, total=100)
        yield lambda share: bar.update(task, completed=int(100 * share))


METRIC_ROWS = {
    "settling_time": "settling time [s]",
    "tail_error": "tail error",
    "rms_error": "RMS error",
    "integral_abs_error": "integral of |e_1|",
    "peak_input": "peak input",
    "input_energy": "input energy",
    "input_variation": "variation of input",
}


def metrics_table(summaries: Mapping[str, Mapping[str, Any]]) -> Group:
    """Metrics of one or several runs, one column each, below each other where there are many."""
    names, beside = list(summaries), max(1, (console().width - 20) // 15)
    parts = (names[i : i + beside] for i in range(0, len(names), beside))
    return Group(*(_metrics_table({name: summaries[name] for name in part}) for part in parts))


def _metrics_table(summaries: Mapping[str, Mapping[str, Any]]) -> Table:
    rows = [
        [label, *(summary[key] for summary in summaries.values())]
        for key, label in METRIC_ROWS.items()
    ]
    rows.append(["outcome", *(summary["outcome"] for summary in summaries.values())])
    rows.append(["integrator", *(summary["integrator"] for summary in summaries.values())])
    return table("", ["metric", *summaries], rows)


def ensemble_table(found: Ensemble) -> Table:
    """Quantiles of every metric."""
    rows = []
    for key, label in METRIC_ROWS.items():
        entries = found.statistics.metrics[key].summary()
        shown = [entries[name] for name in ("5%", "50%", "95%", "99%", "max")]
        rows.append([label, *shown, entries["missing"]])
    return table("", ["metric", "5%", "median", "95%", "99%", "largest", "none"], rows, digits=4)


def ensemble_notes(found: Ensemble, file: str) -> list[str]:
    """Outcomes, violations and the worst member in words."""
    outcomes = ", ".join(f"{n} {name}" for name, n in sorted(found.statistics.outcomes.items()))
    lines = [f"outcomes: {outcomes}"]
    unsettled = found.statistics.metrics["settling_time"].missing
    if unsettled:
        lines.append(f"{unsettled} of {found.members} members are never settled within the band")
    violations = found.violations()
    if violations is None:
        lines.append(f"no limit: {found.limit_origin}")
    else:
        text = (
            f"tail error beyond {violations['limit']:.5g} ({violations['origin']}): "
            f"{violations['count']} of {found.members} members"
        )
        if violations["interval"] is not None:
            low, high = violations["interval"]
            text += f", probability within [{low:.3g}, {high:.3g}] (95 %, Clopper-Pearson)"
        lines.append(text)
    value, index = found.statistics.worst[0]
    lines.append(
        f"worst member {index}: tail error {value:.5g}; replay: "
        f"certrack simulate {file} --member {index} --seed {found.seed}"
    )
    return lines


KINDS = ("published", "corrected", "rate", "semidefinite", "cascade")


def certificates_summary(found: Certificates) -> dict[str, Any]:
    """All certificates, ready for JSON; a bound that does not exist is null."""

    def one(certificate: Certificate) -> dict[str, Any]:
        return {
            "bound": certificate.bound,
            "alpha": certificate.alpha,
            "delta": certificate.delta,
            "verified": certificate.verified,
            "reason": certificate.reason,
        }

    return {
        **{kind: one(getattr(found, kind)) for kind in KINDS},
        "verified": found.best.verified,
        "critical_strength": {
            "published": found.critical_published,
            "semidefinite": found.critical_semidefinite,
        },
        "tube": None
        if found.tube is None
        else {"start": found.tube.start, "floor": found.tube.floor, "alpha": found.tube.alpha},
        "assumptions": list(found.best.assumptions),
    }


def certificates_table(found: Certificates) -> Table:
    """Bounds side by side."""
    notes = {
        "published": "the paper's; its last step is not valid for every gain",
        "corrected": "with rho2",
        "rate": "V' <= -alpha V + Delta",
        "semidefinite": "best Lyapunov function",
        "cascade": "e_n first, then e_1 with e_n as bounded input",
    }
    rows = []
    for kind in KINDS:
        entry: Certificate = getattr(found, kind)
        checked = "exactly" if entry.verified else "-"
        text = notes[kind] if entry.exists else entry.reason
        rows.append([kind, entry.bound if entry.exists else None, checked, text])
    return table("limsup |e_1| <=", ["certificate", "bound", "verified", "note"], rows)


def certificates_notes(found: Certificates) -> list[str]:
    """Critical strengths, tube and assumptions in words."""
    if not found.best.exists:
        return []
    lines = [
        f"critical strength (common scale of tau): published {found.critical_published:.4g}, "
        f"semidefinite {found.critical_semidefinite:.4g}"
    ]
    if found.tube is not None:
        level = 1.1 * found.semidefinite.bound
        lines.append(
            f"tube from x0: |e_1| <= {float(found.tube(0.0)):.4g} at t = 0, within 10 % of the "
            f"bound after {found.tube.settling_time(level):.4g} s"
        )
    return [*lines, "resting on:", *(f"  {line}" for line in found.best.assumptions)]


def margin_table(found: Margins, units: Sequence[str] | None) -> Table:
    """Margins side by side."""
    unit = units[-1] if units and units[-1] not in ("", "1") else ""
    labels = {
        "longest period [s]": found.period,
        "longest delay [s]": found.delay,
        f"lowest saturation [+-{unit}]" if unit else "lowest saturation (+-)": found.saturation,
    }
    rows = [[label, m.within, m.bounded, m.exact] for label, m in labels.items()]
    return table("", ["margin", "within the error", "bounded", "exact edge"], rows)


def margin_notes(found: Margins) -> list[str]:
    """What the margins refer to, in words."""
    lines = [
        f"admitted tail error: {found.error:.5g} ({found.origin}); {found.members} members tried "
        "at every value, not proven",
        f"delay and saturation at a period of {found.at:.4g} s; the rest is as in the file",
    ]
    if found.as_given is not None:
        within = "within" if found.as_given <= found.error else "BEYOND"
        lines.append(f"[implementation] as it stands: tail error {found.as_given:.5g}, {within} it")
    if found.period.exact is not None:
        lines.append("exact edge: nominal plant, no disturbance; all eigenvalues inside below it")
    for name in ("period", "delay", "saturation"):
        if getattr(found, name).unlimited:
            lines.append(f"{name}: nothing failed within the range searched")
    return lines
