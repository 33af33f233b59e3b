"""One page: what it shows, what it waits for, and what is on its way to it.

The mailbox holds one job of each kind. A newer one takes the place of an older one that nobody has
begun, so that a page that moves fast neither waits for what it no longer shows nor keeps a worker
from another page.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from certrack.app.frames import FrameKind, frame_header, frame_prefix, pack_frame
from certrack.app.messages import Export, FormEdit, GainMove, NewText, Open, StartTask

#: Without a move for so long, s, the exact bound and the run of the drive are computed; the proof
#: by the default effort follows after another pause.
PAUSE, REFINING_PAUSE = 0.12, 0.4

#: Frames that wait for a page that does not read: more are dropped.
QUEUE = 64

#: Texts and edits that may wait.
MAX_WAITING = 4

#: A job of a design that has ended a worker so often is not tried again.
MAX_CRASHES = 2

#: Kinds of jobs in the mailbox, and the role of the worker that does them, the first one first.
ROLES = {
    "run": ("describe", "run"),
    "bound": ("text", "bound", "sampled"),
    "exact": ("exact",),
}

_numbers = itertools.count(1)


@dataclass(frozen=True)
class DesignText:
    """The text that sliders start from.

    Attributes
    ----------
    text, name : str
    folder : str or None
        Where its sample files lie.
    drive : bool
        Whether it has an implementation.
    """

    text: str
    name: str
    folder: str | None
    drive: bool = False


class Session:
    """One page.

    Parameters
    ----------
    folder : str or None
        Where sample files of its texts lie.
    """

    def __init__(self, folder: str | None = None) -> None:
        self.id = next(_numbers)
        self.folder = folder
        self.base: DesignText | None = None
        self.design = 0
        self.move: GainMove | None = None
        self.outgoing: asyncio.Queue[bytes] = asyncio.Queue(QUEUE)
        self.served = 0.0
        self._mail: dict[str, dict[str, Any]] = {}
        self._due: dict[str, float] = {}
        self._waiting: deque[dict[str, Any]] = deque()
        self._crashes: dict[tuple[int, str], int] = {}

    # what the page sends

    def moved(self, move: GainMove) -> None:
        """Gains or window have changed."""
        if self.base is None:
            return
        changed = move.design != self.design
        self.move, self.design = move, move.design
        self._post("run", sampled=False)
        if changed or move.resting:
            self._mail.pop("sampled", None)
            self._post("exact", effort="fast", after=PAUSE)
            if self.base.drive:
                self._post("sampled", do="run", sampled=True, after=PAUSE)
        elif self.base.drive:
            self._post("sampled", do="run", sampled=True, after=PAUSE)
        if move.resting:
            self._post("text")

    def opened(self, message: Open | NewText | FormEdit, text: str | None = None) -> bool:
        """Another text; whether there was room for it."""
        if len(self._waiting) >= MAX_WAITING:
            return False
        job: dict[str, Any] = {"do": "describe", "design": message.design, "view": 0}
        if isinstance(message, Open) and text is None:
            job |= {"do": "source", "name": message.name, "text": ""}
        else:
            job |= {"text": getattr(message, "text", text), "name": message.name}
        if isinstance(message, FormEdit):
            job["entries"] = dict(message.entries)
        job |= {"folder": self.folder, "page": self.id}
        self._waiting.append(job)
        return True

    def long_job(self, message: StartTask | Export) -> dict[str, Any] | None:
        """The job of a task or an export; None before anything is open."""
        if self.base is None:
            return None
        job = self._job("task", "task")
        job |= {"design": message.design, "gains": dict(message.gains)}
        if isinstance(message, StartTask):
            return job | {"task": message.task, "options": dict(message.options)}
        return job | {"do": "export", "format": message.format}

    # what the hub asks

    def next_job(self, role: str, now: float) -> dict[str, Any] | None:
        """Take the next job for a role from the mailbox; None if nothing is due."""
        for kind in ROLES[role]:
            if kind == "describe":
                if self._waiting:
                    return self._waiting.popleft()
            elif kind in self._mail and self._due.get(kind, 0.0) <= now:
                return self._mail.pop(kind)
        return None

    def next_due(self) -> float:
        """When the next job that waits for a pause is due; inf if none does."""
        return min((self._due.get(kind, 0.0) for kind in self._mail), default=float("inf"))

    def outdated(self, job: dict[str, Any]) -> bool:
        """Whether the answer to a job would be dropped."""
        return bool(job["do"] == "exact" and job["design"] != self.design)

    def answered(self, job: dict[str, Any], frame: bytes) -> None:
        """The last frame of a job."""
        prefix = frame_prefix(frame)
        if prefix.kind is FrameKind.SYSTEM:
            self._described(job, frame)
        if prefix.kind is FrameKind.RUN and not job["sampled"] and self.move is not None:
            self._mail["bound"] = {**job, "do": "bound"}
        if job["do"] == "exact":
            if job["design"] != self.design:
                return
            if prefix.kind is FrameKind.EXACT and job["effort"] == "fast":
                self._post("exact", effort="default", after=REFINING_PAUSE)
            if prefix.kind is FrameKind.PROBLEM and frame_header(frame).get("superseded"):
                return
        self.send(frame)

    def crashed(self, job: dict[str, Any], *, timed_out: bool, seconds: float) -> None:
        """The worker of a job has ended."""
        design = job.get("design", 0)
        case = design, job["do"]
        self._crashes[case] = self._crashes.get(case, 0) + 1
        self._crashes = dict(list(self._crashes.items())[-QUEUE:])
        again = not timed_out and self._crashes[case] < MAX_CRASHES
        if again:
            self.note("A worker stopped and was started again.")
            self._again(job)
            return
        reason = f"took longer than {seconds:g} s" if timed_out else "stopped the worker twice"
        header = {"message": f"This {reason} and was given up.", "of": job["do"]}
        header["task"] = job.get("task")
        if job["do"] in ("describe", "source"):
            header = {"text": job["text"], "problem": {"message": header["message"], "line": None}}
            self.send(pack_frame(FrameKind.SYSTEM, header, design=design))
            return
        self.send(pack_frame(FrameKind.PROBLEM, header, design=design, view=job.get("view", 0)))

    def note(self, text: str) -> None:
        """Tell the page something in passing."""
        self.send(pack_frame(FrameKind.NOTE, {"note": text}))

    def send(self, frame: bytes) -> None:
        """Queue a frame; a page that does not read loses it, the server no memory."""
        if not self.outgoing.full():
            self.outgoing.put_nowait(frame)

    # mailbox

    def _described(self, job: dict[str, Any], frame: bytes) -> None:
        header = frame_header(frame)
        if header.get("problem") is None:
            self.base = DesignText(header["text"], header["name"], self.folder, header["drive"])
            self.design, self.move = job["design"], None
            self._mail.clear()

    def _post(self, kind: str, *, do: str = "", after: float = 0.0, **details: Any) -> None:
        self._mail[kind] = self._job(kind, do or kind) | details
        self._due[kind] = time.monotonic() + after

    def _job(self, kind: str, do: str) -> dict[str, Any]:
        assert self.base is not None
        move = self.move
        job: dict[str, Any] = {"do": do, "page": self.id, "design": self.design}
        job |= {"text": self.base.text, "name": self.base.name, "folder": self.folder}
        job |= {"gains": {}, "view": 0, "window": None, "pixels": 800}
        if move is not None:
            job |= {"gains": dict(move.gains), "view": move.view, "pixels": move.pixels}
            job["window"] = None if move.window is None else list(move.window)
        return job

    def _again(self, job: dict[str, Any]) -> None:
        """Submit what a lost worker has not answered; only the newest of it."""
        if job["do"] in ("describe", "source"):
            self._waiting.appendleft(job)
        elif self.base is not None and job["do"] in ("run", "bound", "exact", "text"):
            kind = "sampled" if job.get("sampled") and job["do"] == "run" else job["do"]
            self._mail.setdefault(kind, job)
            self._due[kind] = 0.0
