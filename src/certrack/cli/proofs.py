"""Verbs about guarantees: certify, verify, falsify."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.cli.base import (
    FOLDER,
    NEW_FILE,
    json_option,
    note_engine,
    note_implementation,
    note_violations,
)

if TYPE_CHECKING:
    from certrack.certificates import Certificate
    from certrack.systems.system import System


@click.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, help="File for the certificate (JSON).")
@click.option("--plot", type=FOLDER, help="Folder for the picture of the tube over the response.")
@json_option
def certify(file: str, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Compute guaranteed bounds on the tracking error.

    Bounds that are shown as verified have been checked in exact arithmetic. The exit code is 1 if
    no certificate exists or none was found.

    \b
    Example: certrack certify dual-motor-lean --out cert.json
    """
    from certrack import certificates
    from certrack.cli import report
    from certrack.systems.reader import load

    system = load(file)
    note_violations(system)
    note_implementation(system)
    result = certificates.certify(system)
    if out is not None and result.stages:
        certificates.save_certificate(system, result.stages, out)
    if plot is not None and result.tube is not None:
        from certrack import plotting
        from certrack.simulation.simulator import simulate as run_system

        run = run_system(system)
        plotting.save_figure(plotting.tube_figure(run, result.tube, system.title), plot, "tube")
    if as_json:
        click.echo(report.to_json(report.certificates_summary(result)))
    else:
        click.echo(system.title or file)
        report.console().print(report.certificates_table(result))
        report.print_lines(report.certificates_notes(result))
    if not result.best.exists:
        click.echo(f"certrack: no certificate: {result.semidefinite.reason}", err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("certificate", type=click.Path(path_type=Path))
@json_option
def verify(certificate: Path, as_json: bool) -> None:
    """Check a saved certificate in exact arithmetic.

    No solver is used. The exit code is 1 if the certificate does not hold.

    \b
    Example: certrack verify cert.json
    """
    from certrack import certificates
    from certrack.cli import report

    proof = certificates.verify(certificate)
    if as_json:
        from dataclasses import asdict

        click.echo(report.to_json(asdict(proof)))
    elif proof.verified:
        click.echo(f"verified: limsup |e_1| <= {proof.printed_bound}, resting on")
        report.print_lines(f"  {line}" for line in proof.assumptions)
    if not proof.verified:
        click.echo(f"certrack: {certificate}: not verified: {proof.reason}", err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, help="System file (TOML) for the worst case.")
@click.option(
    "--budget",
    type=click.IntRange(100),
    default=6000,
    show_default=True,
    help="About so many runs.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the search."
)
@json_option
def falsify(file: str, out: Path | None, budget: int, seed: int, as_json: bool) -> None:
    """Search for the worst admissible case.

    Disturbance, reference and parameters are varied within what the certificate covers. The worst
    error found is compared with every certificate: the ratio of bound to error tells how tight a
    bound is, and one below the error is exceeded. That may happen to the paper's bound, whose proof
    has a gap.

    \b
    Example: certrack falsify example1 --out worst.toml
    """
    from certrack.cli import report
    from certrack.core.rounding import printed_bound
    from certrack.studies.falsifier.falsify import falsify as search
    from certrack.systems.reader import load
    from certrack.systems.writer import save

    system = load(file)
    note_engine(compiled=False)
    note_violations(system)
    note_implementation(system)
    with report.progress("Searching") as advance:
        result = search(system, budget=budget, seed=seed, progress=advance)
    if out is not None:
        save(result.system, out)
    certificates = _certificates_of(system)
    certified = min(c.bound for kind, c in certificates.items() if kind != "published")
    against = {kind: _comparison(c, result.worst_error) for kind, c in certificates.items()}
    values = {
        "worst_error": result.worst_error,
        "certified": certified,
        "ratio": certified / result.worst_error if result.worst_error else None,
        "certificates": against,
        "runs": result.evaluations,
        "seed": seed,
        "file": None if out is None else str(out),
    }
    if as_json:
        click.echo(report.to_json(values))
    else:
        click.echo(f"worst |e_1| found in {result.evaluations} runs: {result.worst_error:.6g}")
        click.echo(f"certified limsup |e_1|: {printed_bound(certified)}")
        ratio = values["ratio"]
        click.echo(f"certified / found: {'-' if ratio is None else format(ratio, '.3g')}")
        rows = [
            [kind, bound, "exactly" if entry["verified"] else "-", entry["ratio"], note]
            for kind, entry in against.items()
            for bound in [printed_bound(entry["bound"])]
            for note in ["EXCEEDED by the case found" if entry["exceeded"] else ""]
        ]
        columns = ["certificate", "bound", "verified", "ratio", "note"]
        report.console().print(report.table("", columns, rows))
        if against["published"]["exceeded"]:
            report.print_lines([PUBLISHED_EXCEEDED])
        if out is not None:
            click.echo(f"{out} replays it: certrack simulate {out}")


#: What the user is told where the falsifier passes the paper's bound, which nobody has proven.
PUBLISHED_EXCEEDED = (
    "The published bound (42) does not hold here: the last step of its proof takes V' < 0 for a "
    "falling |e_1|. No alarm: only a verified bound would raise one."
)


def _certificates_of(system: System) -> dict[str, Certificate]:
    """Every certificate that `certify` lists, without the critical strengths."""
    from certrack.certificates import certify_semidefinite
    from certrack.certificates.cascade import certify_cascade
    from certrack.certificates.published import certify_published

    return {
        **certify_published(system),
        "semidefinite": certify_semidefinite(system)[0],
        "cascade": certify_cascade(system)[0],
    }


def _comparison(certificate: Certificate, error: float) -> dict[str, Any]:
    """A bound beside the worst error found; a bound that does not exist is null."""
    return {
        "bound": certificate.bound,
        "verified": certificate.verified,
        "ratio": certificate.bound / error if error else math.inf,
        "exceeded": error > certificate.bound,
    }
