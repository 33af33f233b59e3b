"""Verbs that hand the controller to other tools: export c, ..."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import FOLDER, json_option


@click.group()
def export() -> None:
    """Export the controller to other tools.

    \b
    Example: certrack export c example1 --period 0.001 --out firmware
    """


@export.command()
@click.argument("file")
@click.option("--out", type=FOLDER, required=True, help="Folder for the files.")
@click.option("--real", type=click.Choice(["double", "float"]), default="double", show_default=True)
@click.option("--period", type=float, help="Sampling period, s; default: the file's.")
@json_option
def c(file: str, out: Path, real: str, period: float | None, as_json: bool) -> None:
    """Write the controller as C99, with its acceptance test.

    \b
    Example: certrack export c example1 --period 0.001 --real float --out firmware
    """
    from certrack import report
    from certrack.export.c import export as export_c
    from certrack.systemfile import load

    made = export_c(load(file), out, file, real=real, period=period)
    for note in made.notes:
        click.echo(f"certrack: note: {note}", err=True)
    if as_json:
        values = {"name": made.name, "files": [str(path) for path in made.files]}
        click.echo(report.to_json(values | {"notes": made.notes}))
        return
    for path in made.files:
        click.echo(f"{path} written")
    click.echo(f"Next: cd {out} && gcc {made.name}.c {made.name}_test.c -lm && ./a.out")
