"""Options of pictures, and the pictures that verbs write and show."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from certrack.core.errors import InputError

if TYPE_CHECKING:
    from certrack.certificates import Certificates
    from certrack.plotting import Appearance
    from certrack.simulation.run import Run
    from certrack.systems.system import System

#: Parameters of verbs that make pictures.
MAKING = ("plot", "show", "out")


def picture_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--style``, ``--size``, ``--title`` and ``--window``; the verb gets an `appearance`."""

    @wraps(command)
    def with_appearance(
        *arguments: Any,
        style: str | None,
        size: str | None,
        picture_title: str | None,
        window: str | None,
        **options: Any,
    ) -> Any:
        options_of = {
            "--style": style,
            "--size": size,
            "--title": picture_title,
            "--window": window,
        }
        named = [name for name, value in options_of.items() if value is not None]
        if named and not any(options.get(name) for name in MAKING):
            makers = [f"--{name}" for name in MAKING if name in options]
            raise click.UsageError(
                f"{named[0]} needs {' or '.join(makers)}", click.get_current_context()
            )
        appearance = _appearance(style or "page", size, picture_title, window)
        return command(*arguments, appearance=appearance, **options)

    for option in (
        click.option(
            "--window", metavar="FROM,TO", help="Times that the pictures show, s, e.g. 0,2."
        ),
        click.option(
            "--title", "picture_title", help="Title of the pictures; default: the file's."
        ),
        click.option("--size", metavar="W,H", help="Size of the pictures in inches, e.g. 3.5,2.4."),
        click.option(
            "--style",
            type=click.Choice(["page", "paper", "slides"]),
            help="Pictures for a page (default), for one column of a paper, for slides.",
        ),
    ):
        with_appearance = option(with_appearance)
    return with_appearance


def _appearance(style: str, size: str | None, title: str | None, window: str | None) -> Appearance:
    from certrack.plotting import Appearance

    return Appearance(style, _pair("--size", size), title, _pair("--window", window, rising=True))


def _pair(name: str, text: str | None, *, rising: bool = False) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        first, second = map(float, text.split(","))
    except ValueError:
        raise InputError(name, "must be two numbers with a comma between", text) from None
    if rising and not 0 <= first < second:
        raise InputError(name, "must be two times, the first less than the second", text)
    if not rising and not (0 < first <= MOST_INCHES and 0 < second <= MOST_INCHES):
        raise InputError(name, f"must be above 0 and at most {MOST_INCHES} inches", text)
    return first, second


#: A larger picture has more dots than a renderer holds.
MOST_INCHES = 50


def draw(
    runs: dict[str, Run],
    folder: Path,
    title: str,
    appearance: Appearance,
    certified: Mapping[str, Certificates] | None = None,
) -> list[Path]:
    """Write every panel as a picture of its own, and all of them together; returns the paths."""
    from certrack import plotting

    paths: list[Path] = []
    for name, panel in plotting.panels_for(runs, certified).items():
        drawing = plotting.figure(panel, runs, title, appearance)
        paths += plotting.save_figure(drawing, folder, name)
    drawing = plotting.overview(runs, title, appearance, certified)
    return paths + plotting.save_figure(drawing, folder, "overview")


def certified_runs(systems: Mapping[str, System]) -> dict[str, Certificates]:
    """The certificates of systems, for the pictures of their runs."""
    from certrack.certificates import certify
    from certrack.cli import console

    certificates = {}
    for name, system in systems.items():
        with console.progress("Certifying, steps", "bound") as advance:
            certificates[name] = certify(system, "fast", advance)
    return certificates


def show_runs(
    runs: dict[str, Run],
    title: str,
    appearance: Appearance,
    certified: Mapping[str, Certificates] | None = None,
) -> None:
    """Open a window with all panels; a note where there is none."""
    from certrack import plotting

    if reason := plotting.show([plotting.overview(runs, title, appearance, certified)]):
        click.echo(f"certrack: note: no window: {reason}; --plot DIR writes files", err=True)
