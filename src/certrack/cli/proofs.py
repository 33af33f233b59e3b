"""Verbs about guarantees: certify, verify, falsify."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from certrack.cli.base import (
    FOLDER,
    NEW_FILE,
    json_option,
    keep_source,
)
from certrack.cli.pictures import picture_options
from certrack.cli.premises import say_contradicted
from certrack.cli.starts import search_starts
from certrack.cli.worst_cases import search_worst_case
from certrack.core.errors import InputError
from certrack.reports.premises import premise_lines

if TYPE_CHECKING:
    from certrack.certificates import Certificates
    from certrack.plotting import Appearance
    from certrack.systems.system import System


@click.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, help="File for the certificate (JSON).")
@click.option(
    "--plot",
    type=FOLDER,
    help="Folder for the pictures of the tube over the response, and of the starts from which a "
    "drive's input is proven to stay within its limits.",
)
@click.option(
    "--states",
    metavar="NAME,NAME",
    help="The two states of the picture of starts; the first two by default.",
)
@click.option(
    "--effort",
    type=click.Choice(["fast", "default", "high"]),
    default="default",
    show_default=True,
    help="How long it may take: fast makes no cells of ranges and no bootstrap, high four times as "
    "many cells, and polynomials behind the bootstrap (half a minute to half an hour).",
)
@click.option(
    "--input",
    "with_input",
    is_flag=True,
    help="Bound the input, too: energy over the run, root mean square, peak from x0 and over the "
    "starts of [ensemble], and in the long run.",
)
@click.option("--require", is_flag=True, help="Exit with 1 if nothing is verified.")
@picture_options
@json_option
def certify(
    file: str,
    out: Path | None,
    plot: Path | None,
    states: str | None,
    effort: str,
    with_input: bool,
    require: bool,
    appearance: Appearance,
    as_json: bool,
) -> None:
    """Compute guaranteed bounds on the tracking error.

    Bounds that are shown as verified have been checked in exact arithmetic. Every premise is shown
    with its status: proven, checked on samples, assumed, or contradicted by the file's own truth.
    The exit code is 1 if one is contradicted, for then nothing is verified for this file, and with
    --require or --out also if there is no verified bound.

    \b
    Example: certrack certify dual-motor-lean --out cert.json
    """
    from certrack import certificates
    from certrack.cli import console
    from certrack.reports import certificates as certificate_report
    from certrack.reports import input_bounds as input_report
    from certrack.reports import ranges as range_report
    from certrack.systems.reader import load

    system = load(file)
    axes = _two_states(states, system.plant.states)
    keep_source(file, *filter(None, [out]))
    with console.progress("Certifying, steps", "bound") as advance:
        result = certificates.certify(system, effort, advance)
    if out is not None and result.stages:
        certificates.save_certificate(system, result.stages, out)
    if plot is not None and result.tube is not None:
        from certrack import plotting
        from certrack.simulation.simulator import simulate as run_system

        run = run_system(system)
        drawing = plotting.tube_figure(run, result.tube, system.title, result.best, appearance)
        plotting.save_figure(drawing, plot, "tube")
    if plot is not None and result.implemented.polytope is not None and system.plant.n > 1:
        from certrack import plotting

        title, units = appearance.titled(system.title), system.plant.units
        drawing = plotting.starts_figure(result.implemented, axes, title, units, appearance)
        plotting.save_figure(drawing, plot, "starts")
    of_input = input_report.bounds_of_input(system) if with_input else {}
    if as_json:
        click.echo(console.to_json(range_report.ranged_summary(result) | of_input))
    else:
        click.echo(system.title or file)
        console.print_table(certificate_report.certificates_table(result))
        if result.constants:
            console.print_table(range_report.costs_table(result))
        console.print_lines(certificate_report.certificates_notes(result))
        console.print_lines(range_report.strength_line(result))
        console.print_lines(input_report.input_lines(system, of_input))
        console.print_lines(["resting on:", *premise_lines(result.premises)])
    say_contradicted(result.contradicted)
    _note_without_implemented(system, result)
    _hint_of_weights(system, result, effort)
    if not result.best.exists:
        click.echo(f"certrack: no certificate: {result.reason}", err=True)
    if out is not None and not result.stages:
        click.echo(f"certrack: {out} is not written: there is nothing verified", err=True)
    if result.contradicted or ((require or out is not None) and not result.verified):
        raise click.exceptions.Exit(1)


def _note_without_implemented(system: System, result: Certificates) -> None:
    """Say that no bound is of the loop as the drive runs it, and why, where there is a drive."""
    as_run = result.implemented.verified or result.sampled.verified
    if system.implementation is not None and result.best.exists and not as_run:
        click.echo(
            "certrack: note: what is verified here is of the continuous law, nothing is of the "
            f"loop as [implementation] runs it: {result.implemented.reason}",
            err=True,
        )


def _two_states(names: str | None, known: Sequence[str]) -> tuple[str, str] | None:
    """The names of --states."""
    if names is None:
        return None
    from certrack.core import checks

    parts = [name.strip() for name in names.split(",")]
    if len(parts) != 2 or parts[0] == parts[1]:
        raise InputError("--states", "must be two different states", names, "Write x1,x2")
    first, second = (checks.choice("--states", name, known) for name in parts)
    return first, second


def _hint_of_weights(system: System, result: Certificates, effort: str) -> None:
    """Say once that weights in the norm of gamma would help, where the states differ in size."""
    from certrack.core.rounding import printed_bound
    from certrack.studies.norm_weights import helpful_weights

    helpful = None if effort == "fast" else helpful_weights(system, result)
    if helpful is not None:
        weights, bound = helpful
        click.echo(
            f"certrack: note: {weights.text(system.plant.states)}; {weights.remedy}: the bound "
            f"would then be {printed_bound(bound, 5)}",
            err=True,
        )


@click.command()
@click.argument("certificate", type=click.Path(path_type=Path))
@json_option
def verify(certificate: Path, as_json: bool) -> None:
    """Check a saved certificate in exact arithmetic.

    No solver is used. The premises are looked at anew, as `certrack certify` does. The exit code is
    1 if the certificate does not hold, or the truth of its own system contradicts a premise.

    \b
    Example: certrack verify cert.json
    """
    from certrack import certificates
    from certrack.certificates.implemented.premises import LIMITS, REGION
    from certrack.certificates.region import is_only_in_region
    from certrack.certificates.sampled_adaptive.premises import STARTS
    from certrack.cli import console
    from certrack.reports.certificates import EVERY_START

    proof = certificates.verify(certificate)
    named = {premise.name for premise in proof.premises}
    limited = bool(named & {LIMITS, REGION}) or is_only_in_region(proof.premises)
    whose = " from simulation.x0" if limited else ""
    whose = " from the starts stated below" if STARTS in named else whose
    if as_json:
        from dataclasses import asdict

        starts = (whose.strip() or EVERY_START) if proof.verified else None
        click.echo(console.to_json(asdict(proof) | {"starts": starts}))
    elif proof.verified:
        click.echo(f"verified: limsup |e_1| <= {proof.printed_bound}{whose}, resting on")
        console.print_lines(premise_lines(proof.premises))
    if not proof.verified:
        click.echo(f"certrack: {certificate}: not verified: {proof.reason}", err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, help="System file (TOML) for the worst case.")
@click.option(
    "--of",
    "of",
    metavar="error|input|NAME",
    default="error",
    show_default=True,
    help="What is to become large: the error, the input, a state or an estimate by its name.",
)
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
@click.option(
    "--starts",
    is_flag=True,
    help="Search a start of the box from which the loop escapes instead; a tenth of the runs.",
)
@click.option(
    "--box",
    metavar="LOW:HIGH,...",
    help="With --starts: the box, one range a state; default: ensemble.x0.",
)
@json_option
def falsify(
    file: str,
    out: Path | None,
    of: str,
    budget: int,
    seed: int,
    starts: bool,
    box: str | None,
    as_json: bool,
) -> None:
    """Search for the worst admissible case.

    Disturbance, reference and parameters are varied within what the certificate covers; the file's
    own run is a candidate, too. Where the error loop is linear, its kernels and a linear program
    give another, at the corners of plant.ranges; where it is not, an ascent by its adjoint does.
    With [implementation] there is also one of the sampled loop with the worst noise, which --out
    FILE.toml writes as FILE-drive.toml; the adaptive law is searched on that loop.

    The worst error found is compared with every certificate: the ratio of bound to error tells how
    tight a bound is. A run beyond the best verified bound is an alarm, with exit code 1: a premise
    is broken, or certrack is wrong. The paper's bound, whose proof has a gap, may be exceeded.

    With --of the input, a state (x2) or an estimate (theta_hat_1) is made large instead, and held
    against the bound that is certified of it, where there is one.

    With --starts the loop of the file, as implemented where it has [implementation], begins at
    corners of the box, at random places and around the worst of them, under the file's own
    disturbances and under ones at their bounds: is there a start that it does not bring back? The
    nearest that is found is written by --out. That none is found proves nothing.

    \b
    Example: certrack falsify example1 --out worst.toml
             certrack falsify dual-motor-lean --of input
             certrack falsify dual-motor-drag --starts --box=-12:12,-12:12,-12:12,-12:12
    """
    if box is not None and not starts:
        raise InputError("--box", "is of the starts that --starts searches", box, "Add --starts")
    if starts and of != "error":
        raise InputError("--of", "is of the worst case, not of lost starts", of, "Omit --starts")
    if starts:
        search_starts(file, out, budget, seed, box, as_json=as_json)
        return
    search_worst_case(file, of, out, budget, seed, as_json=as_json)
