"""Verbs about systems: list, new, design."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import json_option


@click.command("list")
@json_option
def list_systems(as_json: bool) -> None:
    """List the shipped systems.

    \b
    Example: certrack list
    """
    from certrack.cli import report
    from certrack.systems.reader import catalog

    systems = catalog()
    if as_json:
        click.echo(report.to_json(systems))
    else:
        report.console().print(report.table("", ["name", "title"], list(systems.items())))


@click.command()
@click.argument("name", type=click.Path(path_type=Path, dir_okay=False))
@json_option
def new(name: Path, as_json: bool) -> None:
    """Write a commented starter system file NAME.

    \b
    Example: certrack new drive.toml
    """
    from certrack.cli import report
    from certrack.core.files import write_text
    from certrack.systems.reader import starter

    if not name.name:
        raise click.UsageError("NAME must be a file name", click.get_current_context())
    path = name if name.suffix else name.with_suffix(".toml")
    write_text(path, starter(), overwrite=False)
    if as_json:
        click.echo(report.to_json({"file": str(path)}))
    else:
        click.echo(f"{path} written. Next: certrack simulate {path}")


@click.command()
@click.argument("file")
@click.option("--latex", is_flag=True, help="Print the formulas as a LaTeX align* environment.")
@json_option
def design(file: str, latex: bool, as_json: bool) -> None:
    """Design the controller: error coordinates, virtual controls, control law.

    \b
    Example: certrack design dual-motor --latex
    """
    from certrack.cli import report
    from certrack.systems import formulas
    from certrack.systems.reader import load

    system = load(file)
    if latex and not as_json:
        click.echo(formulas.as_latex(system))
        return
    found = system.controller.coordinates
    if as_json:
        poles = sorted(found.poles, key=lambda pole: (pole.real, pole.imag))
        values = {
            "A": found.A,
            "B": found.B if found.q else found.B[:, 0],
            "kappa": found.kappa,
            "eta": found.eta,
            "d": found.d if found.q else found.d[:, 0],
            "R": found.R,
            "nu_x": found.nu_x,
            "nu_Y": found.nu_Y,
            "feedforward": found.q,
            "error_poles": [[pole.real, pole.imag] for pole in poles],
            "law": formulas.as_text(system),
            "latex": formulas.as_latex(system),
        }
        click.echo(report.to_json(values))
        return
    click.echo(f"{system.title or file}: {system.law.kind} law, feed-forward order {found.q}\n")
    click.echo("\n".join(formulas.as_text(system)))
    damping = ", ".join(f"{value:.6g}" for value in found.kappa)
    click.echo(f"\nkappa = ({damping}) 1/s; fastest error pole {found.fastest_pole:.4g} 1/s")
