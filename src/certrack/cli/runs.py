"""Verbs that simulate: simulate, compare, ensemble."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.cli.base import (
    FOLDER,
    MEMBER_SEED,
    NEW_FILE,
    diagnose,
    json_option,
    naming,
    note_engine,
    note_unlikely,
    tell_written,
)
from certrack.cli.laws import compare_tuned_laws, law_options, refuse_without_laws
from certrack.cli.pictures import certified_runs, draw, picture_options, show_runs
from certrack.cli.premises import note_contradictions

if TYPE_CHECKING:
    from certrack.plotting import Appearance
    from certrack.studies.ensembles.ensemble import Ensemble


@click.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, help="NetCDF file for the run.")
@click.option(
    "--samples",
    type=click.IntRange(2, 10_000_000),
    help="Equidistant times in --out; default: the integrator's own steps, subdivided.",
)
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG, SVG and PDF).")
@click.option(
    "--integrator",
    type=click.Choice(["auto", "taylor", "scipy", "implicit"]),
    help="Method; default: the file's.",
)
@click.option(
    "--tolerance", type=float, help="Tolerance of the integrator, e.g. 1e-9; default: the file's."
)
@click.option("--member", type=click.IntRange(0), help="Replay this member of the ensemble.")
@click.option("--corner", type=click.IntRange(0), help="Replay this corner of plant.ranges.")
@click.option(
    "--seed",
    type=MEMBER_SEED,
    help="Seed of the ensemble, with --member or --corner; default: 0.",
)
@click.option(
    "--with-c",
    is_flag=True,
    help="Run the exported C code as the controller; needs [implementation] and a C compiler.",
)
@click.option("--show", "in_window", is_flag=True, help="Show the pictures in a window.")
@click.option(
    "--certify",
    "with_bound",
    is_flag=True,
    help="Certify first, and draw the bound and the tube beside the error.",
)
@picture_options
@json_option
def simulate(
    file: str,
    out: Path | None,
    samples: int | None,
    plot: Path | None,
    integrator: str | None,
    tolerance: float | None,
    member: int | None,
    corner: int | None,
    seed: int | None,
    with_c: bool,
    in_window: bool,
    with_bound: bool,
    appearance: Appearance,
    as_json: bool,
) -> None:
    """Simulate one run and print its metrics.

    \b
    Example: certrack simulate example1 --plot pictures --out run.nc
    """
    from certrack.cli import console
    from certrack.reports import runs as run_report
    from certrack.simulation.simulator import Simulator
    from certrack.systems.reader import load

    if samples is not None and out is None:
        raise click.UsageError("--samples needs --out", click.get_current_context())
    if seed is not None and member is None and corner is None:
        raise click.UsageError("--seed needs --member or --corner", click.get_current_context())
    if member is not None and corner is not None:
        raise click.UsageError("--member or --corner, not both", click.get_current_context())
    if with_bound and plot is None and not in_window:
        raise click.UsageError("--certify needs --plot or --show", click.get_current_context())
    system = load(file)
    if member is not None:
        from certrack.studies.ensembles.members import member as member_of

        system = member_of(system, member, seed=seed or 0)
    if corner is not None:
        from certrack.studies.ensembles.members import Members

        system = Members(system, seed or 0).corner(corner)
    note_contradictions(system, file)
    changes = {"integrator": integrator, "tolerance": tolerance}
    system = system.with_settings(**{name: v for name, v in changes.items() if v is not None})
    if with_c:
        from certrack.core.compilers import find_c_compiler
        from certrack.export.c import difference_from_python, simulate_with_c

        with naming(file, "implementation"):
            run = simulate_with_c(system)
        difference = difference_from_python(run)
        controller = {"controller": "c", "difference_from_python": difference}
    else:
        with console.progress("Simulating, s") as advance:
            run, controller = Simulator(system).run(progress=advance), {"controller": "python"}
    if out is not None:
        run.save(out, samples)
    runs = {Path(file).stem: run}
    certified = certified_runs({Path(file).stem: system}) if with_bound else None
    pictures = [] if plot is None else draw(runs, plot, system.title, appearance, certified)
    summary = run.summary()
    if as_json:
        click.echo(console.to_json(summary | controller))
    else:
        click.echo(system.title or file)
        units = system.plant.units
        console.print_wide_table(run_report.metrics_table({Path(file).stem: summary}, units))
        if summary["moves"]:
            console.print_table(run_report.moves_table(summary["moves"], units))
        if with_c:
            click.echo(
                f"controller: the exported C, compiled by {Path(find_c_compiler()).name}; "
                f"largest difference of u from Python: {difference:.2g}"
            )
    tell_written(as_json, *([] if out is None else [out]))
    tell_written(as_json, *pictures)
    if in_window:
        show_runs(runs, system.title, appearance, certified)
    diagnose({file: run})


@click.command()
@click.argument("files", nargs=-1, required=True)
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG, SVG and PDF).")
@click.option(
    "--certify",
    "with_bound",
    is_flag=True,
    help="Certify first, and draw the bounds and the tubes beside the errors.",
)
@law_options
@picture_options
@json_option
def compare(
    files: tuple[str, ...],
    plot: Path | None,
    with_bound: bool,
    appearance: Appearance,
    as_json: bool,
    **wanted: Any,
) -> None:
    """Simulate several systems and print their metrics side by side.

    With --laws, one system is given each of these laws in turn: the same search chooses the gains
    of each, within the same limits, and all are measured alike, sampled as the file says.

    \b
    Example: certrack compare example1 example1-classic
             certrack compare dual-motor-lean --laws lean,lqr,smc --plot pictures
             certrack compare example1 --gains gains.json
    """
    if wanted["laws"] is not None or wanted["gains_file"] is not None:
        if len(files) != 1 or with_bound:
            option = "--gains" if wanted["laws"] is None else "--laws"
            problem = f"{option} needs one FILE, and certifies by itself"
            raise click.UsageError(problem, click.get_current_context())
        compare_tuned_laws(files[0], plot, as_json, wanted)
        return
    refuse_without_laws(click.get_current_context())
    from certrack.cli import console
    from certrack.reports import runs as run_report
    from certrack.simulation.simulator import simulate as run_system
    from certrack.systems.reader import load

    if with_bound and plot is None:
        raise click.UsageError("--certify needs --plot", click.get_current_context())
    systems = {file: load(file) for file in files}
    for file, system in systems.items():
        note_contradictions(system, file)
    runs = {file: run_system(system) for file, system in systems.items()}
    certified = certified_runs(systems) if with_bound else None
    pictures = [] if plot is None else draw(runs, plot, "", appearance, certified)
    summaries = {file: run.summary() for file, run in runs.items()}
    if as_json:
        click.echo(console.to_json(summaries))
    else:
        units = run_report.shared_units(system.plant.units for system in systems.values())
        console.print_wide_table(run_report.metrics_table(summaries, units))
    tell_written(as_json, *pictures)
    diagnose(runs)


@click.command()
@click.argument("file")
@click.option(
    "-n",
    "--members",
    type=click.IntRange(1),
    default=10_000,
    show_default=True,
    help="Number of members.",
)
@click.option(
    "--seed",
    type=MEMBER_SEED,
    default=0,
    show_default=True,
    help="A member depends on the file, this seed and its own number only.",
)
@click.option("--out", type=FOLDER, help="Folder for results; a stopped run goes on from it.")
@click.option(
    "--tolerance",
    type=float,
    default=1e-6,
    show_default=True,
    help="Tolerance of the integrator.",
)
@click.option(
    "--limit",
    type=float,
    help="Limit of the tail error, in the unit of the output x_1; default: the file's, or else "
    "the certified bound.",
)
@click.option(
    "--threads", type=click.IntRange(1, 1024), help="Number of threads; default: one per core."
)
@click.option(
    "--cluster", metavar="ADDRESS", help="Address of a Dask scheduler, e.g. tcp://host:8786."
)
@click.option(
    "--keep",
    type=click.IntRange(0),
    multiple=True,
    help="Save the full run of this member in --out; may be repeated.",
)
@picture_options
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
    appearance: Appearance,
    as_json: bool,
) -> None:
    """Simulate many random members: plants, starts and disturbances.

    They are drawn as the file's [ensemble] says; without it, within plant.ranges and
    plant.uncertainty. The corners of up to 6 ranges run besides. With --out,
    quantile bands (NetCDF), the summary (JSON) and pictures are written there.

    \b
    Example: certrack ensemble example1 -n 10000 --out ensemble
    """
    from contextlib import nullcontext

    from certrack.cli import console
    from certrack.reports import runs as run_report
    from certrack.studies.ensembles import workers
    from certrack.studies.ensembles.all_lost import AllMembersLost
    from certrack.studies.ensembles.ensemble import ensemble as run_ensemble
    from certrack.studies.ensembles.error_limit import limit_and_starts
    from certrack.systems.reader import load

    if keep and out is None:
        raise click.UsageError("--keep needs --out", click.get_current_context())
    system = load(file)
    if any(index >= members for index in keep):
        raise click.UsageError("--keep must be below --members", click.get_current_context())
    note_contradictions(system, file, replaced=system.varied.disturbance != "file")
    note_unlikely(system)
    note_engine(alone=system.implementation is None)
    with console.progress("Certifying the limit of the tail error"):
        limit_and_starts(system, limit)  # it is remembered
    try:
        with (
            workers.connect(cluster) if cluster is not None else nullcontext() as client,
            console.rate_progress("Members") as advance,
        ):
            result = run_ensemble(
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
    except AllMembersLost as problem:
        click.echo(f"certrack: {problem}", err=True)
        raise click.exceptions.Exit(1) from None
    except KeyboardInterrupt:
        if out is not None:
            click.echo(f"certrack: {out} keeps what is done; the same command goes on", err=True)
        raise
    summary = result.summary()
    written = [] if out is None else _save_ensemble(result, summary, out, keep, appearance)
    if as_json:
        click.echo(console.to_json(summary))
    else:
        click.echo(f"{system.title or file}: {result.members} members, seed {seed}")
        console.print_table(run_report.ensemble_table(result))
        console.print_lines(run_report.ensemble_notes(result, file))
    tell_written(as_json, *written)


def _save_ensemble(
    ensemble: Ensemble,
    summary: dict[str, Any],
    out: Path,
    keep: tuple[int, ...],
    appearance: Appearance,
) -> list[Path]:
    """Bands, summary, pictures and chosen members; returns the paths."""
    from certrack import plotting
    from certrack.cli import console
    from certrack.core.files import write_netcdf, write_text

    paths = [out / "bands.nc", out / "summary.json"]
    write_netcdf(paths[0], ensemble.dataset())
    write_text(paths[1], console.to_json(summary) + "\n")
    for name, figure in plotting.ensemble_figures(ensemble, appearance).items():
        paths += plotting.save_figure(figure, out, name)
    for index in keep:
        paths.append(out / f"member-{index}.nc")
        ensemble.run(index).save(paths[-1])
    return paths
