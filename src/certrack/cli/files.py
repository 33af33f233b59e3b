"""Verbs about systems: list, new, design."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import NEW_FILE, json_option


@click.command("list")
@json_option
def list_systems(as_json: bool) -> None:
    """List the shipped systems.

    \b
    Example: certrack list
    """
    from certrack.cli import console
    from certrack.reports.tables import table
    from certrack.systems.shipped import catalog

    systems = catalog()
    if as_json:
        click.echo(console.to_json(systems))
    else:
        console.print_table(table("", ["name", "title"], list(systems.items())))
        click.echo("To start from one of them: certrack new FILE.toml --from NAME")


@click.command()
@click.argument("name", type=NEW_FILE)
@click.option(
    "--from", "shipped", metavar="SYSTEM", help="Copy this shipped system, see certrack list."
)
@json_option
def new(name: Path, shipped: str | None, as_json: bool) -> None:
    """Write a commented system file NAME to start from.

    The general one shows every table of a continuous loop; dual-motor-drive has encoders, delay
    and limits, and flexible-joint has tolerances of a data sheet.

    \b
    Example: certrack new drive.toml --from dual-motor-drive
    """
    from certrack.cli import console
    from certrack.core.errors import InputError
    from certrack.core.files import write_text
    from certrack.systems.shipped import shipped_names, starter

    if not name.name:
        raise click.UsageError("NAME must be a file name", click.get_current_context())
    if shipped is not None and shipped not in (known := shipped_names()):
        raise InputError("--from", "must be one of " + ", ".join(known), shipped)
    path = name if name.suffix else name.with_suffix(".toml")
    write_text(path, starter(shipped), overwrite=False)
    if as_json:
        click.echo(console.to_json({"file": str(path)}))
    else:
        click.echo(f"{path} written. Next: certrack simulate {path}")


@click.command()
@click.argument("file")
@click.option("--latex", is_flag=True, help="Print the formulas as a LaTeX align* environment.")
@json_option
def design(file: str, latex: bool, as_json: bool) -> None:
    """Print error coordinates, virtual controls and control law.

    \b
    Example: certrack design dual-motor --latex
    """
    from certrack.cli import console
    from certrack.systems.reader import load

    system = load(file)
    result = system.design()
    if latex and not as_json:
        click.echo(result.latex)
        return
    if as_json:
        click.echo(console.to_json(result.summary()))
        return
    order = result.coordinates.q
    click.echo(f"{system.title or file}: {system.law.kind} law, feed-forward order {order}\n")
    click.echo(str(result))
