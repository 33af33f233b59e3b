"""Command line. Each verb loads, computes, prints; the work is done elsewhere.

Results go to standard output (``--json`` for programs), diagnostics to standard error. Exit code 0
means success, 2 bad input with one line that says what is wrong, 1 a run that did not finish.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.errors import CertrackError, one_line

if TYPE_CHECKING:
    from certrack.run import Run
    from certrack.system import System

FOLDER = click.Path(path_type=Path, file_okay=False)


def _json_option(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")(command)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="certrack")
def cli() -> None:
    """Design, certify, simulate and deploy tracking controllers for uncertain nonlinear systems.

    FILE is a system file (TOML) or the name of a shipped system, see `certrack list`.

    \b
    Example: certrack simulate example1
    """


@cli.command("list")
@_json_option
def list_systems(as_json: bool) -> None:
    """List the shipped systems.

    \b
    Example: certrack list
    """
    from certrack import report
    from certrack.systemfile import catalog

    systems = catalog()
    if as_json:
        click.echo(report.to_json(systems))
    else:
        report.console().print(report.table("", ["name", "title"], list(systems.items())))


@cli.command()
@click.argument("name", type=click.Path(path_type=Path, dir_okay=False))
@_json_option
def new(name: Path, as_json: bool) -> None:
    """Write a commented starter system file NAME.

    \b
    Example: certrack new drive.toml
    """
    from certrack import report
    from certrack.systemfile import starter
    from certrack.systemtext import write_text

    if not name.name:
        raise click.UsageError("NAME must be a file name", click.get_current_context())
    path = name if name.suffix else name.with_suffix(".toml")
    write_text(path, starter(), overwrite=False)
    if as_json:
        click.echo(report.to_json({"file": str(path)}))
    else:
        click.echo(f"{path} written. Next: certrack simulate {path}")


@cli.command()
@click.argument("file")
@click.option("--latex", is_flag=True, help="Print the formulas as a LaTeX align* environment.")
@_json_option
def design(file: str, latex: bool, as_json: bool) -> None:
    """Design the controller: error coordinates, virtual controls, control law.

    \b
    Example: certrack design dual-motor --latex
    """
    from certrack import formulas, report
    from certrack.systemfile import load

    system = load(file)
    if latex and not as_json:
        click.echo(formulas.as_latex(system))
        return
    found = system.controller.coordinates
    if as_json:
        poles = sorted(found.poles, key=lambda pole: (pole.real, pole.imag))
        values = {
            "A": found.A,
            "B": found.B if found.q else found.B[:, 0],
            "kappa": found.kappa,
            "eta": found.eta,
            "d": found.d if found.q else found.d[:, 0],
            "R": found.R,
            "nu_x": found.nu_x,
            "nu_Y": found.nu_Y,
            "feedforward": found.q,
            "error_poles": [[pole.real, pole.imag] for pole in poles],
            "law": formulas.as_text(system),
            "latex": formulas.as_latex(system),
        }
        click.echo(report.to_json(values))
        return
    click.echo(f"{system.title or file}: {system.law.kind} law, feed-forward order {found.q}\n")
    click.echo("\n".join(formulas.as_text(system)))
    damping = ", ".join(f"{value:.6g}" for value in found.kappa)
    click.echo(f"\nkappa = ({damping}) 1/s; fastest error pole {found.fastest_pole:.4g} 1/s")


@cli.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="NetCDF file.")
@click.option("--samples", type=click.IntRange(2, 10_000_000), help="Equidistant times in --out.")
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG and SVG).")
@click.option("--integrator", type=click.Choice(["auto", "taylor", "scipy", "implicit"]))
@click.option("--tolerance", type=float, help="Of the integrator, e.g. 1e-9.")
@_json_option
def simulate(
    file: str,
    out: Path | None,
    samples: int | None,
    plot: Path | None,
    integrator: str | None,
    tolerance: float | None,
    as_json: bool,
) -> None:
    """Simulate one run and measure it.

    \b
    Example: certrack simulate example1 --plot pictures --out run.nc
    """
    from certrack import report
    from certrack.simulation import simulate as run_system
    from certrack.systemfile import load

    if samples is not None and out is None:
        raise click.UsageError("--samples needs --out", click.get_current_context())
    system = load(file)
    changes = {"integrator": integrator, "tolerance": tolerance}
    run = run_system(system, **{name: v for name, v in changes.items() if v is not None})
    if out is not None:
        run.save(out, samples)
    if plot is not None:
        _draw({Path(file).stem: run}, plot, system.title)
    summary = run.summary()
    if as_json:
        click.echo(report.to_json(summary))
    else:
        click.echo(system.title or file)
        report.console().print(report.metrics_table({Path(file).stem: summary}))
    _diagnose(run)


@cli.command()
@click.argument("files", nargs=-1, required=True)
@click.option("--plot", type=FOLDER, help="Folder for pictures (PNG and SVG).")
@_json_option
def compare(files: tuple[str, ...], plot: Path | None, as_json: bool) -> None:
    """Simulate several systems and set their metrics side by side.

    \b
    Example: certrack compare example1 example1-classic
    """
    from certrack import report
    from certrack.simulation import simulate as run_system
    from certrack.systemfile import load

    systems = {file: load(file) for file in files}
    runs = {file: run_system(system) for file, system in systems.items()}
    if plot is not None:
        _draw(runs, plot, "")
    summaries = {file: run.summary() for file, run in runs.items()}
    if as_json:
        click.echo(report.to_json(summaries))
    else:
        report.console().print(report.metrics_table(summaries))
    for run in runs.values():
        _diagnose(run)


@cli.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Certificate (JSON).")
@click.option("--plot", type=FOLDER, help="Folder for the picture of the tube over the response.")
@_json_option
def certify(file: str, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Certify: guaranteed bounds on the tracking error, exactly verified.

    Exit code 1 if no certificate exists or none was found.

    \b
    Example: certrack certify dual-motor-lean --out cert.json
    """
    from certrack import certificates, report
    from certrack.systemfile import load

    system = load(file)
    _note_violations(system)
    found = certificates.certify(system)
    if out is not None and found.stages:
        certificates.save_certificate(system, found.stages, out)
    if plot is not None and found.tube is not None:
        from certrack import plotting
        from certrack.simulation import simulate as run_system

        run = run_system(system)
        plotting.save_figure(plotting.tube_figure(run, found.tube, system.title), plot, "tube")
    if as_json:
        click.echo(report.to_json(report.certificates_summary(found)))
    else:
        click.echo(system.title or file)
        report.console().print(report.certificates_table(found))
        for line in report.certificates_notes(found):
            click.echo(line)
    if not found.best.exists:
        click.echo(f"certrack: no certificate: {found.semidefinite.reason}", err=True)
        raise click.exceptions.Exit(1)


