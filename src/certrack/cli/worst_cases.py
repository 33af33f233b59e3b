"""What `certrack falsify` does: the worst case of the error, or with `--of` of another output."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.cli.base import keep_source, note_engine, note_implementation
from certrack.cli.premises import note_contradictions

if TYPE_CHECKING:
    from certrack.studies.falsifier.any_output import OutputFalsification
    from certrack.studies.falsifier.falsify import Falsification
    from certrack.systems.system import System


def search_worst_case(
    file: str, of: str, out: Path | None, budget: int, seed: int, *, as_json: bool
) -> None:
    """Search the worst case of an output, say what was found, and write it."""
    from certrack.cli import console
    from certrack.reports.falsification import falsification_summary
    from certrack.reports.worst_outputs import output_lines, output_summary
    from certrack.studies.falsifier.any_output import OutputFalsification
    from certrack.studies.falsifier.falsify import falsify
    from certrack.studies.falsifier.outputs import output_named
    from certrack.systems.reader import load

    system = load(file)
    beside = None if out is None else out.with_name(f"{out.stem}-drive{out.suffix}")
    keep_source(file, *filter(None, [out, beside]))
    output_named(system, of)  # before anything takes its time
    note_engine(compiled=False)
    note_contradictions(system, file)
    with console.phases() as bars:
        result = falsify(
            system,
            of=of,
            budget=budget,
            seed=seed,
            progress=bars.phase("Searching, runs"),
            certifying=bars.phase("Certifying what the search is held against, steps", "bound"),
        )
    is_error = not isinstance(result, OutputFalsification)
    if is_error and result.drive is None:
        note_implementation(system)
    cases = _written(result, out, beside)
    chosen = {"seed": seed, "file": None if out is None else str(out)}
    if isinstance(result, OutputFalsification):
        values = output_summary(result) | chosen
    else:
        values = falsification_summary(result) | chosen
    if as_json:
        click.echo(console.to_json(values))
    elif isinstance(result, OutputFalsification):
        console.print_lines(output_lines(values))
        _say_replays(cases)
    else:
        _say_error(result, values)
        _say_left_out(result)
        _say_replays(cases)
    if not is_error:
        _say_left_out(result)
    if result.alarm is not None:
        click.echo(
            f"certrack: ALARM: a run is beyond the verified bound ({result.alarm}): "
            f"{result.reason}",
            err=True,
        )
        raise click.exceptions.Exit(1)


def _written(
    result: Falsification | OutputFalsification, out: Path | None, beside: Path | None
) -> dict[Path, System]:
    """The files that replay what was found."""
    from certrack.systems.writer import save

    cases = {} if out is None else {out: result.system}
    if beside is not None and result.drive is not None:
        cases[beside] = result.drive.system
    for path, case in cases.items():
        save(case, path)
    return cases


def _say_error(result: Falsification, values: dict[str, Any]) -> None:
    from certrack.cli import console
    from certrack.core.rounding import printed_bound
    from certrack.reports.falsification import drive_lines, falsification_table
    from certrack.reports.worst_outputs import ORIGIN_WORDS

    origin, loop = ORIGIN_WORDS[result.origin], "" if result.drive is None else "continuous law, "
    runs = f"{result.evaluations} runs{origin}"
    click.echo(f"{loop}worst |e_1| found in {runs}: {result.worst_error:.6g}")
    click.echo(f"stopped: {result.ended}")
    click.echo(f"{loop}certified limsup |e_1|: {printed_bound(values['certified'])}")
    ratio = values["ratio"]
    click.echo(f"certified / found: {'-' if ratio is None else format(ratio, '.3g')}")
    console.print_table(falsification_table(values["certificates"]))
    if values["settling"]:
        console.print_lines([STILL_SETTLING])
    if values["certificates"].get("published", {}).get("exceeded"):
        console.print_lines([PUBLISHED_EXCEEDED])
    if values["drive"] is not None:
        console.print_lines(drive_lines(values["drive"]))


def _say_left_out(result: Falsification | OutputFalsification) -> None:
    if "drive" in result.left_out:
        click.echo(
            "certrack: note: nothing was tried of the loop as [implementation] runs it: "
            f"{result.left_out['drive']}",
            err=True,
        )


def _say_replays(paths: Iterable[Path]) -> None:
    for path in paths:
        click.echo(f"{path} replays it: certrack simulate {path}")


#: What the user is told where the worst run has not reached its long run.
STILL_SETTLING = (
    "The worst run has not settled from its start: it is beyond the bound and within the tube, so "
    "it says nothing against a bound in the long run."
)

#: What the user is told where the falsifier passes the paper's bound, which nobody has proven.
PUBLISHED_EXCEEDED = (
    "The published bound (42) does not hold here: the last step of its proof takes V' < 0 for a "
    "falling |e_1|. No alarm: only a verified bound would raise one."
)
