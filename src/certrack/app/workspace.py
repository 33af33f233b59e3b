"""The files of one folder: no other is read or written, by whatever name."""

from __future__ import annotations

import hashlib
import itertools
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from certrack.app.messages import require_text_size
from certrack.core.errors import InputError
from certrack.core.files import REMEDIES, write_text
from certrack.systems.tables import read_bytes

#: Files that a page is told of, folders below that are looked into, and entries that are looked at.
MAX_LISTED, MAX_DEPTH, MAX_SCANNED = 200, 3, 20_000

#: Files that are looked into for a list, and how long all of it may take, s.
MAX_LOOKED_INTO, LONGEST_LISTING = 2000, 3.0

#: Characters of a name, which is looked up part by part.
MAX_PATH_LENGTH = 1000


@dataclass(frozen=True)
class TextFile:
    """A file as it was read.

    Attributes
    ----------
    text : str
    digest : str
        Of its bytes, by which a change on the disk is seen.
    """

    text: str
    digest: str


class FileChanged(InputError):
    """A file is not what the page knows of it.

    Attributes
    ----------
    digest : str
        Of what is there now.
    """

    def __init__(
        self, key: str, expected: str, got: Any = None, remedy: str = "", *, digest: str = ""
    ) -> None:
        super().__init__(key, expected, got, remedy)
        self.digest = digest


class Workspace:
    """A folder.

    Parameters
    ----------
    folder : path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self._writing = threading.Lock()

    def files(self) -> list[str]:
        """System files in it, by their names below it; of a huge folder those found in time."""
        names = []
        end = time.monotonic() + LONGEST_LISTING
        candidates = _system_files(self.folder, MAX_DEPTH, end)
        for path in itertools.islice(candidates, MAX_LOOKED_INTO):
            if time.monotonic() > end:
                break
            try:
                inside = path.resolve().is_relative_to(self.folder) and path.is_file()
            except (OSError, RuntimeError):  # links in a circle
                continue
            if inside and "[plant]" in _beginning(path):
                names.append(path.relative_to(self.folder).as_posix())
            if len(names) == MAX_LISTED:
                break
        return sorted(names)

    def read(self, name: str) -> TextFile:
        """A file.

        Raises
        ------
        InputError
            If it is not in the folder or cannot be read.
        """
        path = self._path(name)
        try:
            data = read_bytes(path)
        except OSError as problem:
            raise InputError(name, f"cannot be read ({problem.strerror or problem})") from None
        require_text_size(name, data)
        try:
            return TextFile(data.decode("utf-8-sig"), _digest(data))
        except UnicodeDecodeError:
            raise InputError(name, "is not a text file (UTF-8)") from None

    def write(self, name: str, text: str, *, known: str) -> tuple[str, str]:
        """Write a file whole or not at all.

        Parameters
        ----------
        name, text : str
        known : str
            Digest of the file that may be replaced; empty where there must be none.

        Returns
        -------
        name and digest
            Of the file as it is now.

        Raises
        ------
        FileChanged
            If there is another file than the one that is known.
        InputError
            If it is not in the folder or cannot be written.
        """
        self._path(name)
        path = self._path(name if name.endswith(".toml") else f"{name}.toml")
        shown, data = path.relative_to(self.folder).as_posix(), text.encode()
        require_text_size(shown, data)
        with self._writing:
            there = _digest_of(path)
            if there not in ("", known):
                reason = (
                    "has changed on the disk since it was opened" if known else "exists already"
                )
                raise FileChanged(shown, reason, digest=there)
            write_text(path, text)
        return shown, _digest(data)

    def _path(self, name: str) -> Path:
        """A path that is surely in the folder, links resolved."""
        outside = InputError(name, f"is not in {self.folder}", remedy="Start certrack app there")
        if not name or "\0" in name or len(name) > MAX_PATH_LENGTH:
            raise outside
        try:
            path = (self.folder / name).resolve()
        except (OSError, RuntimeError):  # links in a circle
            raise outside from None
        if not path.is_relative_to(self.folder) or path == self.folder:
            raise outside
        try:
            no_file = path.exists() and not path.is_file()
        except OSError as problem:  # a part that is too long, a folder that may not be looked into
            reason = f"cannot be looked up ({problem.strerror or problem})"
            raise InputError(name, reason, remedy=REMEDIES.get(problem.errno or 0, "")) from None
        if no_file:
            raise InputError(name, "is no file")
        return path


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _digest_of(path: Path) -> str:
    """The digest of a file; empty if there is none."""
    try:
        return _digest(read_bytes(path))
    except FileNotFoundError:
        return ""
    except OSError as problem:
        reason = f"cannot be read ({problem.strerror or problem})"
        raise InputError(path.name, reason) from None


def _system_files(folder: Path, depth: int, end: float) -> Iterator[Path]:
    """System files by their names, folder by folder, without what is hidden."""
    folders, left_to_scan = [(folder, depth)], MAX_SCANNED
    while folders and time.monotonic() < end:
        place, left = folders.pop(0)
        try:
            with os.scandir(place) as scanned:
                entries = list(itertools.islice(scanned, left_to_scan))
        except OSError:
            continue
        left_to_scan -= len(entries)
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.name.startswith("."):
                continue
            if entry.name.endswith(".toml"):
                yield Path(entry.path)
            elif left > 1 and _is_folder(entry):
                folders.append((Path(entry.path), left - 1))


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir(follow_symlinks=False)
    except OSError:
        return False


def _beginning(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return stream.read(1 << 16).decode("utf-8", "replace")
    except OSError:
        return ""
