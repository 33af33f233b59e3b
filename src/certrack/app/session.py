"""One page: what it shows, what it waits for, and what is on its way to it.

The mailbox holds one job of each kind. A newer one takes the place of an older one that nobody has
begun, so that a page that moves fast neither waits for what it no longer shows nor keeps a worker
from another page. So it is with texts: the newest that was sent is the one that is read, and what
was computed for an earlier one is not sent.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from certrack.app.frames import FrameKind, frame_header, frame_prefix, pack_frame
from certrack.app.messages import Export, FormEdit, GainMove, NewText, Open, StartTask
from certrack.app.outbox import QUEUE, Outbox
from certrack.app.workspace import TextFile

#: So long after the answer to a move, s, if no other has come, the exact bound and the run of the
#: drive are computed; the proof by the default effort follows after another pause.
PAUSE, REFINING_PAUSE = 0.12, 0.4

#: Jobs that read a text, and those of long computations.
READING, LONG = ("describe", "source"), ("task", "export")

#: What is answered for a text that the page no longer shows.
SUPERSEDED = {"message": "", "superseded": True}

#: A job of a design that has ended a worker so often is not tried again.
MAX_CRASHES = 2

#: Kinds of jobs in the mailbox, and the role of the worker that does them, the first one first.
ROLES = {
    "run": ("describe", "run"),
    "bound": ("text", "bound", "sampled", "law"),
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
    revision : int
        The page's own counter of the texts that it sent.
    drive : bool
        Whether it has an implementation.
    """

    text: str
    name: str
    folder: str | None
    revision: int
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
        self.asked = 0
        self.design = 0
        self.move: GainMove | None = None
        self.outgoing = Outbox()
        self.served = 0.0
        self._file_name = ""
        self._mail: dict[str, dict[str, Any]] = {}
        self._due: dict[str, float] = {}
        self._waiting: dict[str, Any] | None = None
        self._crashes: dict[tuple[int, int, str], int] = {}

    # what the page sends

    def moved(self, move: GainMove) -> None:
        """Gains or window have changed; gains of another text than the one at hand are answered."""
        if self.base is None or move.revision != self.base.revision:
            header = SUPERSEDED | {"of": "set"}
            counters: dict[str, Any] = {"design": move.design, "view": move.view}
            counters["revision"] = move.revision
            self.send(pack_frame(FrameKind.PROBLEM, header, **counters))
            return
        before, self.move = self.move, move
        changed, self.design = before is None or move.design != self.design, move.design
        seen = before is not None and (before.view, before.window) == (move.view, move.window)
        self._post("run", sampled=False)
        if changed:
            self._post("bound")
            self._post("exact", effort="fast", after=math.inf)
        if self.base.drive and (changed or not seen):
            self._post("sampled", do="run", sampled=True, after=math.inf)
        if move.resting:
            self._post("text")
            if move.law:
                self._post("law")
            self._end_pause()

    def _begin_pause(self, job: Mapping[str, Any]) -> None:
        """The newest move has its answer: before, a page that waits for it may be moving still."""
        if job["do"] != "run" or job["sampled"] or job["design"] != self.design:
            return
        for kind in ("exact", "sampled"):
            seen = kind == "exact" or (self.move is not None and job["view"] == self.move.view)
            if seen and self._due.get(kind) == math.inf:
                self._due[kind] = time.monotonic() + PAUSE

    def _end_pause(self) -> None:
        """The gesture is over: what waits for a pause begins; a refined proof comes later still."""
        for kind in ("exact", "sampled"):
            if kind in self._mail and self._mail[kind].get("effort") != "default":
                self._due[kind] = 0.0

    def asks(self, revision: int) -> None:
        """A text is on its way: none that was sent before it is read any more."""
        self.asked = revision
        self._waiting = None

    def opened(self, message: Open | NewText | FormEdit, file: TextFile | None = None) -> None:
        """Another text; it takes the place of one that nobody has begun to read.

        Parameters
        ----------
        message : Open, NewText or FormEdit
        file : TextFile, optional
            What was read, of a file that is opened.
        """
        self.asks(message.revision)
        job: dict[str, Any] = {"do": "describe", "design": 0, "view": 0, "gains": {}}
        job |= {"revision": message.revision, "name": message.name}
        if not isinstance(message, Open):
            job["text"] = message.text
        elif file is not None:
            job |= {"text": file.text, "file": {"name": message.name, "digest": file.digest}}
        else:
            job |= {"do": "source", "text": ""}
        if isinstance(message, FormEdit):
            job |= {"entries": dict(message.entries), "gains": dict(message.gains)}
        self._waiting = job | {"folder": self.folder, "page": self.id}

    def long_job(self, message: StartTask | Export) -> dict[str, Any] | None:
        """The job of a task or an export; None where its text is not the one at hand."""
        if self.base is None or message.revision != self.base.revision:
            return None
        job = self._job("task", "task")
        job |= {"design": message.design, "gains": dict(message.gains)}
        if isinstance(message, StartTask):
            return job | {"task": message.task, "options": dict(message.options)}
        job["name"] = self._file_name or self.base.name
        return job | {"do": "export", "format": message.format}

    def saved(self, name: str, revision: int) -> None:
        """The text at hand lies in a file: what is exported from now on is named after it.

        Parameters
        ----------
        name : str
        revision : int
            Of the newest text when the page asked for it; another one has a name of its own.
        """
        if self.base is not None and revision == self.asked == self.base.revision:
            self._file_name = name

    # what the hub asks

    def next_job(self, role: str, now: float) -> dict[str, Any] | None:
        """Take the next job for a role from the mailbox; None if nothing is due."""
        for kind in ROLES[role]:
            if kind == "describe":
                if self._waiting is not None:
                    job, self._waiting = self._waiting, None
                    return job
            elif kind in self._mail and self._due.get(kind, 0.0) <= now:
                return self._mail.pop(kind)
        return None

    def next_due(self) -> float:
        """When the next job that waits for a pause is due; inf if none does."""
        return min((self._due.get(kind, 0.0) for kind in self._mail), default=float("inf"))

    def outdated(self, job: dict[str, Any]) -> bool:
        """Whether the answer to a job would be dropped."""
        if job["do"] in READING:
            return bool(job["revision"] != self.asked)
        if self.base is None or job["revision"] != self.base.revision:
            return True
        return bool(job["do"] == "exact" and job["design"] != self.design)

    def answered(self, job: dict[str, Any], frame: bytes) -> None:
        """The last frame of a job."""
        if self.outdated(job):
            return
        self._begin_pause(job)
        prefix = frame_prefix(frame)
        if prefix.kind is FrameKind.SYSTEM:
            self._described(job, frame)
        if job["do"] == "exact":
            if prefix.kind is FrameKind.EXACT and job["effort"] == "fast":
                self._post("exact", effort="default", after=REFINING_PAUSE)
            if prefix.kind is FrameKind.PROBLEM and frame_header(frame).get("superseded"):
                return
        self.send(frame)

    def crashed(self, job: dict[str, Any], *, timed_out: bool, seconds: float) -> None:
        """The worker of a job has ended."""
        if job["do"] not in LONG and self.outdated(job):
            return
        case = job["revision"], job.get("design", 0), job["do"]
        self._crashes[case] = self._crashes.get(case, 0) + 1
        self._crashes = dict(list(self._crashes.items())[-QUEUE:])
        if not timed_out and job["do"] not in LONG and self._crashes[case] < MAX_CRASHES:
            self.note("A worker stopped and was started again.")
            self._again(job)
            return
        self._begin_pause(job)
        if timed_out:
            reason = f"This took longer than {seconds:g} s and was given up."
        elif job["do"] in LONG:
            reason = "The process of this computation was ended from outside, or for want of "
            reason += "memory: start it again."
        else:
            reason = "This stopped the worker twice and was given up."
        counters: dict[str, Any] = {"design": job.get("design", 0), "revision": job["revision"]}
        if job["do"] in READING:
            header = {"text": job["text"], "problem": {"message": reason, "line": None, "key": ""}}
            self.send(pack_frame(FrameKind.SYSTEM, header, **counters))
            return
        header = {"message": reason, "of": job["do"], "task": job.get("task")}
        header["effort"] = job.get("effort")
        self.send(pack_frame(FrameKind.PROBLEM, header, view=job.get("view", 0), **counters))

    def note(self, text: str) -> None:
        """Tell the page something in passing."""
        self.send(pack_frame(FrameKind.NOTE, {"note": text}))

    def send(self, frame: bytes) -> None:
        """Queue a frame."""
        self.outgoing.add(frame)

    # mailbox

    def _described(self, job: dict[str, Any], frame: bytes) -> None:
        header = frame_header(frame)
        if header.get("problem") is None:
            text, name, drive = header["text"], header["name"], header["drive"]
            self.base = DesignText(text, name, self.folder, job["revision"], drive)
            self.design, self.move, self._file_name = 0, None, ""
            self._mail.clear()

    def _post(self, kind: str, *, do: str = "", after: float = 0.0, **details: Any) -> None:
        self._mail[kind] = self._job(kind, do or kind) | details
        self._due[kind] = time.monotonic() + after

    def _job(self, kind: str, do: str) -> dict[str, Any]:
        assert self.base is not None
        move = self.move
        job: dict[str, Any] = {"do": do, "page": self.id, "design": self.design}
        job |= {"text": self.base.text, "name": self.base.name, "folder": self.folder}
        job["revision"] = self.base.revision
        job |= {"gains": {}, "view": 0, "window": None, "pixels": 800}
        if move is not None:
            job |= {"gains": dict(move.gains), "view": move.view, "pixels": move.pixels}
            job["window"] = None if move.window is None else list(move.window)
        return job

    def _again(self, job: dict[str, Any]) -> None:
        """Submit what a lost worker has not answered; only the newest of it."""
        if job["do"] in READING:
            self._waiting = job
        elif job["do"] in ("run", "bound", "exact", "text", "law"):
            kind = "sampled" if job.get("sampled") and job["do"] == "run" else job["do"]
            if kind not in self._mail:
                self._mail[kind], self._due[kind] = job, 0.0
