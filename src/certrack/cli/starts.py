"""What `certrack falsify --starts` does."""

from __future__ import annotations

from pathlib import Path

import click

from certrack.cli.base import box_of, keep_source, note_engine

#: Runs of `--budget` for each run of a start: these are of the whole duration, one by one.
RUNS_PER_START = 10


def search_starts(
    file: str, out: Path | None, budget: int, seed: int, box: str | None, *, as_json: bool
) -> None:
    """Search lost starts, say what was found, and write it."""
    from certrack.cli import console
    from certrack.reports import falsification as falsified
    from certrack.studies.falsifier.lost_starts import lost_starts
    from certrack.studies.falsifier.start_alarm import start_alarm
    from certrack.systems.reader import load
    from certrack.systems.writer import save

    system = load(file)
    keep_source(file, *filter(None, [out]))
    note_engine(compiled=False)
    with console.phases() as bars:
        searched = lost_starts(
            system,
            box_of(box),
            budget=budget // RUNS_PER_START,
            seed=seed,
            progress=bars.phase("Searching, starts", "largest state"),
        )
        alarm = start_alarm(system, searched, bars.phase("Certifying, steps", "bound"))
    nearest = searched.nearest
    written = out if nearest is not None else None
    if nearest is not None and out is not None:
        save(nearest.system, out)
    values = falsified.lost_starts_summary(searched) | {
        "seed": seed,
        "file": None if written is None else str(written),
        "alarm": None if alarm is None else alarm.kind,
        "alarm_reason": None if alarm is None else alarm.reason,
    }
    if as_json:
        click.echo(console.to_json(values))
    else:
        console.print_lines(falsified.lost_starts_lines(values, system.simulated_states))
        if written is not None:
            click.echo(f"{written} replays it: certrack simulate {written}")
    if alarm is not None:
        click.echo(
            "certrack: ALARM: a lost start is one that the certificate claims "
            f"({alarm.kind}): {alarm.reason}",
            err=True,
        )
        raise click.exceptions.Exit(1)
