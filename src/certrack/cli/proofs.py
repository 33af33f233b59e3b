"""Verbs about guarantees: certify, verify, falsify."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import FOLDER, json_option, note_implementation, note_violations


@click.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Certificate (JSON).")
@click.option("--plot", type=FOLDER, help="Folder for the picture of the tube over the response.")
@json_option
def certify(file: str, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Certify: guaranteed bounds on the tracking error, exactly verified.

    Exit code 1 if no certificate exists or none was found.

    \b
    Example: certrack certify dual-motor-lean --out cert.json
    """
    from certrack import certificates
    from certrack.cli import report
    from certrack.systems.reader import load

    system = load(file)
    note_violations(system)
    note_implementation(system)
    found = certificates.certify(system)
    if out is not None and found.stages:
        certificates.save_certificate(system, found.stages, out)
    if plot is not None and found.tube is not None:
        from certrack import plotting
        from certrack.simulation.simulator import simulate as run_system

        run = run_system(system)
        plotting.save_figure(plotting.tube_figure(run, found.tube, system.title), plot, "tube")
    if as_json:
        click.echo(report.to_json(report.certificates_summary(found)))
    else:
        click.echo(system.title or file)
        report.console().print(report.certificates_table(found))
        for line in report.certificates_notes(found):
            click.echo(line)
    if not found.best.exists:
        click.echo(f"certrack: no certificate: {found.semidefinite.reason}", err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("certificate", type=click.Path(path_type=Path))
@json_option
def verify(certificate: Path, as_json: bool) -> None:
    """Check a saved certificate in exact arithmetic; no solver is used.

    Exit code 1 if it does not hold.

    \b
    Example: certrack verify cert.json
    """
    from certrack import certificates
    from certrack.cli import report

    found = certificates.verify(certificate)
    if as_json:
        from dataclasses import asdict

        click.echo(report.to_json(asdict(found)))
    elif found.verified:
        click.echo(f"verified: limsup |e_1| <= {float(found.bound):.6g}, resting on")
        click.echo("\n".join(f"  {line}" for line in found.assumptions))
    if not found.verified:
        click.echo(f"certrack: {certificate}: not verified: {found.reason}", err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Worst case (TOML).")
@click.option("--budget", type=click.IntRange(100), default=6000, show_default=True, help="Runs.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@json_option
def falsify(file: str, out: Path | None, budget: int, seed: int, as_json: bool) -> None:
    """Search the worst admissible disturbance, reference and parameters.

    The ratio tells how tight the certificate is: certified bound over worst error found.

    \b
    Example: certrack falsify example1 --out worst.toml
    """
    from certrack.certificates import best_sound_bound
    from certrack.cli import report
    from certrack.studies.falsifier import falsify as falsifier
    from certrack.systems.reader import load
    from certrack.systems.writer import save

    system = load(file)
    note_violations(system)
    note_implementation(system)
    with report.progress("Searching", budget) as advance:
        found = falsifier.falsify(system, budget=budget, seed=seed, progress=advance)
    if out is not None:
        save(found.system, out)
    certified = best_sound_bound(system)
    values = {
        "worst_error": found.worst_error,
        "certified": certified,
        "ratio": certified / found.worst_error if found.worst_error else None,
        "runs": found.evaluations,
        "seed": seed,
        "file": None if out is None else str(out),
    }
    if as_json:
        click.echo(report.to_json(values))
    else:
        click.echo(f"worst |e_1| found in {found.evaluations} runs: {found.worst_error:.6g}")
        click.echo(f"certified limsup |e_1|: {certified:.6g}")
        click.echo(f"certified / found: {certified / found.worst_error:.3g}")
        if out is not None:
            click.echo(f"{out} replays it: certrack simulate {out}")
