"""The verb that asks what a real drive may take away: margin."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import FOLDER, MEMBER_SEED, json_option, naming, note_engine, tell_written


@click.command()
@click.argument("file")
@click.option(
    "--error",
    type=float,
    help="Admitted tail error, in the unit of the output x_1; default: the file's limit, or else "
    "the certified bound.",
)
@click.option(
    "-n",
    "--members",
    type=click.IntRange(1, 100_000),
    default=64,
    show_default=True,
    help="Number of members on which every value is tried.",
)
@click.option(
    "--seed", type=MEMBER_SEED, default=0, show_default=True, help="Seed of the ensemble."
)
@click.option(
    "--plot",
    type=FOLDER,
    help="Folder for the pictures: error against period, delay and saturation; drift of constants.",
)
@json_option
def margin(
    file: str, error: float | None, members: int, seed: int, plot: Path | None, as_json: bool
) -> None:
    """Find the limits of period, delay, saturation and constants.

    These are the longest period and delay and the lowest saturation at which the tail error stays
    admissible. Every value is tried on members of the file's ensemble, which proves nothing. For
    the robust law on a linear plant the exact edge of stability is computed too.

    Where constants have ranges, it is also found how far each may drift: the largest symmetric
    range with the admitted error, one by one and all together. These are proven, for the continuous
    loop. Without --error the file's limit is admitted there, or else 1.5 times the certified bound.

    \b
    Example: certrack margin dual-motor-lean --plot pictures
    """
    from certrack.cli import console
    from certrack.reports import margins as margin_report
    from certrack.studies.margins import margins
    from certrack.systems.reader import load

    system = load(file)
    note_engine()
    with naming(file, "margin"), console.progress("Margins, values tried") as advance:
        result = margins(system, error=error, members=members, seed=seed, progress=advance)
    pictures: list[Path] = []
    if plot is not None:
        from certrack import plotting

        figure = plotting.margin_figure(result, system.title, system.plant.units)
        pictures = plotting.save_figure(figure, plot, "margin")
        if result.drift is not None and result.drift.constants:
            figure = plotting.drift_figure(result.drift, system.title)
            pictures += plotting.save_figure(figure, plot, "margin-drift")
    if as_json:
        click.echo(console.to_json(result.summary()))
    else:
        click.echo(system.title or file)
        console.print_table(margin_report.margin_table(result, system.plant.units))
        console.print_lines(margin_report.margin_notes(result))
        if result.drift is not None:
            if result.drift.constants:
                console.print_table(margin_report.drift_table(result.drift))
            console.print_lines(margin_report.drift_notes(result.drift))
    tell_written(as_json, *pictures)
