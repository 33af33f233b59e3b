"""The verb that chooses gains: tune."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from certrack.cli.base import (
    FOLDER,
    MEMBER_SEED,
    NEW_FILE,
    box_of,
    json_option,
    keep_source,
    naming,
    options_named,
    tell_written,
)
from certrack.core.errors import InputError


def _number(name: str, text: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option(name, type=float, help=text)


@click.command()
@click.argument("file")
@click.option(
    "--objective",
    type=click.Choice(["error", "peak", "energy", "period"]),
    default="error",
    show_default=True,
    help="What is optimised: certified error, peak input, energy, longest stable period.",
)
@_number("--error", "Limit of the certified error; for other objectives the file's own.")
@_number("--peak-input", "Limit of |u| over the box of starts.")
@_number("--energy", "Limit of the integral of u^2, from the file's start.")
@_number("--period", "Held at this period the loop must be stable, s.")
@_number("--delay-margin", "Delay that the held loop must bear, s.")
@_number("--noise", "Limit of the gain from noise on the states to the input.")
@click.option(
    "--feedforward", type=int, help="Derivatives of y_d fed forward; default: the file's."
)
@click.option("--law", help="Kind of the law; default: the file's.")
@click.option(
    "--box", metavar="LOW:HIGH,...", help="Box of starts, one range a state; default: ensemble.x0."
)
@click.option(
    "--starts",
    type=click.IntRange(1, 10_000),
    help="Searches, from the file's gains and from random ones; default: 8, nonlinear loops 2.",
)
@click.option("--seed", type=MEMBER_SEED, default=0, show_default=True, help="Seed of the starts.")
@click.option(
    "--effort",
    type=click.Choice(["fast", "default", "high"]),
    default="fast",
    show_default=True,
    help="Of the proofs of both designs when the search is over: fast takes seconds, the others "
    "are those of certify and may take minutes.",
)
@click.option("--front", metavar="LIMIT", help="Sweep this limit too, such as period.")
@click.option("--plot", type=FOLDER, help="Folder for the picture of the front.")
@click.option("--out", type=NEW_FILE, help="File for the tuned system (TOML).")
@json_option
def tune(file: str, out: Path | None, plot: Path | None, as_json: bool, **wanted: Any) -> None:
    """Choose gains: optimise one quantity, with limits on the others.

    Always in force besides the limits given: the loop held at three times the file's period (3 ms
    without one) is stable, and the noise gain is at most ten times that of the file's design. The
    tuned design is certified in full. Progress shows the best so far; Ctrl-C keeps it, and so does
    a SIGTERM, after which nothing is measured of it.

    \b
    Example: certrack tune dual-motor-lean --peak-input 39.1 --period 0.087 --out tuned.toml
    """
    from certrack.cli.surroundings import kept_at_termination

    with kept_at_termination():
        _tuned(file, out, plot, as_json, wanted)


def _tuned(
    file: str, out: Path | None, plot: Path | None, as_json: bool, wanted: dict[str, Any]
) -> None:
    """Search, tell and write."""
    from certrack.cli import console
    from certrack.core.files import write_text
    from certrack.reports import tuning as tune_report
    from certrack.systems.edit import with_law
    from certrack.systems.reader import load
    from certrack.tuning.tune import finishing_step
    from certrack.tuning.tune import tune as search_gains

    system = load(file)
    source = _text_of(file)  # as it is now: the search may take minutes
    if out is not None:
        _require_room(out, file, source)
    if plot is not None and wanted["front"] is None:
        raise InputError("--plot", "draws a front, and none is asked for", remedy="Add --front")
    wanted["box"] = box_of(wanted["box"])
    then = "" if system.implementation is None else "now as the drive runs it"
    named = options_named(TUNE_OPTIONS), naming(file, "law", "tune"), _box_named()
    with named[0], named[1], named[2], console.phases() as bars:
        result = search_gains(
            system,
            progress=bars.phase("Tuning, starts", "best", then),
            proving=bars.phase("Search over, step", "bound", at=finishing_step),
            sweeping=bars.phase("Front, points", "last"),
            **wanted,
        )
    if as_json:
        click.echo(console.to_json(result.summary()))
    else:
        click.echo(system.title or file)
        console.print_table(tune_report.tuned_table(result, system.plant.units))
        console.print_lines(tune_report.tuned_notes(result))
    if out is not None:
        write_text(out, with_law(source, result.system, tune_report.remarks(result, file)))
    pictures: list[Path] = []
    if plot is not None and result.front is not None:
        from certrack import plotting

        figure = plotting.front_figure(result.front, system.title, system.plant.units)
        pictures = plotting.save_figure(figure, plot, "front")
    tell_written(as_json, *pictures, *filter(None, [out]))
    for warning in tune_report.warnings(result):
        click.echo(f"certrack: note: {warning}", err=True)


@contextmanager
def _box_named() -> Iterator[None]:
    """Name the option that gives a box of starts where the file has none."""
    from certrack.tuning.problem import STARTS_REMEDY

    try:
        yield
    except InputError as problem:
        if problem.remedy == STARTS_REMEDY:
            problem.remedy = "State ensemble.x0, or give --box, such as --box -1:1,-2:2"
        raise


def _require_room(out: Path, file: str, source: str) -> None:
    """Refuse what could not be written, or not be read again, before the search."""
    from certrack.core.files import require_place

    keep_source(file, out)
    require_place(out)
    samples = tomllib.loads(source).get("reference", {}).get("file")
    if samples is not None and not (out.parent / samples).exists():
        raise InputError(
            "--out",
            f"{out} would not find the samples of reference.file, which lie beside it",
            samples,
            f"Choose a name in {Path(file).parent}",
        )


#: Arguments of certrack.tune that are options of the verb.
TUNE_OPTIONS = (
    *("objective", "error", "peak_input", "energy", "period", "delay_margin", "noise"),
    *("feedforward", "box", "starts", "seed", "effort", "front"),
)


def _text_of(file: str) -> str:
    from certrack.systems.shipped import starter

    path = Path(file)
    return path.read_text("utf-8-sig") if path.exists() else starter(file)
