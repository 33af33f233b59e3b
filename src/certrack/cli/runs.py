"""Verbs that simulate: simulate, compare."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import FOLDER, diagnose, draw, json_option


@click.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="NetCDF file.")
@click.option("--samples", type=click.IntRange(2, 10_000_000), help="Equidistant times in --out.")
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG and SVG).")
@click.option("--integrator", type=click.Choice(["auto", "taylor", "scipy", "implicit"]))
@click.option("--tolerance", type=float, help="Of the integrator, e.g. 1e-9.")
@json_option
def simulate(
    file: str,
    out: Path | None,
    samples: int | None,
    plot: Path | None,
    integrator: str | None,
    tolerance: float | None,
    as_json: bool,
) -> None:
    """Simulate one run and measure it.

    \b
    Example: certrack simulate example1 --plot pictures --out run.nc
    """
    from certrack import report
    from certrack.simulation import simulate as run_system
    from certrack.systemfile import load

    if samples is not None and out is None:
        raise click.UsageError("--samples needs --out", click.get_current_context())
    system = load(file)
    changes = {"integrator": integrator, "tolerance": tolerance}
    run = run_system(system, **{name: v for name, v in changes.items() if v is not None})
    if out is not None:
        run.save(out, samples)
    if plot is not None:
        draw({Path(file).stem: run}, plot, system.title)
    summary = run.summary()
    if as_json:
        click.echo(report.to_json(summary))
    else:
        click.echo(system.title or file)
        report.console().print(report.metrics_table({Path(file).stem: summary}))
    diagnose(run)


@click.command()
@click.argument("files", nargs=-1, required=True)
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG and SVG).")
@json_option
def compare(files: tuple[str, ...], plot: Path | None, as_json: bool) -> None:
    """Simulate several systems and set their metrics side by side.

    \b
    Example: certrack compare example1 example1-classic
    """
    from certrack import report
    from certrack.simulation import simulate as run_system
    from certrack.systemfile import load

    systems = {file: load(file) for file in files}
    runs = {file: run_system(system) for file, system in systems.items()}
    if plot is not None:
        draw(runs, plot, "")
    summaries = {file: run.summary() for file, run in runs.items()}
    if as_json:
        click.echo(report.to_json(summaries))
    else:
        report.console().print(report.metrics_table(summaries))
    for run in runs.values():
        diagnose(run)
