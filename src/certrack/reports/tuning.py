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
    from certrack.tuning.measure import Measured
    from certrack.tuning.result import Tuned

#: A loop that is stable only below so many times its period is warned of.
PERIODS_FOR_COMFORT = 3.0


def tuned_table(result: Tuned, units: Sequence[str] | None) -> Table:
    """Before and after, side by side."""
    y, u, labels = unit_of_output(units), unit_of_input(units), metric_labels(units)
    peaks = result.before.peak_is, result.after.peak_is
    peak_is = FOUND if FOUND in peaks else result.after.peak_is
    entries = [
        (labelled("certified error", y), "certified"),
        (labelled("worst error found", y), "worst_found"),
        (labelled("tail error, simulated", y), "tail_error"),
        (labelled(f"peak input, {peak_is}", u), "peak_input"),
        (labels["input_energy"], "energy"),
        (labels["input_variation"], "input_variation"),
        (labelled("gain from noise to input", f"{u} per unit of the states" if u else ""), "noise"),
        ("longest stable period [s]", "period"),
    ]
    rows = [
        [label, _shown(result.before, name), _shown(result.after, name)] for label, name in entries
    ]
    return table("", ["", "before", "after"], rows)


def _shown(figures: Measured, name: str) -> object:
    value = getattr(figures, name)
    return printed_bound(value, 5) if name == "certified" else value


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
        shorter = active.limit in ("period", "delay margin")
        ease = f"10 % {'shorter' if shorter else 'more'} {active.limit}"
        share = 100 * abs(active.price)
        lines.append(
            f"active: {active.limit} {active.value:.5g}: {ease} "
            f"buys {share:.2g} % {name} at the margin"
        )
    return lines or ["no limit is active"]


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
    if result.objective == "error" and result.after.certified >= result.before.certified:
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
    certified = printed_bound(result.after.certified, 5)
    return [
        f"tuned by certrack {__version__} from {file}: {result.objective} optimised within",
        *(f"  {limit}" for limit in result.limits),
        f"seed {result.seed}, {result.programs} programs; limsup |e_1| certified {certified} "
        f"({printed_bound(result.before.certified, 5)} before)",
        *price_lines(result),
    ]


def _numbers(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_numbers, value))}]"
    return short_number(value, 6) if isinstance(value, float) else str(value)
