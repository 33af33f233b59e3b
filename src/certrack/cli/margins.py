"""The verb that asks what a real drive may take away: margin."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import FOLDER, json_option


@click.command()
@click.argument("file")
@click.option(
    "--error",
    type=float,
    help="Admitted tail error, in the unit of the output x_1; default: the limit or certificate.",
)
@click.option("-n", "--members", type=click.IntRange(1, 100_000), default=64, show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**63), default=0, show_default=True)
@click.option("--plot", type=FOLDER, help="Folder for the picture of error against period.")
@json_option
def margin(
    file: str, error: float | None, members: int, seed: int, plot: Path | None, as_json: bool
) -> None:
    """Longest sampling period and delay, lowest saturation.

    Every value is tried on some members of the file's population; for the robust law on a linear
    plant the edge of stability is exact besides.

    \b
    Example: certrack margin dual-motor-lean --plot pictures
    """
    from certrack.cli import report
    from certrack.studies.margins import margins
    from certrack.systems.reader import load

    system = load(file)
    with report.count_progress("Margins") as advance:
        found = margins(system, error=error, members=members, seed=seed, progress=advance)
    if plot is not None:
        from certrack import plotting

        made = plotting.margin_figure(found, system.title, system.plant.units)
        plotting.save_figure(made, plot, "margin")
    if as_json:
        click.echo(report.to_json(found.summary()))
    else:
        click.echo(system.title or file)
        report.console().print(report.margin_table(found, system.plant.units))
        for line in report.margin_notes(found):
            click.echo(line)
