"""The verb about a file before anything is solved: check."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from certrack.cli.base import json_option
from certrack.cli.premises import say_contradicted
from certrack.reports.premises import premise_lines

if TYPE_CHECKING:
    from certrack.certificates.cover import Cover
    from certrack.studies.check import Check
    from certrack.systems.system import System


#: What is said besides where the premises are those of the continuous law.
LOOP_AS_IT_RUNS = (
    "certrack certify tells whether the loop as the drive runs it has a bound of its own; that one "
    "does not rest on the continuous law"
)


@click.command()
@click.argument("file")
@json_option
def check(file: str, as_json: bool) -> None:
    """Look at a file without solving anything.

    Premises of certificates against the file's own truth, the smallest gamma and beta that cover
    it, poles and leaks against the sampling period, steps of sensors and converter, units. The exit
    code is 1 if a premise is contradicted, or the sampled loop cannot work.

    \b
    Example: certrack check dual-motor-drive
    """
    from certrack.certificates.premises_of_truth import CONTINUOUS_LAW
    from certrack.cli import console
    from certrack.studies.check import check as check_system
    from certrack.systems.reader import load

    system = load(file)
    result = check_system(system)
    if as_json:
        click.echo(console.to_json(result.summary()))
    else:
        click.echo(system.title or file)
        console.print_lines(["premises:", *premise_lines(result.premises)])
        if any(premise.name == CONTINUOUS_LAW for premise in result.premises):
            console.print_lines([LOOP_AS_IT_RUNS])
        console.print_lines(_lines(system, result))
    say_contradicted(result.contradicted)
    for finding in result.faults:
        click.echo(f"certrack: {finding.name}: {finding.detail}; {finding.remedy}", err=True)
    if not result.sound:
        raise click.exceptions.Exit(1)


def _lines(system: System, result: Check) -> Iterator[str]:
    u = system.plant.uncertainty
    covers = [cover for cover in result.covers if cover.gamma != 0 or cover.beta != 0]
    if covers:
        yield "smallest bounds that cover truth.omega, tau as it is:"
    for k, cover in enumerate(result.covers):
        if cover in covers:
            yield f"  {cover.term}: {_cover_text(cover, u.gamma[k], u.beta[k])}"
    yield "findings:"
    for finding in result.findings:
        remedy = f"; {finding.remedy}" if finding.remedy else ""
        yield f"  {finding.status:<7}  {finding.name}: {finding.detail}{remedy}"


def _cover_text(cover: Cover, gamma: float, beta: float) -> str:
    how = "proven" if cover.proven else "on samples"
    if cover.both is not None:
        return f"gamma = {cover.both[0]:g} with beta = {cover.both[1]:g} ({how})"
    options = [f"gamma = {cover.gamma:g} with beta = {beta:g}"] if cover.gamma is not None else []
    options += [f"beta = {cover.beta:g} with gamma = {gamma:g}"] if cover.beta is not None else []
    return f"{' or '.join(options)} ({how})" if options else "none was found"
