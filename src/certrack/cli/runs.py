"""Verbs that simulate: simulate, compare, ensemble."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.cli.base import FOLDER, diagnose, draw, json_option

if TYPE_CHECKING:
    from certrack.studies.ensembles.ensemble import Ensemble


@click.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="NetCDF file.")
@click.option("--samples", type=click.IntRange(2, 10_000_000), help="Equidistant times in --out.")
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG and SVG).")
@click.option("--integrator", type=click.Choice(["auto", "taylor", "scipy", "implicit"]))
@click.option("--tolerance", type=float, help="Of the integrator, e.g. 1e-9.")
@click.option("--member", type=click.IntRange(0), help="Replay this member of the ensemble.")
@click.option("--seed", type=click.IntRange(0, 2**63), help="Of the ensemble, with --member.")
@click.option(
    "--with-c",
    is_flag=True,
    help="Run the exported C code as the controller; needs [implementation] and a C compiler.",
)
@json_option
def simulate(
    file: str,
    out: Path | None,
    samples: int | None,
    plot: Path | None,
    integrator: str | None,
    tolerance: float | None,
    member: int | None,
    seed: int | None,
    with_c: bool,
    as_json: bool,
) -> None:
    """Simulate one run and measure it.

    \b
    Example: certrack simulate example1 --plot pictures --out run.nc
    """
    from certrack.cli import report
    from certrack.simulation.simulator import Simulator
    from certrack.systems.reader import load

    if samples is not None and out is None:
        raise click.UsageError("--samples needs --out", click.get_current_context())
    if seed is not None and member is None:
        raise click.UsageError("--seed needs --member", click.get_current_context())
    system = load(file)
    if member is not None:
        from certrack.studies.ensembles.members import Members

        system = Members(system, seed or 0).member(member)
    changes = {"integrator": integrator, "tolerance": tolerance}
    system = system.with_settings(**{name: v for name, v in changes.items() if v is not None})
    if with_c:
        from certrack.core.compilers import find_c_compiler
        from certrack.export.c import difference_from_python, simulate_with_c

        run = simulate_with_c(system)
        difference = difference_from_python(run)
        controller = {"controller": "c", "difference_from_python": difference}
    else:
        with report.share_progress("Simulating") as advance:
            run, controller = Simulator(system).run(progress=advance), {"controller": "python"}
    if out is not None:
        run.save(out, samples)
    if plot is not None:
        draw({Path(file).stem: run}, plot, system.title)
    summary = run.summary()
    if as_json:
        click.echo(report.to_json(summary | controller))
    else:
        click.echo(system.title or file)
        report.console().print(report.metrics_table({Path(file).stem: summary}))
        if with_c:
            click.echo(
                f"controller: the exported C, compiled by {Path(find_c_compiler()).name}; "
                f"largest difference of u from Python: {difference:.2g}"
            )
    diagnose(run)


@click.command()
@click.argument("files", nargs=-1, required=True)
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG and SVG).")
@json_option
def compare(files: tuple[str, ...], plot: Path | None, as_json: bool) -> None:
    """Simulate several systems and set their metrics side by side.

    \b
    Example: certrack compare example1 example1-classic
    """
    from certrack.cli import report
    from certrack.simulation.simulator import simulate as run_system
    from certrack.systems.reader import load

    systems = {file: load(file) for file in files}
    runs = {file: run_system(system) for file, system in systems.items()}
    if plot is not None:
        draw(runs, plot, "")
    summaries = {file: run.summary() for file, run in runs.items()}
    if as_json:
        click.echo(report.to_json(summaries))
    else:
        report.console().print(report.metrics_table(summaries))
    for run in runs.values():
        diagnose(run)


@click.command()
@click.argument("file")
@click.option("-n", "--members", type=click.IntRange(1), default=10_000, show_default=True)
@click.option("--seed", type=click.IntRange(0, 2**63), default=0, show_default=True)
@click.option("--out", type=FOLDER, help="Folder for results; a stopped run goes on from it.")
@click.option("--tolerance", type=float, default=1e-6, show_default=True, help="Of the integrator.")
@click.option(
    "--limit",
    type=float,
    help="Of the tail error, in the unit of the output x_1; default: the file's or certified.",
)
@click.option("--threads", type=click.IntRange(1, 1024), help="Default: one per core.")
@click.option("--cluster", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://host:8786.")
@click.option("--keep", type=click.IntRange(0), multiple=True, help="Save this member's full run.")
@json_option
def ensemble(
    file: str,
    members: int,
    seed: int,
    out: Path | None,
    tolerance: float,
    limit: float | None,
    threads: int | None,
    cluster: str | None,
    keep: tuple[int, ...],
    as_json: bool,
) -> None:
    """Simulate many members: plants, starts and disturbances as in the file's [ensemble].

    Without [ensemble], everything within plant.ranges and plant.uncertainty. With --out, quantile
    bands (NetCDF), summary (JSON) and pictures are written there.

    \b
    Example: certrack ensemble example1 -n 10000 --out ensemble
    """
    from contextlib import nullcontext

    from certrack.cli import report
    from certrack.studies.ensembles import workers
    from certrack.studies.ensembles.ensemble import ensemble as run_ensemble
    from certrack.systems.reader import load

    if keep and out is None:
        raise click.UsageError("--keep needs --out", click.get_current_context())
    system = load(file)
    if any(index >= members for index in keep):
        raise click.UsageError("--keep must be below --members", click.get_current_context())
    try:
        with (
            workers.connect(cluster) if cluster is not None else nullcontext() as client,
            report.rate_progress("Members") as advance,
        ):
            found = run_ensemble(
                system,
                members,
                seed=seed,
                tolerance=tolerance,
                limit=limit,
                threads=threads,
                out=out,
                client=client,
                progress=advance,
            )
    except KeyboardInterrupt:
        if out is not None:
            click.echo(f"certrack: {out} keeps what is done; the same command goes on", err=True)
        raise
    summary = found.summary()
    if out is not None:
        _save(found, summary, out, keep)
    if as_json:
        click.echo(report.to_json(summary))
    else:
        click.echo(f"{system.title or file}: {found.members} members, seed {seed}")
        report.console().print(report.ensemble_table(found))
        for line in report.ensemble_notes(found, file):
            click.echo(line)


def _save(found: Ensemble, summary: dict[str, Any], out: Path, keep: tuple[int, ...]) -> None:
    """Bands, summary, pictures and chosen members."""
    from certrack import plotting
    from certrack.cli import report
    from certrack.core.files import write_netcdf, write_text

    write_netcdf(out / "bands.nc", found.dataset())
    write_text(out / "summary.json", report.to_json(summary) + "\n")
    for name, figure in plotting.ensemble_figures(found).items():
        plotting.save_figure(figure, out, name)
    for index in keep:
        found.run(index).save(out / f"member-{index}.nc")
