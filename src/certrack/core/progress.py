"""How a long call reports what it has done, and how another thread stops it.

Every long call takes ``progress``, which it calls from time to time as ``progress(done, total,
best)``. An exception that this call raises ends the work: results in memory are dropped, a file
that was being written does not appear, and chunks of an ensemble that were finished stay.
"""

from __future__ import annotations

from threading import Event
from typing import Protocol

from certrack.core.errors import Cancelled

#: Argument of a KeyboardInterrupt where the process is to end at once: what a search has is kept,
#: and nothing is measured any more.
AT_ONCE = "at once"


class Progress(Protocol):
    """What is called while a long call works."""

    def __call__(self, done: float, total: float | None, best: float | None, /) -> None:
        """Take the news.

        Parameters
        ----------
        done : float
            Work done so far: seconds of a run, members of an ensemble, runs of a search.
        total : float, optional
            All of it; None where it is not known beforehand.
        best : float, optional
            The extreme value found so far, of a call that searches for one.
        """


def silent(done: float, total: float | None, best: float | None, /) -> None:
    """Report nothing."""


class Cancellable:
    """A `progress` by which another thread stops the call.

    Parameters
    ----------
    progress : callable, optional
        Gets the reports, as ``progress(done, total, best)``.

    Examples
    --------
    >>> import certrack
    >>> stop = certrack.Cancellable()
    >>> stop.cancel()  # usually from another thread, while the call works
    >>> certrack.simulate(certrack.load("example1"), progress=stop)
    Traceback (most recent call last):
        ...
    certrack.core.errors.Cancelled: cancelled before the call was done
    """

    def __init__(self, progress: Progress = silent) -> None:
        self._progress, self._stop = progress, Event()

    def cancel(self) -> None:
        """Let the call end, by raising :class:`~certrack.core.errors.Cancelled`, when it reports.

        Returns
        -------
        None
        """
        self._stop.set()

    @property
    def cancelled(self) -> bool:
        """Whether :meth:`cancel` was called."""
        return self._stop.is_set()

    def __call__(self, done: float, total: float | None, best: float | None, /) -> None:
        if self._stop.is_set():
            raise Cancelled("cancelled before the call was done")
        self._progress(done, total, best)
