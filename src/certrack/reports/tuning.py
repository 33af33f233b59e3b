"""What is said of a search for gains, also in the file that it writes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from certrack.core.rounding import printed_bound
from certrack.core.version import __version__
from certrack.reports.tables import Table, short_number, table
from certrack.simulation.labels import labelled, metric_labels, unit_of_input, unit_of_output
from certrack.tuning.measure import FOUND
from certrack.tuning.result import tuned_numbers

if TYPE_CHECKING:
    from certrack.tuning.result import ActiveLimit, Tuned

#: Of which loop a figure is.
AS_RUN, WITHOUT_DRIVE = ", as the drive runs it", ", continuous law"

#: A loop that is stable only below so many times its period is warned of.
PERIODS_FOR_COMFORT = 3.0


def tuned_table(result: Tuned, units: Sequence[str] | None) -> Table:
    """Before and after, side by side."""
    y, u, labels = unit_of_output(units), unit_of_input(units), metric_labels(units)
    peaks = result.before.peak_is, result.after.peak_is
    peak_is = FOUND if FOUND in peaks else result.after.peak_is
    entries = [
        (labelled("tail error, simulated", y), "tail_error"),
        (labelled(f"peak input, {peak_is}", u), "peak_input"),
        (labels["input_energy"], "energy"),
        (labels["input_variation"], "input_variation"),
        (labelled("gain from noise to input", f"{u} per unit of the states" if u else ""), "noise"),
        ("longest stable period [s]", "period"),
    ]
    rows: list[list[object]] = []
    for proven, worst in tuned_bounds(result):
        rows.append([labelled(proven[0], y), *(printed_bound(bound, 5) for bound in proven[1:])])
        rows.append([labelled(worst[0], y), *worst[1:]])
    for label, name in entries:
        rows.append([label, getattr(result.before, name), getattr(result.after, name)])
    return table("", ["", "before", "after"], rows)


#: A label, and the figures before and after.
Labelled = tuple[str, float | None, float | None]


def tuned_bounds(result: Tuned) -> list[tuple[Labelled, Labelled]]:
    """What is certified and what is found, before and after, for each loop that it is of.

    Two loops where one design is certified as the drive runs it and the other is not: a bound of
    the one beside a bound of the other would compare nothing.

    Parameters
    ----------
    result : Tuned

    Returns
    -------
    list of pairs
        The certified error and the worst that is found, each with its label.
    """
    error_label, worst_label = "certified error", "worst error found"
    before, after = result.before, result.after
    if before.continuous is None or after.continuous is None:
        kinds = {figures.of_drive for figures in (before, after) if figures.method}
        of = ""
        if result.system.implementation is not None and len(kinds) == 1:
            of = AS_RUN if kinds.pop() else WITHOUT_DRIVE
        return [
            (
                (error_label + of, before.certified, after.certified),
                (worst_label, before.worst_found, after.worst_found),
            )
        ]
    run = [
        (figures.certified, figures.worst_found) if figures.of_drive else (None, None)
        for figures in (before, after)
    ]
    pairs = [
        (figures.certified, figures.worst_found)
        for figures in (before.continuous, after.continuous)
    ]
    return [
        ((error_label + of, x[0], y[0]), (worst_label + of, x[1], y[1]))
        for of, (x, y) in ((AS_RUN, run), (WITHOUT_DRIVE, pairs))
    ]


def tuned_notes(result: Tuned) -> list[str]:
    """The law, the limits, and what they cost."""
    law = result.system.law
    gains = tuned_numbers(result.system)
    lines = [f"law: {law.kind}, feedforward = {law.feedforward}"]
    lines += [f"  {name} = {_numbers(value)}" for name, value in gains.items()]
    lines.append(f"limits: {', '.join(result.limits) or 'none'}")
    lines += price_lines(result)
    per_start = ", ".join(map(str, result.programs_per_start))
    lines.append(
        f"{result.programs} programs ({per_start} a start), seed {result.seed}; certified by "
        f"{result.after.method or 'nothing'}"
    )
    for name, figures in (("before", result.before), ("after", result.after)):
        if figures.starts:
            lines.append(f"the certified error {name} holds {figures.starts}")
    if result.front is not None:
        lines += _front_lines(result)
    return [*lines, *result.notes]


def price_lines(result: Tuned) -> list[str]:
    """The active limits, each with what a tenth more of it buys."""
    what = {"error": "error", "peak": "peak input", "energy": "energy", "period": "longer period"}
    name = what[result.objective]
    lines = []
    for active in result.active:
        share = 100 * abs(active.price)
        lines.append(
            f"active: {active.limit} {active.value:.5g}: {eased(active)} "
            f"buys {share:.2g} % {name} at the margin"
        )
    return lines or ["no limit is active"]


def eased(active: ActiveLimit) -> str:
    """Which way a limit eases: the period and the margin of the delay are limited from below."""
    shorter = active.limit in ("period", "delay margin")
    return f"10 % {'shorter' if shorter else 'more'} {active.limit}"


def _front_lines(result: Tuned) -> list[str]:
    assert result.front is not None
    head = f"front, {result.front.limit}: {result.front.objective} (estimates, not certified)"
    points = []
    for p in result.front.points:
        best = "nothing keeps all limits" if p.objective is None else f"{p.objective:.5g}"
        points.append(f"  {p.limit:.5g}: {best}")
    return [head, *points]


def warnings(result: Tuned) -> list[str]:
    """What should worry: an interruption, a bound that is no better, a tight period."""
    lines = []
    if result.stopped:
        lines.append("stopped before all was searched and measured: this is the best so far")
    lines += result.broken
    before, after = result.certified
    if result.objective == "error" and after >= before:
        lines.append("the certified error is not better than the file's, within these limits")
    if result.after.method and result.after.continuous_only:
        lines.append(
            "what is certified is the continuous law, not the loop as [implementation] runs it: "
            + result.after.continuous_only
        )
    if not math.isfinite(result.after.certified):
        lines.append("nothing is verified of the tuned design")
    drive, edge = result.system.implementation, result.after.period
    if drive is not None and edge is not None and edge < PERIODS_FOR_COMFORT * drive.period:
        lines.append(
            f"the loop is stable up to a period of {edge:.4g} s, less than three times the file's"
        )
    return lines


def remarks(result: Tuned, file: str) -> list[str]:
    """How the law was made, as comments of the tuned file."""
    before, after = (printed_bound(bound, 5) for bound in result.certified)
    return [
        f"tuned by certrack {__version__} from {file}: {result.objective} optimised within",
        *(f"  {limit}" for limit in result.limits),
        f"seed {result.seed}, {result.programs} programs; limsup |e_1| certified {after} "
        f"({before} before)",
        *price_lines(result),
    ]


def _numbers(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_numbers, value))}]"
    return short_number(value, 6) if isinstance(value, float) else str(value)
