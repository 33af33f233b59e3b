"""What a notebook shows of each main object: tables, formulas, and the main picture."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from functools import singledispatch
from html import escape
from typing import Any

from matplotlib.figure import Figure

from certrack.certificates import Certificate, Certificates
from certrack.core.rounding import rounded_up
from certrack.plotting.main_picture import plot
from certrack.plotting.shared import style
from certrack.simulation.labels import metric_labels
from certrack.simulation.run import Run
from certrack.studies.ensembles.ensemble import Ensemble
from certrack.studies.margins import Margins
from certrack.systems.design import Design
from certrack.systems.system import System

#: Dots per inch of the pictures: sharp on a screen, and small enough for a notebook's file.
NOTEBOOK_DPI = 110

#: Entries of a quantile table, as a tally's summary names them.
SHOWN_QUANTILES = ("5%", "50%", "95%", "max")


@singledispatch
def html(result: Any) -> str:
    """The HTML of a result; its text where it is of no kind that is known here."""
    return f"<pre>{escape(repr(result))}</pre>"


@html.register
def _show_system(result: System) -> str:
    settings, implementation = result.settings, result.implementation
    design = result.design()
    rows = [
        ("states", ", ".join(result.plant.states)),
        ("law", f"{result.law.kind}, feed-forward order {design.coordinates.q}"),
        ("unknown parameters", str(result.plant.r)),
        ("error poles", ", ".join(f"{pole:.4g}" for pole in design.coordinates.poles) + " 1/s"),
        (
            "runs",
            "in continuous time"
            if implementation is None
            else f"sampled every {implementation.period:g} s",
        ),
        ("duration", f"{settings.duration:g} s"),
    ]
    return _page(result.title, _table((), rows), _formulas(design), _picture(plot(result)))


@html.register
def _show_design(result: Design) -> str:
    return _page(result.title, _formulas(result))


@html.register
def _show_run(result: Run) -> str:
    metrics = result.metrics.as_dict()
    labels = metric_labels(result.system.plant.units)
    rows: list[Sequence[object]] = [(v, metrics[k]) for k, v in labels.items()]
    trajectory = result.trajectory
    rows += [
        ("outcome", f"{result.outcome.name} at {trajectory.end:g} s"),
        ("integrator", f"{trajectory.method}, {len(trajectory.times) - 1} steps"),
    ]
    table, notes = _table(("metric", ""), rows), _list(result.notes)
    return _page(result.system.title, table, notes, _picture(plot(result)))


@html.register
def _show_certificates(result: Certificates) -> str:
    entries = [getattr(result, entry.name) for entry in fields(result)]
    rows = [
        (
            entry.kind,
            rounded_up(entry.bound, 4) if entry.exists else None,
            "exactly" if entry.verified else "no",
            entry.reason,
        )
        for entry in entries
        if isinstance(entry, Certificate)
    ]
    table = _table(("certificate", "limsup |e_1| <=", "verified", "note"), rows)
    premises = _list([str(premise) for premise in result.premises], "Resting on")
    return _page("Certificates", table, _picture(plot(result)), premises)


@html.register
def _show_ensemble(result: Ensemble) -> str:
    rows = []
    for name, label in metric_labels(result.system.plant.units).items():
        entries = result.statistics.metrics[name].summary()
        rows.append((label, *(entries[quantile] for quantile in SHOWN_QUANTILES)))
    table = _table(("metric", "5 %", "median", "95 %", "largest"), rows)
    facts = [f"{count} {name}" for name, count in sorted(result.statistics.outcomes.items())]
    violations = result.violations()
    if violations is None:
        facts.append(f"no limit: {result.limit_origin}")
    else:
        limit, origin = violations["limit"], violations["origin"]
        facts.append(f"{violations['count']} beyond the limit {limit:.5g} ({origin})")
    if result.statistics.worst:
        value, index = result.statistics.worst[0]
        facts.append(f"worst member {index}: tail error {value:.5g}")
    title = f"{result.system.title}: {result.members} members, seed {result.seed}"
    return _page(title, table, _list(facts), _picture(plot(result)))


@html.register
def _show_margins(result: Margins) -> str:
    rows = [
        (label, margin.within, margin.bounded, margin.exact)
        for label, margin in (
            ("longest period [s]", result.period),
            ("longest delay [s]", result.delay),
            ("lowest saturation", result.saturation),
        )
    ]
    table = _table(("margin", "within the error", "bounded", "exact edge"), rows)
    facts = [
        f"admitted tail error {result.error:.5g} ({result.origin})",
        f"{result.members} members tried at every value, not proven",
        f"delay and saturation at a period of {result.at:.4g} s",
    ]
    return _page("Margins", table, _list(facts), _picture(plot(result)))


def _page(title: str, *parts: str) -> str:
    head = f"<h4>{escape(title)}</h4>" if title else ""
    return f"<div>{head}{''.join(parts)}</div>"


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = [f"<thead><tr>{top}</tr></thead>"] if top else []
    lines.append("<tbody>")
    for name, *values in rows:
        cells = "".join(f"<td>{_cell(value)}</td>" for value in values)
        lines.append(f'<tr><th style="text-align:left">{escape(str(name))}</th>{cells}</tr>')
    return f"<table>{''.join(lines)}</tbody></table>"


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "&ndash;"
    if isinstance(value, float):
        return f"{value:.5g}" if math.isfinite(value) else "&infin;"
    return escape(str(value))


def _list(lines: Sequence[str], title: str = "") -> str:
    if not lines:
        return ""
    head = f"<p>{escape(title)}</p>" if title else ""
    return f"{head}<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _formulas(design: Design) -> str:
    """The formulas as display mathematics, which notebooks set by MathJax."""
    inside = design.latex.replace("align*", "aligned")
    return f"<div>$$\n{escape(inside, quote=False)}\n$$</div>"


def _picture(drawing: Figure) -> str:
    buffer = io.BytesIO()
    with style():
        drawing.savefig(buffer, format="png", dpi=NOTEBOOK_DPI, metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img style="max-width:100%" src="data:image/png;base64,{data}"/>'
