"""Chunks of an ensemble on disk: written whole or not at all, so a killed run goes on.

The folder holds ``ensemble.toml`` (what is run), ``merged.npz`` and ``chunk-BEGIN-END.npz``. When
many chunks have gathered they are merged into one file, which says which members it covers; chunks
it covers are ignored, so a kill between the two steps counts nothing twice.
"""

from __future__ import annotations

import re
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from certrack.core.errors import InputError
from certrack.core.files import write_whole
from certrack.core.version import version
from certrack.studies.ensembles.plan import Plan, Range
from certrack.studies.ensembles.statistics import Statistics
from certrack.systems.writer import to_text

#: So many chunk files are merged into one.
MAX_CHUNK_FILES = 32


class Checkpoints:
    """A folder that belongs to one plan.

    Raises
    ------
    InputError
        If it cannot be written or belongs to another ensemble.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder = folder
        self._plan = plan
        self._keep_merged = False  # it belongs to a larger run
        manifest = folder / "ensemble.toml"
        text = self._manifest()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if manifest.exists():
                if manifest.read_text("utf-8") != text:
                    raise InputError(
                        str(folder),
                        "holds another ensemble: its system, seed, tolerance, limit, method or "
                        "version differs",
                        remedy="Choose another --out or delete the folder",
                    )
            else:
                self._write(manifest, text.encode())
        except OSError as problem:
            raise self._refusal(problem) from None

    def _manifest(self) -> str:
        plan = self._plan
        return (
            f"# certrack {version()}; seed {plan.seed}; tolerance {plan.tolerance!r}; "
            f"limit {plan.limit!r}; method {plan.method}\n{to_text(plan.system)}"
        )

    def load(self, total: Statistics, members: int) -> list[Range]:
        """Merge every stored chunk within the first `members` into `total`; returns the ranges.

        The members of a file that cannot be read are computed again.
        """
        merged = self.folder / "merged.npz"
        covered: list[Range] = []
        if merged.exists():
            statistics, ranges = self._read(merged)
            if statistics is not None and all(end <= members for _, end in ranges):
                total.merge(statistics)
                covered += ranges
            self._keep_merged = statistics is not None and not covered
        for path, span in self._chunks():
            if _overlaps(span, covered) or span[1] > members:
                continue
            statistics, _ = self._read(path)
            if statistics is not None and statistics.members == span[1] - span[0]:
                total.merge(statistics)
                covered.append(span)
        return sorted(covered)

    def save(self, span: Range, arrays: dict[str, np.ndarray]) -> None:
        """Write one chunk."""
        self._save(self.folder / f"chunk-{span[0]:010d}-{span[1]:010d}.npz", arrays)

    def gather(self, total: Statistics, covered: list[Range]) -> None:
        """Replace many chunk files by one."""
        chunks = self._chunks()
        if len(chunks) < MAX_CHUNK_FILES or self._keep_merged:
            return
        ranges = np.array(sorted(covered), dtype=np.int64)
        self._save(self.folder / "merged.npz", total.packed() | {"ranges": ranges})
        for path, span in chunks:
            if _overlaps(span, covered):
                path.unlink(missing_ok=True)

    def _chunks(self) -> list[tuple[Path, Range]]:
        chunks = []
        for path in sorted(self.folder.glob("chunk-*.npz")):
            if match := re.fullmatch(r"chunk-(\d+)-(\d+)\.npz", path.name):
                chunks.append((path, (int(match[1]), int(match[2]))))
        return chunks

    def _read(self, path: Path) -> tuple[Statistics | None, list[Range]]:
        """Statistics in a file, whole or not at all, and the ranges a merged one covers."""
        statistics = self._plan.empty()
        try:
            with path.open("rb") as stream, np.load(stream) as stored:
                arrays = dict(stored)
            statistics.add_packed(arrays)  # a file without the table that is asked for is no use
            ranges = [(int(a), int(b)) for a, b in arrays.get("ranges", np.empty((0, 2)))]
        except (OSError, ValueError, KeyError, IndexError, EOFError, BadZipFile, zlib.error):
            return None, []
        return statistics, ranges

    def _save(self, path: Path, arrays: dict[str, np.ndarray]) -> None:
        import io

        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        self._write(path, buffer.getbuffer())

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
