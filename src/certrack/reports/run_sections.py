"""Sections of a dossier about what was simulated: none of it proves anything."""

from __future__ import annotations

import tomllib

from certrack.core.rounding import printed_bound
from certrack.plotting.ensembles import ensemble_figures
from certrack.plotting.margins import drift_figure, margin_figure
from certrack.plotting.overviews import overview
from certrack.plotting.shared import as_svg
from certrack.reports.evidence import DesignEvidence
from certrack.reports.falsification import drive_lines, falsification_summary, falsification_table
from certrack.reports.margins import drift_notes, drift_table, margin_notes, margin_table
from certrack.reports.runs import ensemble_notes, ensemble_table, metrics_table, moves_table
from certrack.reports.sections import Picture, Section
from certrack.reports.tables import table
from certrack.systems.writer import to_text


def response_section(evidence: DesignEvidence) -> Section:
    """The response from the file's own start."""
    run = evidence.run
    summary, units = run.summary(), evidence.system.plant.units
    tables = [metrics_table({"run": summary}, units)]
    if summary["moves"]:
        tables.append(moves_table(summary["moves"], units))
    drawing = overview({"": run}, "", certified={"": evidence.certificates})
    return Section(
        key="response",
        title="Response",
        lines=(
            f"Simulated for {evidence.system.settings.duration:g} s with the truth that the file "
            "states; this proves nothing.",
            *run.notes,
        ),
        tables=tuple(tables),
        pictures=(Picture("overview", "Response from the start of the file", as_svg(drawing)),),
    )


def falsification_section(evidence: DesignEvidence) -> Section | None:
    """The worst admissible case that was found."""
    key, title = "falsification", "Worst case found"
    if evidence.falsification is None:
        return _refused(evidence, key, title)
    values = falsification_summary(evidence.falsification)
    lines = [
        f"worst |e_1| found in {values['runs']} runs of the continuous law: "
        f"{values['worst_error']:.6g}; certified: {printed_bound(values['certified'])}"
    ]
    if values["alarm"] is not None:
        lines.append(f"ALARM: a run is beyond the verified bound: {values['alarm_reason']}")
    if values["drive"] is not None:
        lines += drive_lines(values["drive"])
    lines += [f"not tried: {what}: {why}" for what, why in values["left_out"].items()]
    lines.append(f"To repeat it: {evidence.command('falsify', ' --out worst.toml')}")
    return Section(key, title, tuple(lines), tables=(falsification_table(values["certificates"]),))


def ensemble_section(evidence: DesignEvidence) -> Section | None:
    """Quantiles over the file's population, and fan charts."""
    key, title = "ensemble", "Ensemble"
    if evidence.ensemble is None:
        return _refused(evidence, key, title)
    pictures = [
        Picture(f"ensemble-{name}", f"Ensemble: {name.replace('-', ' ')}", as_svg(drawing))
        for name, drawing in ensemble_figures(evidence.ensemble).items()
    ]
    head = f"{evidence.ensemble.members} members, seed {evidence.ensemble.seed}"
    return Section(
        key=key,
        title=title,
        lines=(head, *(line.strip() for line in ensemble_notes(evidence.ensemble, evidence.file))),
        tables=(ensemble_table(evidence.ensemble),),
        pictures=tuple(pictures),
    )


def margins_section(evidence: DesignEvidence) -> Section | None:
    """How far period, delay, saturation and constants may go."""
    key, title = "margins", "Margins of the implementation"
    margins = evidence.margins
    if margins is None:
        return _refused(evidence, key, title)
    units = evidence.system.plant.units
    tables, lines = [margin_table(margins, units)], margin_notes(margins)
    pictures = [
        Picture(
            "margin", "Tail error at the values tried", as_svg(margin_figure(margins, "", units))
        )
    ]
    if margins.drift is not None:
        lines += [line.strip() for line in drift_notes(margins.drift)]
        if margins.drift.constants:
            tables.append(drift_table(margins.drift))
            drawing = drift_figure(margins.drift, "")
            pictures.append(Picture("drift", "How far constants may drift", as_svg(drawing)))
    return Section(key, title, tuple(lines), tables=tuple(tables), pictures=tuple(pictures))


def drive_section(evidence: DesignEvidence) -> Section | None:
    """The drive, and the size of the controller in C."""
    if evidence.system.implementation is None:
        return None
    entries = tomllib.loads(to_text(evidence.system))["implementation"]
    rows = [[key, value] for key, value in entries.items()]
    lines = []
    if evidence.code is not None:
        states = len(evidence.code.members)
        size = len(evidence.code.header) + len(evidence.code.source)
        lines.append(
            f"The controller in C: {size} characters of C99 in one header and one source, "
            f"{states} real numbers of state, no memory taken while it runs."
        )
        lines.append(f"To write it with its acceptance test: {evidence.command('export c')}")
    elif "code" in evidence.refusals:
        lines.append(f"no controller in C: {evidence.refusals['code']}")
    return Section(
        "drive", "Drive", tuple(lines), tables=(table("implementation", ["key", "value"], rows),)
    )


def _refused(evidence: DesignEvidence, key: str, title: str) -> Section | None:
    """A section that says why there is nothing; None where it was left out."""
    reason = evidence.refusals.get(key)
    return None if reason is None else Section(key, title, (f"not computed: {reason}",))
