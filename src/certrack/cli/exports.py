"""Verbs that hand the controller to other tools: export c, st, fmu."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.cli.base import (
    FOLDER,
    NEW_FILE,
    json_option,
    naming,
    note_unlikely,
    period_option,
)
from certrack.core.errors import InputError

if TYPE_CHECKING:
    from certrack.export.monitor import Monitor
    from certrack.systems.system import System

#: Fields of a monitor -> the options that fill them, with what they do.
MONITOR_OPTIONS = {
    "limit_reference": ("--limit-reference", "With --monitor: limit y_d^(i) to its bound."),
    "parameters": ("--parameters", "With --monitor: gains may be changed at run time."),
}


def monitor_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--monitor`` and what goes with it; the command gets a `monitor`, or None."""

    @wraps(command)
    def with_monitor(
        *arguments: Any,
        monitor: bool,
        box: tuple[tuple[str, str, str], ...],
        certificate: Path | None,
        certify: bool,
        **options: Any,
    ) -> Any:
        requested = {name: options.pop(name) for name in MONITOR_OPTIONS}
        _with_monitor(monitor, box, certificate, certify, requested)
        proven: list[tuple[str, Any]] = []
        if certificate is not None or certify:
            proven = _proven(options["file"], options["period"], certificate)
        watching = _monitor(monitor, box, proven, requested)
        return command(*arguments, monitor=watching, **options)

    for name, (flag, text) in reversed(MONITOR_OPTIONS.items()):
        with_monitor = click.option(flag, name, is_flag=True, help=text)(with_monitor)
    with_monitor = click.option(
        "--box",
        nargs=3,
        multiple=True,
        metavar="STATE LOW HIGH",
        help="With --monitor: bounds of a state; may be repeated.",
    )(with_monitor)
    with_monitor = click.option(
        "--certificate",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="With --monitor: the box of states that this saved certificate proves.",
    )(with_monitor)
    with_monitor = click.option(
        "--certify",
        is_flag=True,
        help="With --monitor: the box of states that is proven, certified anew.",
    )(with_monitor)
    text = "Add enable, resets, and flags for the premises of the certificate."
    return click.option("--monitor", is_flag=True, help=text)(with_monitor)


def _with_monitor(
    asked: bool,
    box: tuple[tuple[str, str, str], ...],
    certificate: Path | None,
    certify: bool,
    requested: dict[str, bool],
) -> None:
    """Refuse options that go with --monitor only, and two sources of one box."""
    used = {"--box": box, "--certificate": certificate is not None, "--certify": certify}
    used |= {MONITOR_OPTIONS[name][0]: value for name, value in requested.items()}
    if not asked and (alone := [name for name, value in used.items() if value]):
        raise InputError(alone[0], "goes with --monitor", remedy="Add --monitor")
    if certificate is not None and certify:
        raise InputError("--certify", "does not go with --certificate", remedy="Leave one out")


def _proven(file: str, period: float | None, certificate: Path | None) -> list[tuple[str, Any]]:
    """The proven box of a system, by name."""
    from certrack.export.program import sampled_system
    from certrack.export.proven_box import proven_box
    from certrack.systems.reader import load

    system = load(file)
    if period is not None or system.implementation is None:
        system = sampled_system(system, period)
    return list(proven_box(system, certificate).items())


def _monitor(
    asked: bool,
    box: tuple[tuple[str, str, str], ...],
    proven: list[tuple[str, Any]],
    requested: dict[str, bool],
) -> Monitor | None:
    """The monitor; a box of the user goes before the proven one of the same state."""
    from certrack.export.monitor import Monitor

    if not asked:
        return None
    stated = {state for state, *_ in box}
    entries = [(state, ends) for state, *ends in box]
    entries += [(state, ends) for state, ends in proven if state not in stated]
    with _named_as_options():
        return Monitor(box=entries, **requested)


@contextmanager
def _named_as_options() -> Iterator[None]:
    """Refusals of the box under the name of its option."""
    try:
        yield
    except InputError as problem:
        problem.key = problem.key.replace("monitor.box.", "--box ").replace("monitor.box", "--box")
        raise


@click.group()
def export() -> None:
    """Write the controller for other tools: C, Structured Text, FMU.

    \b
    Example: certrack export c example1 --period 0.001 --out firmware
    """


@export.command()
@click.argument("file")
@click.option("--out", type=FOLDER, required=True, help="Folder for the files.")
@click.option(
    "--real",
    type=click.Choice(["double", "float"]),
    default="double",
    show_default=True,
    help="Type of the numbers.",
)
@monitor_options
@period_option
@json_option
def c(
    file: str,
    out: Path,
    real: str,
    period: float | None,
    monitor: Monitor | None,
    as_json: bool,
) -> None:
    """Write the controller in C99, with its acceptance test.

    \b
    Example: certrack export c example1 --period 0.001 --real float --out firmware
    """
    from certrack.cli import console
    from certrack.export.c import export_c
    from certrack.systems.reader import load

    with naming(file, "implementation", period=period), _named_as_options():
        exported = export_c(load(file), out, file, real=real, period=period, monitor=monitor)
    for note in exported.notes:
        click.echo(f"certrack: note: {note}", err=True)
    if as_json:
        values = {"name": exported.name, "files": [str(path) for path in exported.files]}
        click.echo(console.to_json(values | {"notes": exported.notes}))
        return
    for path in exported.files:
        click.echo(f"{path} written")
    click.echo(f"Next: cd {out} && gcc {exported.name}.c {exported.name}_test.c -lm && ./a.out")


@export.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, required=True, help="NAME.st; NAME names the block.")
@monitor_options
@period_option
@json_option
def st(file: str, out: Path, period: float | None, monitor: Monitor | None, as_json: bool) -> None:
    """Write the controller as a block in Structured Text.

    The file holds one function block as in IEC 61131-3.

    \b
    Example: certrack export st dual-motor-lean --period 0.001 --out drive.st
    """
    from certrack.export.st import export_st
    from certrack.systems.reader import load

    system = load(file)
    with naming(file, "implementation", period=period), _named_as_options():
        export_st(system, out, period=period, monitor=monitor)
    _note_unlikely(system, period)
    _report_file(out, as_json)


@export.command()
@click.argument("file")
@click.option("--out", type=NEW_FILE, required=True, help="NAME.fmu; NAME names the model.")
@click.option(
    "--fmi",
    type=click.Choice(["2", "3"]),
    default="2",
    show_default=True,
    help="Version of the FMI standard.",
)
@monitor_options
@period_option
@json_option
def fmu(
    file: str,
    out: Path,
    fmi: str,
    period: float | None,
    monitor: Monitor | None,
    as_json: bool,
) -> None:
    """Write the controller as an FMU for co-simulation.

    It holds the sources and a binary for this machine.

    \b
    Example: certrack export fmu dual-motor-lean --fmi 3 --period 0.001 --out drive.fmu
    """
    from certrack.export.fmu import export_fmu
    from certrack.systems.reader import load

    system = load(file)
    with naming(file, "implementation", period=period), _named_as_options():
        export_fmu(system, out, version=fmi, period=period, monitor=monitor)
    _note_unlikely(system, period)
    _report_file(out, as_json)


def _note_unlikely(system: System, period: float | None) -> None:
    """What the C export says in its notes."""
    from certrack.export.program import sampled_system

    note_unlikely(sampled_system(system, period))


def _report_file(out: Path, as_json: bool) -> None:
    """Say what was written."""
    from certrack.cli import console

    click.echo(console.to_json({"file": str(out)}) if as_json else f"{out} written")