@cli.command()
@click.argument("certificate", type=click.Path(path_type=Path))
@_json_option
def verify(certificate: Path, as_json: bool) -> None:
    """Check a saved certificate in exact arithmetic; no solver is used.

    Exit code 1 if it does not hold.

    \b
    Example: certrack verify cert.json
    """
    from certrack import certificates, report

    found = certificates.verify(certificate)
    if as_json:
        from dataclasses import asdict

        click.echo(report.to_json(asdict(found)))
    elif found.verified:
        click.echo(f"verified: limsup |e_1| <= {float(found.bound):.6g}, resting on")
        click.echo("\n".join(f"  {line}" for line in found.assumptions))
    if not found.verified:
        click.echo(f"certrack: {certificate}: not verified: {found.reason}", err=True)
        raise click.exceptions.Exit(1)


@cli.command()
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Worst case (TOML).")
@click.option("--budget", type=click.IntRange(100), default=6000, show_default=True, help="Runs.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@_json_option
def falsify(file: str, out: Path | None, budget: int, seed: int, as_json: bool) -> None:
    """Search the worst admissible disturbance, reference and parameters.

    The ratio tells how tight the certificate is: certified bound over worst error found.

    \b
    Example: certrack falsify example1 --out worst.toml
    """
    from certrack import falsify as falsifier
    from certrack import report
    from certrack.certificates import best_sound_bound
    from certrack.systemfile import load
    from certrack.systemtext import save

    system = load(file)
    _note_violations(system)
    with report.progress("Searching", budget) as advance:
        found = falsifier.falsify(system, budget=budget, seed=seed, progress=advance)
    if out is not None:
        save(found.system, out)
    certified = best_sound_bound(system)
    values = {
        "worst_error": found.worst_error,
        "certified": certified,
        "ratio": certified / found.worst_error if found.worst_error else None,
        "runs": found.evaluations,
        "seed": seed,
        "file": None if out is None else str(out),
    }
    if as_json:
        click.echo(report.to_json(values))
    else:
        click.echo(f"worst |e_1| found in {found.evaluations} runs: {found.worst_error:.6g}")
        click.echo(f"certified limsup |e_1|: {certified:.6g}")
        click.echo(f"certified / found: {certified / found.worst_error:.3g}")
        if out is not None:
            click.echo(f"{out} replays it: certrack simulate {out}")


@cli.command()
@click.option("--out", type=FOLDER, default=Path("reproduction"), show_default=True)
@_json_option
def reproduce(out: Path, as_json: bool) -> None:
    """Reproduce the paper: Figures 2 to 4, and every claim beside what is measured.

    \b
    Example: certrack reproduce --out reproduction
    """
    from dataclasses import asdict

    from certrack import report
    from certrack.papers import liu2025
    from certrack.plotting import save_figure

    log = report.console(error=True)
    with log.status("Reproducing") as status:
        found = liu2025.reproduce(status.update)
        for name, figure in found.figures.items():
            status.update(f"Writing {name}")
            save_figure(figure, out, name)
    summaries = {name: run.summary() for name, run in found.runs.items()}
    values = {
        "claims": [asdict(claim) for claim in found.claims],
        "runs": summaries,
        "bounds": found.bounds,
        "figures": [str(out / f"{name}.png") for name in found.figures],
    }
    if as_json:
        click.echo(report.to_json(values))
        return
    rows = [[c.where, c.statement, c.measured, c.verdict] for c in found.claims]
    console = report.console()
    console.print(report.metrics_table(summaries))
    bounds = [[name, *entry.values()] for name, entry in found.bounds.items()]
    columns = ["limsup |e_1|", *next(iter(found.bounds.values()))]
    console.print(report.table("Certified, falsified and simulated error", columns, bounds))
    console.print(report.table("Claims", ["where", "claim", "measured", "verdict"], rows))
    click.echo(f"{len(found.figures)} figures (PNG and SVG) in {out}")


def _note_violations(system: System) -> None:
    """Say where the file's omega breaks Assumption 1: no certificate covers such a run."""
    from certrack.assumption import check_assumption_1

    for violation in check_assumption_1(system):
        click.echo(f"certrack: note: {violation}", err=True)


def _draw(runs: dict[str, Run], folder: Path, title: str) -> None:
    """Every panel, and all of them together."""
    from certrack import plotting

    for name, panel in plotting.panels_for(runs).items():
        plotting.save_figure(plotting.figure(panel, runs, title), folder, name)
    plotting.save_figure(plotting.overview(runs, title), folder, "overview")


def _diagnose(run: Run) -> None:
    """Notes to standard error; exit code 1 for a run that did not finish."""
    for note in run.notes:
        click.echo(f"certrack: note: {note}", err=True)
    if run.outcome.name != "finished":
        t = run.trajectory.end
        click.echo(f"certrack: stopped at t = {t:.6g} s: {run.outcome.value}", err=True)
        raise click.exceptions.Exit(1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the ``certrack`` command."""
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        sys.exit(_run(arguments))


def _run(arguments: Sequence[str] | None) -> int:
    try:
        code = cli.main(
            args=None if arguments is None else list(arguments),
            prog_name="certrack",
            standalone_mode=False,
        )
    except CertrackError as problem:
        click.echo(f"certrack: {problem}", err=True)
        return 2
    except click.exceptions.NoArgsIsHelpError as problem:
        click.echo(problem.format_message(), err=True)
        return 2
    except click.UsageError as problem:
        where = f" (see {problem.ctx.command_path} --help)" if problem.ctx else ""
        click.echo(f"certrack: {one_line(problem.format_message())}{where}", err=True)
        return 2
    except (click.Abort, KeyboardInterrupt):
        click.echo("certrack: interrupted", err=True)
        return 130
    except BrokenPipeError:  # the reader of our output went away
        sys.stderr.close()
        return 1
    return code if isinstance(code, int) else 0


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    click.echo(f"certrack: note: {message}", err=True)
