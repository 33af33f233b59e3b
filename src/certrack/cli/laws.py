"""Laws side by side on one system: what compare does with --laws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from certrack.cli.base import MEMBER_SEED, naming, tell_written
from certrack.core.errors import InputError

#: Arguments of compare_laws, by the names of the options.
ARGUMENTS = {
    "peak_input": "peak_input",
    "variation": "variation",
    "period": "period",
    "evaluations": "budget",
    "members": "members",
    "seed": "seed",
}


def law_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--laws`` and what belongs to it."""
    options = [
        click.option(
            "--laws",
            metavar="LAW,...",
            help="Tune these laws for one FILE and compare them: lean, paper, classic, lqr, pid, "
            "smc, super-twisting, adrc, mrac, l1, mpc.",
        ),
        click.option(
            "--peak-input",
            type=float,
            help="With --laws, limit of |u| over the box of starts; default: the file's law's.",
        ),
        click.option(
            "--variation",
            type=float,
            help="With --laws, limit of the input's variation; default: 10 times the file's law's.",
        ),
        click.option(
            "--period",
            type=float,
            help="With --laws, period at which a law must still work, s; default: 3 times the "
            "file's (0.001 s without one).",
        ),
        click.option(
            "--evaluations",
            type=click.IntRange(10, 100_000),
            default=150,
            show_default=True,
            help="With --laws, how many gains are tried of each law.",
        ),
        click.option(
            "-n",
            "--members",
            type=click.IntRange(2, 100_000),
            default=1000,
            show_default=True,
            help="With --laws, members of the ensemble that measures each law.",
        ),
        click.option(
            "--seed",
            type=MEMBER_SEED,
            default=0,
            show_default=True,
            help="With --laws, seed of the search and of the ensemble.",
        ),
        click.option(
            "--gains",
            "gains_file",
            type=click.Path(path_type=Path),
            help="Measure laws with the gains in this file, which --laws with --json wrote, within "
            "its limits; no search. Without --laws, all that it has.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def refuse_without_laws(context: click.Context) -> None:
    """Refuse options that would change nothing."""
    for name in _on_command_line(context, ARGUMENTS):
        raise click.UsageError(f"--{name.replace('_', '-')} needs --laws", context)


def refuse_beside_gains(context: click.Context) -> None:
    """Refuse options of a search that does not take place."""
    for name in _on_command_line(context, set(ARGUMENTS) - {"members"}):
        message = f"--{name.replace('_', '-')} cannot be given with --gains: the file says it"
        raise click.UsageError(message, context)


def _on_command_line(context: click.Context, names: Iterable[str]) -> list[str]:
    source = context.get_parameter_source
    return sorted(name for name in names if source(name) is ParameterSource.COMMANDLINE)


def compare_tuned_laws(file: str, plot: Path | None, as_json: bool, wanted: dict[str, Any]) -> None:
    """Tune, measure, print and draw."""
    from certrack.cli import console
    from certrack.core import checks
    from certrack.reports import law_comparison as report
    from certrack.systems.reader import load
    from certrack.tuning.comparison.compare_laws import AS_STATED, compare_laws
    from certrack.tuning.comparison.known_gains import read_gains

    system = load(file)
    context, known = click.get_current_context(), None
    arguments = {ARGUMENTS[name]: wanted[name] for name in ARGUMENTS}
    if wanted["gains_file"] is not None:
        refuse_beside_gains(context)
        known = read_gains(wanted["gains_file"], AS_STATED)
        if not _on_command_line(context, ["members"]):
            arguments["members"] = known.member_count
    listed = ",".join(known.laws) if wanted["laws"] is None and known else wanted["laws"]
    names = [name.strip() for name in listed.split(",")]
    if len(set(names)) < len(names):
        raise InputError("--laws", "names a law twice", wanted["laws"])
    for name in ("peak_input", "variation", "period"):
        if wanted[name] is not None:
            checks.real(f"--{name.replace('_', '-')}", wanted[name], above=0)
    with (
        _laws_named(),
        naming(file, "law", "law.delta0"),
        console.progress("Laws tuned and measured") as bar,
    ):
        result = compare_laws(system, names, **arguments, known=known, progress=bar)
    pictures: list[Path] = []
    if plot is not None:
        from certrack import plotting
        from certrack.plotting.law_comparison import law_comparison_figure

        figure = law_comparison_figure(result, system.title)
        pictures = plotting.save_figure(figure, plot, "laws")
    if as_json:
        click.echo(console.to_json(result.summary()))
    else:
        click.echo(system.title or file)
        console.print_wide_table(report.law_table(result, system.plant.units))
        console.print_lines(report.law_notes(result))
    tell_written(as_json, *pictures)


@contextmanager
def _laws_named() -> Iterator[None]:
    """Name the option in refusals of the laws."""
    try:
        yield
    except InputError as problem:
        if problem.key == "laws":
            problem.key = "--laws"
        raise
