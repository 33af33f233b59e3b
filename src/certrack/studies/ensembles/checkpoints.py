"""Chunks of an ensemble on disk: written whole or not at all, so a killed run goes on.

The folder holds ``ensemble.toml`` (what is run), ``merged.npz``, ``chunk-BEGIN-END.npz`` and, where
constants have ranges, ``corners.npz`` with the runs at their corners. When
many chunks have gathered they are merged into one file, which says which members it covers; chunks
it covers are ignored, so a kill between the two steps counts nothing twice. What is read back is
checked (``stored.py``), and one process at a time writes.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from certrack.core.errors import InputError
from certrack.core.files import write_whole
from certrack.core.version import version
from certrack.model.sampling import MAX_MEMBERS
from certrack.studies.ensembles.plan import REVISION, Plan, Range
from certrack.studies.ensembles.statistics import Statistics
from certrack.studies.ensembles.stored import read_stored, sealed
from certrack.systems.writer import to_text

#: So many chunk files are merged into one.
MAX_CHUNK_FILES = 32


#: Held while a process computes into the folder; the system lets go of it when the process ends.
LOCK_NAME = ".lock"

#: The runs at the corners of the ranges.
CORNERS_NAME = "corners.npz"


class Checkpoints:
    """A folder that belongs to one plan, and to one process while it is entered.

    Raises
    ------
    InputError
        If it cannot be written, belongs to another ensemble, or another process computes into it.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder = folder
        self._plan = plan
        self._keep_merged = False  # it belongs to a larger run
        self._run = self._manifest()
        self._lock = FileLock(folder / LOCK_NAME, timeout=0)

    def __enter__(self) -> Checkpoints:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            self._claim()
        except OSError as problem:
            self._lock.release()
            raise self._refusal(problem) from None
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def _take_lock(self) -> None:
        """Keep other processes away, where the file system has locks.

        Without one nothing becomes wrong: files appear whole, and a chunk is the same whoever
        computes it. But what one process merges, another may compute again.
        """
        try:
            self._lock.acquire()
        except Timeout:
            raise InputError(
                str(self.folder),
                "another process computes into it",
                remedy="Wait until it has ended or choose another --out",
            ) from None
        except (OSError, NotImplementedError):  # read only, or without locks
            return

    def _claim(self) -> None:
        """Write what is run, or refuse a folder of something else."""
        manifest, text = self.folder / "ensemble.toml", self._run.encode()
        if not os.path.lexists(manifest):
            self._write(manifest, text)
            return
        written = b""
        if manifest.is_file():
            with manifest.open("rb") as stream:
                written = stream.read(len(text) + 1)
        if written != text:
            raise InputError(
                str(self.folder),
                "holds another ensemble: its system, seed, tolerance, limit, method, revision of "
                "the method or version differs",
                remedy="Choose another --out or delete the folder, or state the method that it was "
                "begun with (method= in Python)",
            )

    def _manifest(self) -> str:
        plan = self._plan
        return (
            f"# certrack {version()}; seed {plan.seed}; tolerance {plan.tolerance!r}; limit "
            f"{plan.limit!r}; method {plan.method}, revision {REVISION}\n{to_text(plan.system)}"
        )

    def load(self, total: Statistics, members: int) -> list[Range]:
        """Merge every stored chunk within the first `members` into `total`; returns the ranges.

        The members of a file with anything wrong are computed again.
        """
        merged = self.folder / "merged.npz"
        covered: list[Range] = []
        if os.path.lexists(merged):
            statistics, ranges = self._read(merged)
            if statistics is not None and all(end <= members for _, end in ranges):
                total.merge(statistics)
                covered += ranges
            self._keep_merged = statistics is not None and not covered
        for path, span in self._chunks():
            if _overlaps(span, covered) or span[1] > members:
                continue
            statistics, _ = self._read(path, span)
            if statistics is not None:
                total.merge(statistics)
                covered.append(span)
        return sorted(covered)

    def save(self, span: Range, arrays: dict[str, np.ndarray]) -> None:
        """Write one chunk."""
        self._save(self.folder / f"chunk-{span[0]:010d}-{span[1]:010d}.npz", arrays, [span])

    def load_corners(self, span: Range) -> Statistics | None:
        """Statistics of the corners of the ranges; None where they have to be computed."""
        return self._read(self.folder / CORNERS_NAME, span)[0]

    def save_corners(self, span: Range, arrays: dict[str, np.ndarray]) -> None:
        """Write the corners of the ranges."""
        self._save(self.folder / CORNERS_NAME, arrays, [span])

    def gather(self, total: Statistics, covered: list[Range]) -> None:
        """Replace many chunk files by one."""
        chunks = self._chunks()
        if len(chunks) < MAX_CHUNK_FILES or self._keep_merged:
            return
        self._save(self.folder / "merged.npz", total.packed(), sorted(covered))
        for path, span in chunks:
            if _overlaps(span, covered):
                path.unlink(missing_ok=True)

    def _chunks(self) -> list[tuple[Path, Range]]:
        chunks = []
        for path in sorted(self.folder.glob("chunk-*.npz")):
            match = re.fullmatch(r"chunk-([0-9]{10})-([0-9]{10})\.npz", path.name)
            if match and int(match[1]) < int(match[2]) <= MAX_MEMBERS:
                chunks.append((path, (int(match[1]), int(match[2]))))
        return chunks

    def _read(self, path: Path, span: Range | None = None) -> tuple[Statistics | None, list[Range]]:
        """Statistics in a file, whole or not at all, and the members that they count."""
        try:
            return read_stored(path, self._plan, self._run, span)
        except Exception:  # whatever is wrong with it, its members are computed again
            return None, []

    def _save(self, path: Path, arrays: dict[str, np.ndarray], ranges: list[Range]) -> None:
        self._write(path, sealed(arrays, ranges, self._run))

    def _write(self, path: Path, data: bytes | memoryview) -> None:
        try:
            write_whole(path, data)
        except OSError as problem:
            raise self._refusal(problem) from None

    def _refusal(self, problem: OSError) -> InputError:
        return InputError(
            str(self.folder),
            f"cannot be written ({problem.strerror}); chunks written before are intact",
            remedy="Make room or choose another --out; the same command goes on from there",
        )


def _overlaps(span: Range, others: list[Range]) -> bool:
    return any(span[0] < end and begin < span[1] for begin, end in others)
