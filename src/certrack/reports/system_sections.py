"""Sections of a dossier about what is given, and about the law."""

from __future__ import annotations

from typing import Any

from certrack.reports.evidence import DesignEvidence
from certrack.reports.sections import Section, ShownFormula
from certrack.reports.tables import Table, short_number, table
from certrack.systems.formulas import plant_as_latex, plant_as_text
from certrack.systems.system import System


def plant_section(evidence: DesignEvidence) -> Section:
    """The plant's equations, and what is uncertain in them."""
    system = evidence.system
    formulas = map(ShownFormula, plant_as_latex(system), plant_as_text(system))
    tables = [_states(system), _uncertain_terms(system), _constants(system)]
    return Section(
        key="plant",
        title="Plant",
        lines=(f"The output {system.plant.states[0]} is to follow y_d(t).",),
        formulas=tuple(formulas),
        tables=tuple(entry for entry in tables if entry.rows),
    )


def _states(system: System) -> Table:
    plant = system.plant
    units = plant.units or ("",) * (plant.n + 1)
    rows = [
        [name, unit or "-", x0]
        for name, unit, x0 in zip(plant.states, units, system.settings.x0, strict=False)
    ]
    return table("states", ["state", "unit", "start x0"], rows)


def _uncertain_terms(system: System) -> Table:
    plant = system.plant
    u = plant.uncertainty
    rows = []
    for k, tau in enumerate(u.tau):
        if tau:
            text = str(u.bound[k]) if u.bound else ""
            parts = (
                [text]
                if text
                else _parts_of_bound(u.gamma[k], u.beta[k], f"S_{k + 1} x" if u.S else "x")
            )
            if u.Delta is not None and any(u.Delta[k]):
                parts.append("Delta |x|")
            rows.append([f"w_{k + 1}", tau, " + ".join(parts) or "0"])
    return table("uncertain terms, of which only bounds are known", ["term", "tau", "|w| <="], rows)


def _parts_of_bound(gamma: float, beta: float, size: str) -> list[str]:
    """What of gamma ||x|| + beta is not zero."""
    growing = [f"{short_number(gamma)} ||{size}||"] if gamma else []
    return growing + ([short_number(beta)] if beta else [])


def _constants(system: System) -> Table:
    plant = system.plant
    rows: list[list[object]] = []
    ranges = {name: (low, high) for name, low, high in plant.constant_ranges}
    for name, value in plant.constants:
        rows.append([name, value.text, _interval(ranges.get(name))])
    unknown = [(f"g_{plant.n}", plant.input_gain, plant.input_gain_range)]
    thetas = plant.theta or [None] * plant.r
    theta_ranges = plant.theta_range or [None] * plant.r
    unknown += [
        (f"theta_{k + 1}", value, interval)
        for k, (value, interval) in enumerate(zip(thetas, theta_ranges, strict=True))
    ]
    rows += [
        [name, "unknown" if value is None else value.text, _interval(interval)]
        for name, value, interval in unknown
    ]
    return table("constants", ["constant", "value", "range"], rows)


def _interval(ends: tuple[Any, Any] | None) -> str:
    return "-" if ends is None else f"[{ends[0]}, {ends[1]}]"


def law_section(evidence: DesignEvidence) -> Section:
    """The control law as formulas, and its gains."""
    design = evidence.system.design()
    latex = [
        line.strip().removesuffix(r"\\").replace("&=", "=")
        for line in design.latex.splitlines()[1:-1]
    ]
    ends = str(design).splitlines()[len(design.formulas) :]
    return Section(
        key="law",
        title="Law",
        lines=(
            f"Kind {evidence.system.law.kind}, with feed-forward of the derivatives of y_d up to "
            f"order {design.coordinates.q}.",
        ),
        formulas=tuple(map(ShownFormula, latex, design.formulas)),
        code="\n".join(ends).strip(),
    )
