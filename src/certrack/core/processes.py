"""A command with a limit of time, after which it is ended with all that it started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path


def run_command(command: Sequence[str], folder: Path, timeout: float) -> tuple[int, str]:
    """Exit code and standard error of a command, which starts a group of processes of its own.

    A compiler starts others, which would go on if it alone were ended.

    Raises
    ------
    OSError
        If it cannot be run.
    subprocess.TimeoutExpired
        If it takes longer.
    """
    process = subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        _, message = process.communicate(timeout=timeout)
    except BaseException:  # also where the user interrupts
        _kill_group(process)
        raise
    return process.returncode, message.decode(errors="replace")


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """End a process and all that it started."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
    if process.stderr is not None:
        process.stderr.close()  # not read to its end: what survives may hold it open
