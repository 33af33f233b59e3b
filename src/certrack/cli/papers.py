"""Verbs about published results: reproduce."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import FOLDER, json_option


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

    Figures 2 to 4 are drawn, and every claim is set beside what is measured.

    \b
    Example: certrack reproduce --out reproduction
    """
    from dataclasses import asdict

    from certrack.cli import report
    from certrack.papers import liu2025
    from certrack.plotting import save_figure

    with report.progress("Reproducing") as advance:
        results = liu2025.reproduce(advance)
    for name, figure in results.figures.items():
        save_figure(figure, out, name)
    summaries = {name: run.summary() for name, run in results.runs.items()}
    values = {
        "claims": [asdict(claim) for claim in results.claims],
        "runs": summaries,
        "bounds": results.bounds,
        "figures": [str(out / f"{name}.png") for name in results.figures],
    }
    if as_json:
        click.echo(report.to_json(values))
        return
    rows = [[c.where, c.statement, c.measured, c.verdict] for c in results.claims]
    console = report.console()
    console.print(report.metrics_table(summaries))
    bounds = [[name, *entry.values()] for name, entry in results.bounds.items()]
    columns = ["limsup |e_1|", *next(iter(results.bounds.values()))]
    console.print(report.table("Certified, falsified and simulated error", columns, bounds))
    console.print(report.table("Claims", ["where", "claim", "measured", "verdict"], rows))
    click.echo(f"{len(results.figures)} figures (PNG and SVG) in {out}")
