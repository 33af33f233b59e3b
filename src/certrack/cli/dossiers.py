"""The verb about all of a design at once: report."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import NEW_FILE, json_option, keep_source, note_engine, tell_written


@click.command()
@click.argument("file")
@click.option(
    "--out",
    type=NEW_FILE,
    required=True,
    help="File of the dossier: .html or .pdf; .md or .tex for its tables alone.",
)
@click.option(
    "--effort",
    type=click.Choice(["fast", "default", "high"]),
    default="default",
    show_default=True,
    help="Of the certificates.",
)
@click.option(
    "-n",
    "--members",
    type=click.IntRange(1),
    default=1000,
    show_default=True,
    help="Members of the ensemble.",
)
@click.option(
    "--budget",
    type=click.IntRange(100),
    default=6000,
    show_default=True,
    help="About so many runs of the falsifier.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Of both of them."
)
@click.option(
    "--without",
    type=click.Choice(["falsification", "ensemble", "margins"]),
    multiple=True,
    help="Leave a part out, since it takes time; may be given again.",
)
@json_option
def report(
    file: str,
    out: Path,
    effort: str,
    members: int,
    budget: int,
    seed: int,
    without: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write one page about a design, for a reviewer or a customer.

    Plant and premises, the law as formulas, all certificates and how to check them, where the bound
    comes from, the response, the worst case found, an ensemble, margins, the drive, and the system
    file. A page (.html) carries its pictures and the certificate, and needs no network; a print of
    it (.pdf) needs WeasyPrint. The exit code is 1 if a premise is contradicted, or a run that was
    found is beyond a verified bound.

    \b
    Example: certrack report dual-motor-drive --out report.html
    """
    from certrack.cli import console
    from certrack.reports.dossier import dossier
    from certrack.reports.pages import require_writable, save_dossier
    from certrack.systems.reader import load

    require_writable(out)
    system = load(file)
    keep_source(file, out)
    note_engine()
    with console.progress("Reporting, parts") as advance:
        result = dossier(
            system,
            file,
            effort=effort,
            members=members,
            budget=budget,
            seed=seed,
            without=without,
            progress=advance,
        )
    save_dossier(result, out)
    if as_json:
        click.echo(console.to_json({"file": str(out), "summary": result.summary}))
    else:
        click.echo(result.title)
        console.print_lines(result.summary)
    tell_written(as_json, out)
    if not result.sound:
        raise click.exceptions.Exit(1)
