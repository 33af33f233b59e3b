"""What a long call says of itself where no terminal shows a bar: a line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from certrack.core.progress import Progress

#: Seconds from line to line: a log of an hour has a few pages of them.
SECONDS_BETWEEN_LINES = 10.0


@contextmanager
def progress_lines(
    what: str, extreme: str, then: str = "", at: Callable[[float], str] | None = None
) -> Iterator[Progress]:
    """Lines on standard error; yields the `progress` of a long call.

    They come also while nothing is reported, so that a long step is seen to be at work.

    Parameters
    ----------
    what, extreme : str
        What is counted, and what the extreme is called that is looked for.
    then : str
        What goes on when all is counted.
    at : callable, optional
        Names what is at work when so much is done.
    """
    begin, over = time.monotonic(), Event()
    news: tuple[float, float | None, float | None] = 0.0, None, None

    def take(done: float, total: float | None, best: float | None, /) -> None:
        nonlocal news
        news = done, total, best

    def tell() -> None:
        while not over.wait(SECONDS_BETWEEN_LINES):
            line = progress_line(what, extreme, working(then, at, *news[:2]), *news)
            with suppress(OSError, ValueError):  # whoever read it went away
                click.echo(f"certrack: {line}, after {time.monotonic() - begin:.0f} s", err=True)

    thread = Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield take
    finally:
        over.set()
        thread.join()


def working(then: str, at: Callable[[float], str] | None, done: float, total: float | None) -> str:
    """What is at work when so much is done; empty where nothing is to be said of it.

    Parameters
    ----------
    then : str
        What goes on when all is counted.
    at : callable or None
        Names what is at work before.
    done : float
    total : float or None

    Returns
    -------
    str

    Examples
    --------
    >>> working("now finished", None, 2, 2), working("", "step {}".format, 1, 2)
    ('now finished', 'step 1')
    """
    if total is not None and done >= total:
        return then
    return "" if at is None else at(done)


def progress_line(
    what: str, extreme: str, now: str, done: float, total: float | None, best: float | None
) -> str:
    """What is done, of how much, the extreme so far, and what is at work.

    >>> progress_line("Tuning, starts", "best", "", 1, 8, 0.0123)
    'Tuning, starts 1 of 8, best 0.0123'
    >>> progress_line("Search over, step", "bound", "falsifier", 7, 20, None)
    'Search over, step 7 of 20, falsifier'
    """
    parts = [f"{what} {done:.4g}" + ("" if total is None else f" of {total:.4g}")]
    if best is not None:
        parts.append(f"{extreme} {best:.4g}")
    return ", ".join([*parts, *filter(None, [now])])
