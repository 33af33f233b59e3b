"""The files of one folder: no other is read or written, by whatever name."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from certrack.core.errors import InputError
from certrack.core.files import write_text
from certrack.systems.tables import read_bytes

#: Files that a page is told of, folders below that are looked into, and entries that are looked at.
MAX_LISTED, MAX_DEPTH, MAX_SCANNED = 200, 3, 20_000

#: Characters of a name, which is looked up part by part.
MAX_PATH_LENGTH = 1000

#: A longer text is no file for a page.
MAX_TEXT_BYTES = 1 << 20


class Workspace:
    """A folder.

    Parameters
    ----------
    folder : path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()

    def files(self) -> list[str]:
        """System files in it, by their names below it."""
        names = []
        for path in _system_files(self.folder, MAX_DEPTH):
            try:
                inside = path.resolve().is_relative_to(self.folder) and path.is_file()
            except (OSError, RuntimeError):  # links in a circle
                continue
            if inside and "[plant]" in _beginning(path):
                names.append(path.relative_to(self.folder).as_posix())
            if len(names) == MAX_LISTED:
                break
        return sorted(names)

    def read(self, name: str) -> str:
        """The text of a file.

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
        if len(data) > MAX_TEXT_BYTES:
            raise InputError(name, "is larger than 1 MB", remedy="Use the command line")
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise InputError(name, "is not a text file (UTF-8)") from None

    def write(self, name: str, text: str, *, overwrite: bool) -> str:
        """Write a file whole or not at all; returns its name.

        Raises
        ------
        InputError
            If it is not in the folder, exists already, or cannot be written.
        """
        self._path(name)
        path = self._path(name if name.endswith(".toml") else f"{name}.toml")
        write_text(path, text, overwrite=overwrite)
        return path.relative_to(self.folder).as_posix()

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
        if path.exists() and not path.is_file():
            raise InputError(name, "is no file")
        return path


def _system_files(folder: Path, depth: int) -> Iterator[Path]:
    """System files by their names, folder by folder, without what is hidden."""
    folders, looked = [(folder, depth)], 0
    while folders:
        place, left = folders.pop(0)
        try:
            entries = sorted(os.scandir(place), key=lambda entry: entry.name)
        except OSError:
            continue
        for entry in entries:
            looked += 1
            if looked > MAX_SCANNED:
                return
            if entry.name.startswith("."):
                continue
            if entry.name.endswith(".toml"):
                yield Path(entry.path)
            elif left > 1 and entry.is_dir(follow_symlinks=False):
                folders.append((Path(entry.path), left - 1))


def _beginning(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return stream.read(1 << 16).decode("utf-8", "replace")
    except OSError:
        return ""
