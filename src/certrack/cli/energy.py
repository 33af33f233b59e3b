"""The verb that asks where the energy of two motors goes: energy."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import (
    FOLDER,
    NEW_FILE,
    diagnose,
    json_option,
    keep_source,
    naming,
    options_named,
    tell_written,
)


@click.command()
@click.argument("file")
@click.option(
    "--share", type=float, help="Part of the input that goes to motor 1; default: the file's."
)
@click.option(
    "--damping",
    type=float,
    help="Command moved from motor 1 to motor 2 for each rad/s by which its shaft runs ahead; "
    "default: the file's.",
)
@click.option("--cycle", type=float, help="Length of a cycle, s; default: the reference's period.")
@click.option("--out", type=NEW_FILE, help="CSV file for the powers over time.")
@click.option("--plot", type=FOLDER, help="Folder for the picture: powers and balance.")
@json_option
def energy(
    file: str,
    share: float | None,
    damping: float | None,
    cycle: float | None,
    out: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Balance the energy of two motors over a run.

    For a file with [truth.motors]: what the source gives and gets back, copper losses of each
    motor, friction, stored energy and the brake chopper, in joules for the run and each cycle,
    integrated with the states. The file's way to share the input is compared with the even one and
    with the one of the least copper loss.

    \b
    Example: certrack energy dual-motor-physical --damping 0.05 --plot pictures
    """
    from certrack.cli import console
    from certrack.reports import energy as energy_report
    from certrack.studies.energy import energy as balance_energy
    from certrack.systems.reader import load

    system = load(file)
    if out is not None:
        keep_source(file, out)
    with (
        naming(file, "truth.motors", "truth.motors.stored", "truth.supply.resistance"),
        options_named(("share", "damping", "cycle")),
        console.progress("Energy, runs") as advance,
    ):
        result = balance_energy(system, share=share, damping=damping, cycle=cycle, progress=advance)
    written: list[Path] = []
    if plot is not None:
        from certrack import plotting

        figure = plotting.energy_figure(result, system.title)
        written += plotting.save_figure(figure, plot, "energy")
    if out is not None:
        from certrack.core.files import write_text

        write_text(out, result.csv())
    if as_json:
        click.echo(console.to_json(result.summary()))
    else:
        console.print_table(energy_report.energy_table(result, system.title or file))
        console.print_table(energy_report.motor_table(result))
        console.print_table(energy_report.split_table(result))
        console.print_lines(energy_report.energy_notes(result))
    tell_written(as_json, *written)
    if out is not None:
        tell_written(as_json, out)
    diagnose(result.run)
