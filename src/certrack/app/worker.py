"""One worker process: jobs on standard input, frames on standard output.

A job is a line of JSON. An answer is u32 length, u32 page, u8 whether it is the last of its job,
and a frame. A thread reads the jobs, so that the end of the server ends the worker at once, and a
newer design ends a proof that nobody waits for any more.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import queue
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from certrack.core.blas import one_thread_from_now_on

#: Length, page and end mark before each frame.
ENVELOPE = struct.Struct("<IIB")

#: Memory of a worker; processor time of one that computes tasks, s.
MAX_MEMORY, MAX_TASK_SECONDS = 4 << 30, 3600

#: How much later than the live ones the other roles are served.
NICENESS = {"run": 0, "bound": 4, "exact": 6, "task": 10}

#: The signal that a child gets where its parent dies, on Linux.
PR_SET_PDEATHSIG = 1


class Worker:
    """The state of the process.

    Parameters
    ----------
    role : {"run", "bound", "exact", "task"}
    jobs, answers : binary streams
    """

    def __init__(self, role: str, jobs: BinaryIO, answers: BinaryIO) -> None:
        self.role = role
        self._jobs, self._answers = jobs, answers
        self._queue: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._superseded: set[int] = set()
        self._current = 0

    def serve(self) -> None:
        """Work until the server closes the connection."""
        threading.Thread(target=self._read, name="certrack jobs", daemon=True).start()
        from certrack.app.jobs import JOBS, JobContext

        context = JobContext()
        while True:
            job = self._queue.get()
            self._current = job["job"]
            began = time.perf_counter()

            def send(frame: bytes, job: dict[str, Any] = job) -> None:
                self._send(job, frame, last=False)

            last = _answer(JOBS[job["do"]], context, job, began, send, self._progress)
            self._send(job, last, last=True)

    def _progress(self, *_: float | None) -> None:
        """Give up a proof that is superseded."""
        if self._current in self._superseded:
            from certrack.core.errors import Cancelled

            raise Cancelled("a newer design has come")

    def _read(self) -> None:
        for line in self._jobs:
            job = json.loads(line)
            if job["do"] == "supersede":
                self._superseded = {job["job"]}
            else:
                self._queue.put(job)
        os._exit(0)  # the server is gone

    def _send(self, job: dict[str, Any], frame: bytes, *, last: bool) -> None:
        from certrack.app.frames import of_revision

        frame = of_revision(frame, job.get("revision", 0))
        try:
            self._answers.write(ENVELOPE.pack(len(frame), job["page"], last) + frame)
            self._answers.flush()
        except OSError:
            os._exit(0)


def _answer(
    work: Callable[..., bytes],
    context: Any,
    job: dict[str, Any],
    began: float,
    send: Callable[[bytes], None],
    progress: Callable[..., None],
) -> bytes:
    """The last frame of a job: its result, or what was wrong."""
    from certrack.app.frames import FrameKind, pack_frame
    from certrack.core.errors import Cancelled, CertrackError

    try:
        return work(context, job, began, send, progress)
    except Cancelled:
        header: dict[str, Any] = {"message": "", "superseded": True}
    except CertrackError as problem:
        header = {"message": str(problem)}
    except MemoryError:
        header = {"message": "This needs more memory than a worker may have."}
    except Exception as problem:  # a defect must not end the worker, and must be seen
        header = {"message": f"{type(problem).__name__}: {problem}", "defect": True}
    header |= {"of": job["do"], "task": job.get("task"), "effort": job.get("effort")}
    return pack_frame(
        FrameKind.PROBLEM, header, design=job.get("design", 0), view=job.get("view", 0)
    )


def limit_process(role: str) -> None:
    """Limits of memory and time, and an end with the server."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICENESS[role])
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
    if role == "task":
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_TASK_SECONDS, MAX_TASK_SECONDS))
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def run_worker() -> None:
    """Entry point: ``python -m certrack.app.worker ROLE``."""
    role = sys.argv[1]
    one_thread_from_now_on()
    limit_process(role)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not come between the frames
    Worker(role, sys.stdin.buffer, answers).serve()


def worker_command(role: str) -> list[str]:
    """The command that starts a worker of this package."""
    return [sys.executable, "-m", "certrack.app.worker", role]


def worker_environment() -> dict[str, str]:
    """The environment of a worker: one thread for the linear algebra, and this package."""
    root = str(Path(__file__).parents[2])
    path = os.environ.get("PYTHONPATH", "")
    return {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, (root, path))),
    }


if __name__ == "__main__":
    run_worker()
