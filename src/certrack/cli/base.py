"""What the verbs share: options, notes and exit codes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.core.errors import InputError

if TYPE_CHECKING:
    from certrack.simulation.run import Run
    from certrack.systems.system import System

FOLDER = click.Path(path_type=Path, file_okay=False)
NEW_FILE = click.Path(path_type=Path, dir_okay=False)

#: Seed of an ensemble.
MEMBER_SEED = click.IntRange(0, 2**63)


def json_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--json``."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Print the results as JSON, for programs."
    )(command)


def period_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--period``."""
    return click.option("--period", type=float, help="Sampling period, s; default: the file's.")(
        command
    )


@contextmanager
def naming(file: str, *keys: str, period: float | None = None) -> Iterator[None]:
    """Name the system file in refusals of these keys, which come after it was read.

    A period that was given as an option is refused under the option's name.
    """
    try:
        yield
    except InputError as problem:
        if period is not None and problem.key == "implementation.period":
            problem.key = "--period"
        if problem.key in keys and not problem.file:
            problem.within(file if Path(file).suffix else f"{file}.toml")
        raise


@contextmanager
def options_named(options: Sequence[str]) -> Iterator[None]:
    """Name the options in refusals of the arguments that they set."""
    try:
        yield
    except InputError as problem:
        name, mark, index = problem.key.partition("[")
        if name in options and not problem.file:
            problem.key = f"--{name.replace('_', '-')}{mark}{index}"
        raise


def keep_source(file: str, *outputs: Path) -> None:
    """Refuse, before anything is computed, to write over the system file that was read."""
    for path in outputs:
        if path.exists() and Path(file).exists() and path.samefile(file):
            raise InputError("--out", f"{path} would be written over", remedy="Choose another name")


def tell_written(as_json: bool, *paths: Path) -> None:
    """Say which files, or how many in which folder, were written; programs know."""
    if as_json:
        return
    if len(paths) == 1:
        click.echo(f"{paths[0]} written")
    elif paths:
        click.echo(f"{len(paths)} files written in {paths[0].parent}")


def note_implementation(system: System) -> None:
    """Say that a guarantee is of the continuous law where the file has a sampled controller."""
    if system.implementation is not None:
        click.echo(
            "certrack: note: this is of the continuous law; sampling, delay, limits and sensors of "
            "[implementation] are left out (see: certrack margin)",
            err=True,
        )


def note_engine(*, compiled: bool = True, alone: bool = False) -> None:
    """Say that NumPy computes where nothing compiles; with `compiled`, a C compiler would do.

    `alone`: members of an ensemble are then run by SciPy, one after the other.
    """
    from certrack.core.compilers import c_compilers
    from certrack.core.heyoka import has_heyoka

    if not has_heyoka() and not (compiled and c_compilers()):
        missing = "neither heyoka nor a C compiler is" if compiled else "heyoka is not"
        by = (
            "by SciPy, one member after the other, which is some 5000 times slower"
            if alone
            else "by NumPy, which is about 50 times slower"
        )
        click.echo(f"certrack: note: {missing} installed: computed {by}", err=True)


def note_unlikely(system: System) -> None:
    """Say what makes the file's implementation unlikely to work, before it is used."""
    from certrack.simulation.implementation_notes import implementation_notes

    for note in implementation_notes(system):
        click.echo(f"certrack: note: {note}", err=True)


def diagnose(runs: Mapping[str, Run]) -> None:
    """Notes of all runs to standard error; exit code 1 if one of them did not finish.

    Of several runs each note says whose it is.
    """
    for name, run in runs.items():
        of = f"{name}: " if len(runs) > 1 else ""
        for note in run.notes:
            click.echo(f"certrack: note: {of}{note}", err=True)
        if (
            any(note.startswith("Stuck at ") for note in run.notes)
            and run.system.law.observer is None
        ):
            click.echo(
                f"certrack: note: {of}an observer that estimates the friction takes most of its "
                "error off: [law.observer] of kind dob or eso, see docs/observers.md",
                err=True,
            )
        if run.outcome.name != "finished":
            t = run.trajectory.end
            click.echo(f"certrack: {of}stopped at t = {t:.6g} s: {run.message}", err=True)
    if any(run.outcome.name != "finished" for run in runs.values()):
        raise click.exceptions.Exit(1)


def box_of(text: str | None) -> list[tuple[float, float]] | None:
    """Pairs of ends of an option --box; their order and number are checked later."""
    if text is None:
        return None
    pairs: list[tuple[float, float]] = []
    for part in text.split(","):
        ends: Sequence[str] = part.split(":")
        try:
            low, high = map(float, ends)
        except ValueError:
            raise InputError(
                "--box", "must be low:high for each state, such as -1:1,-2:2", text
            ) from None
        pairs.append((low, high))
    return pairs
