"""What is said of runs and ensembles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from certrack.core.rounding import printed_bound
from certrack.reports.tables import BOUND_TEXT_DIGITS, Table, short_number, table
from certrack.simulation.labels import (
    labelled,
    metric_labels,
    move_labels,
    unit_of_output,
    with_unit,
)
from certrack.simulation.metrics import SETTLING_SHARE
from certrack.simulation.moves import MOVE_LABELS

if TYPE_CHECKING:
    from certrack.studies.ensembles.ensemble import Ensemble


def shared_units(units: Iterable[Sequence[str] | None]) -> Sequence[str] | None:
    """The units of several systems; None if they differ."""
    first, *others = units
    return first if all(other == first for other in others) else None


def metrics_table(
    summaries: Mapping[str, Mapping[str, Any]], units: Sequence[str] | None = None
) -> Table:
    """Metrics of one or several runs, a column each."""
    labels = metric_labels(units)
    rows = [
        [label, *(summary[key] for summary in summaries.values())] for key, label in labels.items()
    ]
    y = unit_of_output(units)
    bands = [summary.get("band") for summary in summaries.values()]
    rows.insert(1, [labelled("settled within", y), *bands])
    rows.append(["outcome", *(summary["outcome"] for summary in summaries.values())])
    rows.append(["integrator", *(summary["integrator"] for summary in summaries.values())])
    return table("", ["metric", *summaries], rows)


#: More moves than this are counted in a table, not shown.
SHOWN_MOVES = 12


def moves_table(moves: Sequence[Mapping[str, Any]], units: Sequence[str] | None = None) -> Table:
    """Metrics of each move, a row each; of many the first, and the largest of all."""
    rows = [[move[key] for key in MOVE_LABELS] for move in moves[:SHOWN_MOVES]]
    if len(moves) > SHOWN_MOVES:
        last = [
            max((m[key] for m in moves if m[key] is not None), default=None) for key in MOVE_LABELS
        ]
        rows.append([f"largest of {len(moves)}", "", "", "", *last[4:]])
    return table(f"moves{_within(moves, units)}", list(move_labels(units).values()), rows, digits=4)


def _within(moves: Sequence[Mapping[str, Any]], units: Sequence[str] | None) -> str:
    """The band that settling after a move refers to."""
    bands = {float(move["band"]) for move in moves if move.get("band") is not None}
    if not bands:
        return ""
    if len(bands) > 1:
        return f", settled within {100 * SETTLING_SHARE:g} % of each"
    return f", settled within {with_unit(short_number(bands.pop()), unit_of_output(units))}"


def ensemble_table(ensemble: Ensemble) -> Table:
    """Quantiles of every metric."""
    rows = []
    for key, label in metric_labels(ensemble.system.plant.units).items():
        entries = ensemble.statistics.metrics[key].summary()
        shown = [entries[name] for name in ("5%", "50%", "95%", "99%", "max")]
        rows.append([label, *shown, entries["missing"]])
    return table("", ["metric", "5%", "median", "95%", "99%", "largest", "none"], rows, digits=4)


def ensemble_notes(ensemble: Ensemble, file: str) -> list[str]:
    """Outcomes, violations and the worst member in words."""
    outcomes = ", ".join(f"{n} {name}" for name, n in sorted(ensemble.statistics.outcomes.items()))
    lines = [f"outcomes: {outcomes}", *_replaced_omega(ensemble)]
    unit = unit_of_output(ensemble.system.plant.units)
    unsettled = ensemble.statistics.metrics["settling_time"].missing
    if unsettled:
        lines.append(f"{unsettled} of {ensemble.members} members are never settled within the band")
    violations = ensemble.violations()
    if violations is None:
        lines.append(f"no limit: {ensemble.limit_origin}")
    else:
        inside = violations.get("started_inside")
        text = (
            f"tail error beyond {limit_text(violations['limit'], violations['origin'], unit)}: "
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
        f"worst member {index}: tail error {with_unit(f'{value:.5g}', unit)}; to replay it:",
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
    size = with_unit(f"{corners.errors[worst]:.5g}", unit_of_output(ensemble.system.plant.units))
    error = f"tail error {size}" if corners.lost == 0 else "lost"
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


def limit_text(limit: float, origin: str, unit: str = "") -> str:
    """A limit of the tail error and its origin; a certified bound is rounded up."""
    certified = "certifi" in origin
    number = printed_bound(limit, BOUND_TEXT_DIGITS) if certified else f"{limit:.5g}"
    return f"{with_unit(number, unit)} ({origin})"
