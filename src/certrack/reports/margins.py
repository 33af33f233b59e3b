"""What is said of the margins of an implementation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from certrack.core.rounding import printed_bound, rounded_down, rounded_up
from certrack.reports.runs import limit_text
from certrack.reports.tables import Table, short_number, table
from certrack.simulation.labels import unit_of_input

if TYPE_CHECKING:
    from certrack.studies.drift import Drift
    from certrack.studies.margins import Margin, Margins


def margin_table(margins: Margins, units: Sequence[str] | None) -> Table:
    """Margins side by side."""
    unit = unit_of_input(units)
    labels = {
        "longest period [s]": margins.period,
        "longest delay [s]": margins.delay,
        f"lowest saturation [+-{unit}]" if unit else "lowest saturation (+-)": margins.saturation,
    }
    sign = {label: "< " if m is margins.saturation else "> " for label, m in labels.items()}
    rows = [
        [
            label,
            _margin_text(m.within, m, margins.error, sign[label]),
            _margin_text(m.bounded, m, margins.bounded_error, sign[label]),
            m.exact,
        ]
        for label, m in labels.items()
    ]
    return table("", ["margin", "within the error", "bounded", "exact edge"], rows)


def _margin_text(value: float | None, margin: Margin, limit: float, sign: str) -> object:
    """A margin; with a sign in front where nothing tried failed, so that no edge was found."""
    if value is None or any(error > limit for error in margin.errors):
        return value
    return sign + short_number(value)


def margin_notes(margins: Margins) -> list[str]:
    """What the margins refer to, in words."""
    lines = [
        f"admitted tail error: {limit_text(margins.error, margins.origin)}; "
        f"{margins.members} members tried at every value, not proven",
        f"bounded: tail error up to {margins.bounded_error:.5g}, the largest |y_d| (or ten times "
        "the admitted one, where y_d is smaller than it)",
        f"delay and saturation at a period of {margins.at:.4g} s; the rest is as in the file",
    ]
    if margins.as_given is not None:
        within = "within" if margins.as_given <= margins.error else "BEYOND"
        lines.append(
            f"[implementation] as it stands: tail error {margins.as_given:.5g}, {within} it"
        )
    if margins.period.exact is not None:
        lines.append(
            "exact edge: nominal plant, no disturbance; beyond it the loop is unstable, even where "
            "a run ends before that shows"
        )
    if any(error <= limit for error, limit in _last_errors(margins)):
        lines.append("> and <: nothing failed up to the end of the range searched, no edge")
    return lines


def drift_table(drift: Drift) -> Table:
    """The largest range of each constant."""
    rows = []
    for entry in drift.constants:
        part = "-" if entry.part is None else f"{rounded_down(100 * entry.part, 4)} %"
        more = "> " if entry.unlimited else ""
        rows.append(
            [
                entry.name,
                short_number(entry.nominal),
                f"[{', '.join(map(short_number, entry.file))}]",
                "none" if entry.low is None else f"{more}+-{part}",
                _range_text(entry.low, entry.high),
                printed_bound(entry.bound if entry.low is not None else None, RANGE_DIGITS),
            ]
        )
    columns = ["constant", "nominal", "in the file", "may drift by", "that is", "certified there"]
    return table("", columns, rows, digits=RANGE_DIGITS)


def drift_notes(drift: Drift) -> list[str]:
    """What the ranges refer to, in words."""
    if drift.reason:
        return [f"how far constants may drift: not searched: {drift.reason}"]
    proven = "each proven" if drift.verified else "not verified, for the file breaks a premise,"
    lines = [
        f"admitted limsup |e_1| of the continuous loop: "
        f"{limit_text(drift.error, drift.origin)}; each constant by itself, the others as "
        f"in the file; {proven} as printed",
        *(
            f"  {entry.name}: a little more: {entry.reason}"
            for entry in drift.constants
            if entry.reason
        ),
    ]
    together = drift.together
    if together is None:
        return lines
    if not together.ranges:
        return [*lines, f"together: no common scale of the ranges serves: {together.reason}"]
    ranges = ", ".join(f"{name} {_range_text(low, high)}" for name, low, high in together.ranges)
    scale = ("> " if together.unlimited else "") + rounded_down(together.scale, RANGE_DIGITS)
    bound = printed_bound(together.bound, RANGE_DIGITS)
    return [*lines, f"together: all half widths times {scale}: {ranges}; certified {bound}"]


def _range_text(low: float | None, high: float | None) -> str:
    """A range, its ends rounded inward."""
    if low is None or high is None:
        return "-"
    return f"[{rounded_up(low, RANGE_DIGITS)}, {rounded_down(high, RANGE_DIGITS)}]"


#: Digits of a range.
RANGE_DIGITS = 5


def _last_errors(margins: Margins) -> Iterator[tuple[float, float]]:
    """The largest error of each search, with each of the limits."""
    for margin in (margins.period, margins.delay, margins.saturation):
        for limit in (margins.error, margins.bounded_error):
            yield max(margin.errors), limit
