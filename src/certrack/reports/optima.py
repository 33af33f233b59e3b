"""What is said of optimal trajectories and of the laws beside them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from certrack.reports.tables import Table, short_number, table
from certrack.simulation.labels import energy_unit, labelled, unit_of_input, unit_of_output
from certrack.studies.optimal.mesh_search import MINIMUM_CHANGE
from certrack.studies.optimal.optimal import LIMIT_ROUNDING

if TYPE_CHECKING:
    from certrack.studies.optimal.goal import Goal
    from certrack.studies.optimal.optimal import Optima, Optimum

#: What is minimised, as a column begins.
LEAST_TEXTS = {
    "squared_error": "least int e_1^2",
    "energy": "least int u^2",
    "peak": "least peak input",
    "time": "shortest time to y_d",
}

#: A limit, in words.
LIMIT_TEXTS = {"squared_error": "int e_1^2", "energy": "int u^2", "peak": "|u|"}


def optima_table(result: Optima, title: str = "") -> Table:
    """The law and the optima of its plant, a column each."""
    units = result.run.system.plant.units
    output, force = unit_of_output(units), unit_of_input(units)
    labels = {
        "squared_error": labelled("int e_1^2", energy_unit(output)),
        "energy": labelled("int u^2", energy_unit(force)),
        "peak": labelled("peak input", force),
        "time": "time [s]",
    }
    shown = [entry.cost if entry.converged else None for entry in result.optima]
    if not any(entry.goal.minimised == "time" for entry in result.optima):
        del labels["time"]
    rows: list[list[object]] = [
        ["limits", "", *(_limits_text(entry.goal) for entry in result.optima)],
        *(
            [label, getattr(result.law, name), *(getattr(cost, name, None) for cost in shown)]
            for name, label in labels.items()
        ),
        ["the law needs", "", *(_excess_text(result, entry) for entry in result.optima)],
    ]
    columns = ["", "law", *(LEAST_TEXTS[entry.goal.minimised] for entry in result.optima)]
    return table(title, columns, rows, digits=4)


def optima_notes(result: Optima) -> list[str]:
    """What the numbers are, and what is to be known of them."""
    lines = [
        f"over {result.horizon:g} s; an optimum knows plant, disturbance and reference beforehand, "
        "so no law does better from that start; found by a local search, not proven",
    ]
    if any(entry.goal.minimised == "time" for entry in result.optima):
        lines.append(
            "time: of the law until |e_1| stays in its band, of the optimum until y moves as y_d"
        )
    return lines + [line for entry in result.optima for line in _remarks(result, entry)]


def _excess_text(result: Optima, optimum: Optimum) -> str:
    excess = result.excess(optimum)
    return "-" if excess is None else f"{short_number(excess, 3)} times"


def _remarks(result: Optima, optimum: Optimum) -> Iterator[str]:
    goal, excess = _goal_text(optimum.goal), result.excess(optimum)
    if not optimum.converged:
        more = (
            "; a longer --time-limit or a shorter --horizon may help" if optimum.timed_out else ""
        )
        yield f"{goal}: none found: {optimum.reason}{more}"
        return
    if optimum.timed_out:
        yield f"{goal}: the time was over before the search: a longer --time-limit may find less"
    for name, limit in optimum.goal.limits.items():
        if getattr(result.law, name) > limit * (1 + LIMIT_ROUNDING):
            yield f"{goal}: the law exceeds {LIMIT_TEXTS[name]} <= {short_number(limit, 4)}"
    if optimum.smoothing:
        yield (
            f"{goal}: kinks are rounded over {100 * optimum.smoothing:g} % of the largest size of "
            "what they are taken of; jumps (dry friction) stay so in its cost, not in the law's"
        )
    if excess is not None and excess < 1.0:
        on = "such a mesh" + (" with kinks so rounded" if optimum.smoothing else "")
        yield f"{goal}: the law needs less: on {on} no better input was found"
    if optimum.mesh_error is not None and optimum.mesh_error > MINIMUM_CHANGE:
        yield (
            f"{goal}: still changed by {100 * optimum.mesh_error:.2g} % from mesh to mesh: more "
            "--elements would find less"
        )


def _goal_text(goal: Goal) -> str:
    limits = _limits_text(goal)
    return f"{LEAST_TEXTS[goal.minimised]} with {limits}" if limits else LEAST_TEXTS[goal.minimised]


def _limits_text(goal: Goal) -> str:
    limits = (
        f"{LIMIT_TEXTS[name]} <= {short_number(value, 4)}" for name, value in goal.limits.items()
    )
    return ", ".join(limits)
