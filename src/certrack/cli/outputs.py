"""What `certrack falsify --of NAME` does."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import keep_source, note_engine
from certrack.cli.premises import note_contradictions


def search_output(
    file: str, of: str, out: Path | None, budget: int, seed: int, *, as_json: bool
) -> None:
    """Search the worst case of an output, say what was found, and write it."""
    from certrack.cli import console
    from certrack.reports import worst_outputs
    from certrack.studies.falsifier.any_output import OutputFalsification
    from certrack.studies.falsifier.falsify import falsify
    from certrack.studies.falsifier.outputs import output_named
    from certrack.systems.reader import load
    from certrack.systems.writer import save

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
    assert isinstance(result, OutputFalsification)
    cases = {} if out is None else {out: result.system}
    if beside is not None and result.drive is not None:
        cases[beside] = result.drive.system
    for path, case in cases.items():
        save(case, path)
    values = worst_outputs.output_summary(result) | {
        "seed": seed,
        "file": None if out is None else str(out),
    }
    if as_json:
        click.echo(console.to_json(values))
    else:
        console.print_lines(worst_outputs.output_lines(values))
        for path in cases:
            click.echo(f"{path} replays it: certrack simulate {path}")
    if "drive" in result.left_out:
        click.echo(
            "certrack: note: nothing was tried of the loop as [implementation] runs it: "
            f"{result.left_out['drive']}",
            err=True,
        )
    if result.alarm is not None:
        click.echo(
            f"certrack: ALARM: a run is beyond the verified bound ({result.alarm}): "
            f"{result.reason}",
            err=True,
        )
        raise click.exceptions.Exit(1)
