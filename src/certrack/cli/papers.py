"""Verbs about published results: reproduce."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from certrack.cli.base import FOLDER, json_option

if TYPE_CHECKING:
    from certrack.papers.liu2025 import Claim, Reproduction


@click.command()
@click.option(
    "--out",
    type=FOLDER,
    default=Path("reproduction"),
    show_default=True,
    help="Folder for the figures.",
)
@json_option
def reproduce(out: Path, as_json: bool) -> None:
    """Reproduce the paper's figures and check its claims.

    Figures 1 to 4 are drawn, those of the examples twice: as the paper describes them and in
    detail. Every claim is set beside what is measured, and judged: it holds, differs, is ambiguous
    or not testable.

    \b
    Example: certrack reproduce --out reproduction
    """
    from dataclasses import asdict

    from certrack.cli import console
    from certrack.papers import liu2025
    from certrack.papers.liu2025.drawing import servo_diagram
    from certrack.plotting import save_figure

    log = console.console(error=True)
    save_figure(servo_diagram(), out, "figure-1")  # a folder that cannot be written: said at once
    with log.status("Reproducing") as status:
        results = liu2025.reproduce(tell=status.update)
        for name, figure in results.figures.items():
            status.update(f"Writing {name}")
            save_figure(figure, out, name)
    if as_json:
        values = {
            "claims": [asdict(claim) for claim in results.claims],
            "observations": [asdict(observation) for observation in results.observations],
            "runs": {name: run.summary() for name, run in results.runs.items()},
            "bounds": results.bounds,
            "figures": [str(out / f"{name}.png") for name in results.figures],
        }
        click.echo(console.to_json(values))
        return
    print_reproduction(results)
    click.echo(f"{len(results.figures)} figures (PDF, PNG and SVG) in {out}")


def print_reproduction(results: Reproduction) -> None:
    """Metrics, bounds, claims and observations as tables."""
    from certrack.cli.console import print_table, print_wide_table
    from certrack.reports.runs import metrics_table
    from certrack.reports.tables import table

    print_wide_table(metrics_table({n: run.summary() for n, run in results.runs.items()}))
    kinds = next(iter(results.bounds.values()))
    bounds = [[kind, *(entry[kind] for entry in results.bounds.values())] for kind in kinds]
    columns = ["limsup |e_1|", *results.bounds]
    print_table(table("Certified, falsified and simulated error", columns, bounds))
    rows = [[_claim_text(claim), claim.verdict] for claim in results.claims]
    claims = table("Claims", ["place, claim, measure and value", "verdict"], rows)
    notes = [[f"{note.where}: {note.text}"] for note in results.observations]
    observations = table("Observations of ours", ["place, and what was measured"], notes)
    for content in (claims, observations):
        print_table(content, ruled=True)
    counts = Counter(claim.verdict for claim in results.claims)
    click.echo(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))


def _claim_text(claim: Claim) -> str:
    """A claim, how it was measured, what came out, and our criterion, below each other."""
    lines = [
        f"{claim.where}: {claim.statement}",
        f"measure: {claim.measure}",
        f"value: {claim.measured}",
    ]
    if claim.criterion:
        lines.append(f"criterion of ours: {claim.criterion}")
    return "\n".join(lines)
