"""A worker process as the server sees it: one job at a time, frames as they come."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable
from typing import Any

from certrack.app.worker import ENVELOPE, worker_command, worker_environment

#: Bytes that a reader buffers: a frame of a run has some 40 kB, an exported file a few MB.
READ_LIMIT = 1 << 22

#: A longer frame is no frame.
LARGEST_FRAME = 1 << 28


class WorkerProcess:
    """One worker.

    Parameters
    ----------
    role : str
    on_frame : callable
        Gets the worker, the number of the page, the frame, and whether it is the job's last.
    on_end : callable
        Gets the worker when its process has ended without being asked to.
    """

    def __init__(
        self,
        role: str,
        on_frame: Callable[[WorkerProcess, int, bytes, bool], None],
        on_end: Callable[[WorkerProcess], None],
    ) -> None:
        self.role = role
        self.job: dict[str, Any] | None = None
        self.finished: dict[str, Any] | None = None
        self.since = 0.0
        self.timed_out = False
        self._on_frame, self._on_end = on_frame, on_end
        self._process: asyncio.subprocess.Process | None = None
        self._reader: asyncio.Task[None] | None = None

    @property
    def pid(self) -> int | None:
        """Its process; None before the start."""
        return None if self._process is None else self._process.pid

    @property
    def idle(self) -> bool:
        """Whether it waits for a job."""
        return self._process is not None and self.job is None

    async def start(self) -> None:
        """Start the process."""
        self._process = await asyncio.create_subprocess_exec(
            *worker_command(self.role),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env=worker_environment(),
            limit=READ_LIMIT,
        )
        self._reader = asyncio.create_task(self._read())

    def work_on(self, job: dict[str, Any]) -> None:
        """Give it a job; it must be idle."""
        self.job, self.since, self.timed_out = job, time.monotonic(), False
        self._write(job)

    def supersede(self) -> None:
        """Tell it that nobody waits for its job any more."""
        if self.job is not None:
            self._write({"do": "supersede", "job": self.job["job"]})

    def kill(self) -> None:
        """End the process at once."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    async def stop(self) -> None:
        """End the process, and wait until it is gone."""
        if self._reader is not None:
            self._reader.cancel()
        self.kill()
        if self._process is not None:
            await self._process.wait()

    def _write(self, job: dict[str, Any]) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError, RuntimeError):
                self._process.stdin.write(json.dumps(job).encode() + b"\n")

    async def _read(self) -> None:
        assert self._process is not None and self._process.stdout is not None
        stream = self._process.stdout
        try:
            while True:
                length, page, last = ENVELOPE.unpack(await stream.readexactly(ENVELOPE.size))
                if length > LARGEST_FRAME:
                    break
                frame = await stream.readexactly(length)
                if last:
                    job, self.job = self.job, None
                    self.finished = job
                self._on_frame(self, page, frame, bool(last))
        except (asyncio.IncompleteReadError, OSError):
            pass
        self.kill()
        await self._process.wait()
        self._on_end(self)
