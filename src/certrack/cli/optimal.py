"""The verb that asks how good any law could be: optimal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from certrack.cli.base import FOLDER, json_option, options_named, tell_written

#: Arguments of certrack.optimal that are options of the verb.
OPTIMAL_OPTIONS = (
    *("objective", "squared_error", "energy", "peak_input", "horizon", "elements", "time_limit"),
)


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option(
    "--objective",
    type=click.Choice(["squared-error", "energy", "peak", "time"]),
    help="What is minimised; default: what the law is judged by, see above.",
)
@click.option("--squared-error", type=float, help="Limit of the integral of e_1^2.")
@click.option("--energy", type=float, help="Limit of the integral of u^2.")
@click.option("--peak-input", type=float, help="Limit of |u|.")
@click.option("--horizon", type=float, help="End of the runs, s; default: the file's duration.")
@click.option(
    "--elements",
    type=int,
    default=960,
    show_default=True,
    help="Elements of the finest mesh at most; the input is a line on each.",
)
@click.option(
    "--time-limit",
    type=float,
    default=300.0,
    show_default=True,
    help="Time of the searches of a file, s; then the last optima found are shown.",
)
@click.option("--plot", type=FOLDER, help="Folder for the pictures of laws and optima.")
@json_option
def optimal(
    files: tuple[str, ...], plot: Path | None, as_json: bool, objective: str | None, **wanted: Any
) -> None:
    """Find how good any law could be: the best trajectory.

    The trajectory is that of the true plant from the file's start, under the file's disturbance,
    which it knows beforehand as it knows the reference. Without --objective the law is judged:
    the least squared error at its own energy and peak, the least energy at its squared error, and
    the least squared error at its peak. Limits that are given take the place of the law's own.

    \b
    Example: certrack optimal dual-motor-lean --horizon 6 --plot pictures
    """
    from certrack.cli import console
    from certrack.reports import optima as optima_report
    from certrack.studies.optimal.optimal import optimal as search_optima
    from certrack.systems.reader import load

    stems = [Path(file).stem for file in files]
    names = [f"{name}-{i}" if stems.count(name) > 1 else name for i, name in enumerate(stems, 1)]
    systems = {name: load(file) for name, file in zip(names, files, strict=True)}
    if objective is not None:
        objective = objective.replace("-", "_")
    results = {}
    for name, system in systems.items():
        with (
            options_named(OPTIMAL_OPTIONS),
            console.progress(f"Optima of {name}, searches", "iterations") as advance,
        ):
            results[name] = search_optima(system, objective, progress=advance, **wanted)
    pictures: list[Path] = []
    if plot is not None:
        from certrack import plotting

        for name, result in results.items():
            figure = plotting.optima_figure(result, systems[name].title)
            pictures += plotting.save_figure(figure, plot, f"optimal-{name}")
    if as_json:
        click.echo(console.to_json({name: result.summary() for name, result in results.items()}))
    else:
        for name, result in results.items():
            console.print_table(optima_report.optima_table(result, systems[name].title or name))
            console.print_lines(optima_report.optima_notes(result))
    tell_written(as_json, *pictures)
    if not all(result.converged for result in results.values()):
        raise click.exceptions.Exit(1)
