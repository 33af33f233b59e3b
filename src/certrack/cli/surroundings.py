"""What the surroundings may do to a command: end it, or refuse it memory, handles or its output.

Whatever happens, one line says it, and what was begun is cleaned up: temporary folders go, since
the signal becomes an exception, and half of a file never has its name.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import IO

from certrack.core.progress import AT_ONCE

#: Exit code of a process that the signal has ended, as shells count it.
TERMINATED_CODE = 128 + signal.SIGTERM


#: Of a write to what has no name: files have one, and errors of their own.
WRITE_ERRORS = {errno.ENOSPC, errno.EFBIG, errno.EIO, errno.EBADF, errno.EDQUOT}


#: What comes of too little memory or too few handles. Python calls the code of a library that it
#: could read in part only a syntax error.
REFUSALS = (OSError, MemoryError, ImportError, SyntaxError)


@contextmanager
def ended_by_exception() -> Iterator[None]:
    """SIGTERM raises SystemExit meanwhile, so that everything is cleaned up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def kept_at_termination() -> Iterator[None]:
    """SIGTERM raises KeyboardInterrupt, so that a search keeps its best; the code tells of it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came = False

    def keep(_signal: int, _frame: FrameType | None) -> None:
        nonlocal came
        came = True
        raise KeyboardInterrupt(AT_ONCE)

    before = signal.signal(signal.SIGTERM, keep)
    try:
        yield
    except KeyboardInterrupt as interruption:
        if AT_ONCE not in interruption.args:
            raise
        raise SystemExit(TERMINATED_CODE) from None
    finally:
        signal.signal(signal.SIGTERM, before)
    if came:
        raise SystemExit(TERMINATED_CODE)


def _terminate(_signal: int, _frame: FrameType | None) -> None:
    raise SystemExit(TERMINATED_CODE)


def trouble(problem: BaseException) -> str:
    """One line on what the system refused.

    Parameters
    ----------
    problem : exception
        One of :data:`REFUSALS`.
    """
    if isinstance(problem, MemoryError):
        return "there is not enough memory for this: ask for fewer members, samples or states"
    if not isinstance(problem, OSError):
        reason = str(problem) or type(problem).__name__
        return f"a library cannot be loaded ({reason}): memory or file handles may be short"
    reason = problem.strerror or str(problem) or type(problem).__name__
    lost = not flushed(sys.stdout)
    if lost or (not problem.filename and problem.errno in WRITE_ERRORS):
        return f"standard output cannot be written ({reason})"
    where = f"{problem.filename}: " if problem.filename else ""
    return f"{where}the system refuses ({reason})"


def flushed(stream: IO[str] | None) -> bool:
    """Whether all that was printed reached its end; if not, the rest is dropped without a word.

    Parameters
    ----------
    stream : text stream or None
    """
    if stream is None or stream.closed:
        return True
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):  # else the interpreter tries, and fails, once more
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
            stream.flush()
        return False
    return True
