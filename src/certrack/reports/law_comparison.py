"""What is said of laws side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from certrack.core.rounding import printed_bound
from certrack.reports.tables import Table, short_number, table
from certrack.simulation.labels import labelled, metric_labels, unit_of_input, unit_of_output
from certrack.tuning.comparison.compare_laws import GAIN_FACTORS
from certrack.tuning.runs import WORSE

if TYPE_CHECKING:
    from certrack.tuning.comparison.compare_laws import LawComparison, LawFigures


def law_table(result: LawComparison, units: Sequence[str] | None) -> Table:
    """The figures, a column for each law."""
    y, u, labels = unit_of_output(units), unit_of_input(units), metric_labels(units)
    gains = [
        (labelled(f"tail error, input gain {100 * (f - 1):+.0f} %", y), i)
        for i, f in enumerate(GAIN_FACTORS)
    ]
    heads = [
        labels["tail_error"],
        labelled(f"worst of {result.member_count} members", y),
        labels["settling_time"],
        labelled("peak input, found over the box", u),
        labels["input_energy"],
        labels["input_variation"],
        "longest period that works [s]",
        *(label for label, _ in gains),
        labelled("certified error", y),
        "limits exceeded",
    ]
    columns = [_column(figures) for figures in result.laws]
    rows = [[head, *(column[i] for column in columns)] for i, head in enumerate(heads)]
    return table("", ["", *(figures.name for figures in result.laws)], rows, digits=4)


def _column(figures: LawFigures) -> list[object]:
    """The figures of one law; dashes where it has no working gains."""
    metrics = figures.metrics
    if not figures.works or metrics is None:
        return [None] * (8 + len(GAIN_FACTORS)) + [figures.why_not]
    lost = [value if math.isfinite(value) else "lost" for value in figures.at_gains]
    bound = printed_bound(figures.bound, 4) if math.isfinite(figures.bound) else None
    if bound is not None and figures.bound_is_continuous:
        bound += " (continuous)"
    return [
        metrics.tail_error,
        "lost" if figures.worst_member is None else figures.worst_member,
        metrics.settling_time,
        figures.peak_input,
        metrics.input_energy,
        metrics.input_variation,
        figures.longest_period,
        *lost,
        bound,
        ", ".join(figures.exceeded) or "none",
    ]


def law_notes(result: LawComparison) -> list[str]:
    """The limits, how gains were found, and what they are."""
    limits, drive = result.limits, result.system.implementation
    assert drive is not None
    lines = [
        f"sampled every {drive.period:g} s; limits: peak input <= {limits.peak_input:.5g} over the "
        f"box of starts, variation of input <= {limits.input_variation:.5g}, at most {WORSE:g} "
        f"times the tail error when held for {limits.period:g} s",
        f"gains of each law: smallest tail error of the file's run within the limits, about "
        f"{result.budget} evaluations, seed {result.seed}",
    ]
    for figures in result.laws:
        numbers = ", ".join(f"{name} = {_gain_text(v)}" for name, v in figures.gains().items())
        lines.append(f"{figures.name}: {figures.system.law.kind} law, {numbers}")
        if figures.works and math.isfinite(figures.bound):
            loop = "continuous loop, not of the sampled one"
            of = f", of the {loop}" if figures.bound_is_continuous else ""
            whose = f", {figures.bound_starts}" if figures.bound_starts else ""
            lines.append(f"  certified by {figures.bound_note}{of}{whose}")
        elif figures.works:
            lines.append(f"  no certified bound: {figures.bound_note}")
        else:
            lines.append(f"  {figures.why_not}")
    return lines


def _gain_text(value: object) -> str:
    value = getattr(value, "error", value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_gain_text, value))}]"
    return short_number(float(value), 5) if isinstance(value, (int, float)) else str(value)
