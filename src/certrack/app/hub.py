"""Which worker does what next: the page that waited longest goes first."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Mapping
from typing import Any

from certrack.app.frames import FrameKind, pack_frame
from certrack.app.processes import WorkerProcess
from certrack.app.session import READING, ROLES, Session

#: Longest time for a job, s: a worker that takes longer is ended and started again.
TIME_LIMITS = {
    "warm": 120,
    "describe": 30,
    "source": 30,
    "run": 20,
    "bound": 30,
    "text": 20,
    "law": 30,
    "exact": 900,
    "export": 900,
    "task": 4 * 3600,
}

#: How often time limits are looked at, s.
WATCH_INTERVAL = 0.25

#: Long computations at the same time, of all pages.
MAX_TASKS = 2

#: A text that nobody waits for any more is read for so long, s, then its worker is ended.
SUPERSEDED_READING = 1.0

#: A worker that ends this soon after its start, s, is started again after that time.
SOONEST_RESTART = 1.0


class Hub:
    """All pages and all workers.

    Parameters
    ----------
    live : int
        Number of workers for runs.
    first : mapping, optional
        ``text``, ``name`` and ``folder`` of what the first page opens: workers compile it before.
    """

    def __init__(self, live: int = 1, first: Mapping[str, Any] | None = None) -> None:
        self._first = first
        self.sessions: dict[int, Session] = {}
        self.workers: list[WorkerProcess] = []
        self._roles = [*["run"] * live, "bound", "exact"]
        self._jobs = itertools.count(1)
        self._watch: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._starting: set[asyncio.Task[None]] = set()
        self._stopping = False

    async def start(self) -> None:
        """Start the workers, and let them compile what pages open first."""
        for role in self._roles:
            await self._start(role)
        self._watch = asyncio.create_task(self._watch_time())

    async def stop(self) -> None:
        """End all workers."""
        self._stopping = True
        if self._watch is not None:
            self._watch.cancel()
        await asyncio.gather(*(worker.stop() for worker in self.workers))

    def join(self, session: Session) -> None:
        """A page has come."""
        self.sessions[session.id] = session

    def leave(self, session: Session) -> None:
        """A page has gone."""
        self.sessions.pop(session.id, None)
        self.cancel_task(session)

    def pump(self) -> None:
        """Give every idle worker its next job."""
        now = time.monotonic()
        for worker in self.workers:
            if worker.idle and worker.role in ROLES:
                self._serve(worker, now)
            elif worker.job is not None and worker.job["do"] == "exact":
                session = self.sessions.get(worker.job["page"])
                if session is None or session.outdated(worker.job):
                    worker.supersede()
        due = min((s.next_due() for s in self.sessions.values()), default=float("inf"))
        if now < due < float("inf"):
            if self._timer is not None:
                self._timer.cancel()
            self._timer = asyncio.get_running_loop().call_later(due - now + 1e-3, self.pump)

    def _serve(self, worker: WorkerProcess, now: float) -> None:
        for session in sorted(self.sessions.values(), key=lambda s: s.served):
            job = session.next_job(worker.role, now)
            if job is not None:
                if worker.role == "run":
                    session.served = now
                worker.work_on(job | {"job": next(self._jobs)})
                return

    # long computations

    async def start_task(self, session: Session, job: dict[str, Any]) -> str:
        """Begin a long computation in a process of its own; a reason if it cannot begin."""
        if self._task_of(session) is not None:
            return "One long computation at a time: wait for it or cancel it."
        if sum(worker.role == "task" for worker in self.workers) >= MAX_TASKS:
            return "The machine is busy with long computations of other pages."
        try:
            worker = await self._start("task")
        except OSError as problem:
            return f"No process could be started: {problem.strerror or problem}."
        worker.work_on(job | {"job": next(self._jobs)})
        return ""

    def cancel_task(self, session: Session) -> None:
        """End the long computation of a page, which is told so whether there was one or not."""
        worker = self._task_of(session)
        header = {"task": None, "state": "cancelled"}
        counters: dict[str, Any] = {"design": session.design, "revision": 0}
        if worker is not None and worker.job is not None:
            header["task"] = worker.job.get("task")
            counters["revision"] = worker.job["revision"]
            worker.job = None
            self.workers.remove(worker)
            worker.kill()
        session.send(pack_frame(FrameKind.TASK, header, **counters))

    def _task_of(self, session: Session) -> WorkerProcess | None:
        for worker in self.workers:
            job = worker.job
            if worker.role == "task" and job is not None and job["page"] == session.id:
                return worker
        return None

    # workers

    async def _start(self, role: str) -> WorkerProcess:
        worker = WorkerProcess(role, self._on_frame, self._on_end)
        self.workers.append(worker)
        try:
            await worker.start()
        except OSError:
            self.workers.remove(worker)
            raise
        if role != "task" and self._first is not None:
            warm = {"do": "warm", "role": role, "page": 0, "job": next(self._jobs), "revision": 0}
            worker.work_on(warm | dict(self._first))
        return worker

    def _on_frame(self, worker: WorkerProcess, page: int, frame: bytes, last: bool) -> None:
        if worker not in self.workers:  # cancelled: what was on its way is of no use
            return
        session = self.sessions.get(page)
        job = worker.finished
        if last and worker.role == "task":
            self.workers.remove(worker)
            worker.kill()
        if session is not None:
            if last and job is not None and worker.role != "task":
                session.answered(job, frame)
            else:
                session.send(frame)
        if last:
            self.pump()

    def _on_end(self, worker: WorkerProcess) -> None:
        if worker not in self.workers or self._stopping:
            return
        self.workers.remove(worker)
        job, worker.job = worker.job, None
        session = None if job is None else self.sessions.get(job["page"])
        if session is not None and job is not None:
            limit = TIME_LIMITS[job["do"]]
            session.crashed(job, timed_out=worker.timed_out, seconds=limit)
        if worker.role != "task":
            starting = asyncio.get_running_loop().create_task(self._restart(worker))
            self._starting.add(starting)
            starting.add_done_callback(self._starting.discard)

    async def _restart(self, worker: WorkerProcess) -> None:
        if time.monotonic() - worker.since < SOONEST_RESTART:
            await asyncio.sleep(SOONEST_RESTART)
        while not self._stopping:
            try:
                await self._start(worker.role)
            except OSError:  # no process or no memory at the moment
                await asyncio.sleep(SOONEST_RESTART)
                continue
            self.pump()
            return

    async def _watch_time(self) -> None:
        while True:
            await asyncio.sleep(WATCH_INTERVAL)
            now = time.monotonic()
            for worker in self.workers:
                job = worker.job
                if job is None:
                    continue
                if now - worker.since > TIME_LIMITS[job["do"]]:
                    worker.timed_out = True
                    worker.kill()
                elif now - worker.since > SUPERSEDED_READING and self._is_superseded(job):
                    worker.kill()
            self.pump()

    def _is_superseded(self, job: Mapping[str, Any]) -> bool:
        """Whether a text is read that nobody waits for any more."""
        session = self.sessions.get(job["page"])
        return job["do"] in READING and (session is None or session.outdated(dict(job)))
