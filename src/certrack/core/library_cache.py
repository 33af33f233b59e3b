"""Compiled libraries on disk, so that nothing is compiled twice: private, checked and bounded.

Native code is loaded from what is kept here. So it lies in a folder that the user alone may enter:
one of another owner, with rights for others, or that is a symbolic link is not used, nor is such a
file in it. A file's name holds the digest of its key and contents; what does not agree with it is
thrown away. Callers get the bytes that were checked, never a path that could change afterwards.

A library takes its name in one step, when it is complete: processes that compile the same one at
the same time do no harm. The oldest are dropped beyond a limit. Where there is no folder, or no
room in it, nothing is kept and everything is compiled as if there was no cache: no error, no note.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from certrack.core.errors import CertrackError

#: Another folder than the user's cache; one of :data:`OFF` for none.
VARIABLE = "CERTRACK_CACHE"
OFF = ("", "0", "off", "no", "none")

#: Beyond it the libraries that were not used for the longest time are dropped, bytes. A library
#: has some 100 kB.
MAX_BYTES = 64 * 2**20

#: The folder itself, which nothing else uses.
LIBRARY_FOLDER = "libraries"

#: A library by key and digest, and one that is being written.
ENTRY = re.compile(r"(?P<key>[0-9a-f]{64})-(?P<digest>[0-9a-f]{64})\.library")
UNFINISHED = re.compile(r"[0-9a-f]{32}\.part")

#: What is being written for longer than this was left behind by a process that was killed, s.
WRITING_TIME = 3600.0


class CacheUnusable(CertrackError):
    """Why no library can be kept."""


@dataclass(frozen=True)
class CacheState:
    """What is kept.

    Attributes
    ----------
    place : path, optional
        The folder; None if the cache is turned off, or nobody's home is known.
    libraries, size : int
        How many there are, and their size together, bytes.
    trouble : str
        Why the folder is not used; empty if it is.
    """

    place: Path | None
    libraries: int
    size: int
    trouble: str


def is_off() -> bool:
    """Whether the variable turns the cache off."""
    return os.environ.get(VARIABLE, "on").strip().lower() in OFF


def location() -> Path:
    """The folder of the cache, which need not exist.

    Raises
    ------
    CacheUnusable
        If it is turned off, this system has no owners of files, or nobody's home is known.
    """
    if is_off():
        raise CacheUnusable(f"turned off by the environment variable {VARIABLE}")
    if os.name != "posix":
        raise CacheUnusable("kept in memory only: this system does not say who may write a file")
    if VARIABLE in os.environ:
        chosen = Path(os.environ[VARIABLE])
        if not chosen.is_absolute():
            raise CacheUnusable(f"the environment variable {VARIABLE} must be an absolute path")
        return chosen / LIBRARY_FOLDER
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # the specification says: then it is to be ignored
        try:
            home = Path.home()
        except RuntimeError:
            home = Path()
        if not home.is_absolute():
            raise CacheUnusable("there is no home folder")
        base = home / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return base / "certrack" / LIBRARY_FOLDER


def lookup(key: str) -> bytes | None:
    """The library of a key, or None.

    Parameters
    ----------
    key : str
        64 hexadecimal digits.
    """
    with suppress(CacheUnusable, OSError), _opened() as folder:
        for name in _names(folder):
            entry = ENTRY.fullmatch(name)
            if entry is None or entry["key"] != key:
                continue
            data = _contents(folder, name)
            if data is not None and secrets.compare_digest(_digest(key, data), entry["digest"]):
                with suppress(OSError):
                    os.utime(name, dir_fd=folder, follow_symlinks=False)  # used last
                return data
            with suppress(OSError):
                os.unlink(name, dir_fd=folder)
    return None


def store(key: str, data: bytes) -> None:
    """Keep a library, if that is possible.

    Parameters
    ----------
    key : str
        64 hexadecimal digits.
    data : bytes
    """
    if len(data) > MAX_BYTES:
        return
    with suppress(CacheUnusable, OSError):
        _make()
        with _opened() as folder:
            _write(folder, f"{key}-{_digest(key, data)}.library", data)
            _drop_oldest(folder)


def state() -> CacheState:
    """Where the cache is and what it holds, or why it is not used."""
    where = None
    try:
        where = location()
        with _opened() as folder:
            sizes = [size for _, size, _ in _entries(folder)]
            return CacheState(where, len(sizes), sum(sizes), "")
    except FileNotFoundError:
        return CacheState(where, 0, 0, "" if where is None else _cannot_be_made(where))
    except OSError as problem:
        return CacheState(where, 0, 0, problem.strerror or str(problem))
    except CacheUnusable as problem:
        return CacheState(where, 0, 0, str(problem))


def clear() -> CacheState:
    """Remove every library; other files stay.

    Returns
    -------
    CacheState
        What was there before.

    Raises
    ------
    CacheUnusable
        If a folder is there that is not ours, or in which nothing can be removed.
    """
    before = state()
    if before.place is None:
        return before
    try:
        with _opened() as folder:
            for name in _names(folder):
                if ENTRY.fullmatch(name) or UNFINISHED.fullmatch(name):
                    with suppress(FileNotFoundError):
                        os.unlink(name, dir_fd=folder)
    except FileNotFoundError:
        pass
    except (OSError, CacheUnusable) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise CacheUnusable(f"{before.place}: {reason}") from None
    return before


@contextmanager
def _opened() -> Iterator[int]:
    """The folder, open, as long as it is this user's alone: names are then looked up in it."""
    folder = os.open(location(), os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        status = os.fstat(folder)
        if status.st_uid != os.geteuid():
            raise CacheUnusable("it belongs to another user")
        if stat.S_IMODE(status.st_mode) & 0o077:
            raise CacheUnusable("others may enter it (make it private by chmod 700)")
        yield folder
    finally:
        os.close(folder)


def _make() -> None:
    """Make the folder, but not within what belongs to a third user, as root in a user's home."""
    folder = location()
    if folder.exists():
        return
    if trouble := _cannot_be_made(folder):
        raise CacheUnusable(trouble)
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)


def _cannot_be_made(folder: Path) -> str:
    """Why the folder cannot be made; empty if it can."""
    above = next(parent for parent in folder.parents if parent.exists())
    if above.stat().st_uid not in (0, os.geteuid()):
        return f"{above} belongs to another user"
    if not os.access(above, os.W_OK):
        return f"{above}: {os.strerror(errno.EACCES)}"
    return ""


def _contents(folder: int, name: str) -> bytes | None:
    """What a file holds, if it is a file of this user that nobody else may write."""
    with suppress(OSError):
        # a pipe in its place must not make us wait
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        with os.fdopen(os.open(name, flags, dir_fd=folder), "rb") as file:
            status = os.fstat(file.fileno())
            ours = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
            if ours and not status.st_mode & 0o022 and status.st_size <= MAX_BYTES:
                return file.read(MAX_BYTES + 1)
    return None


def _write(folder: int, name: str, data: bytes) -> None:
    """Write a file whole or not at all. What a power failure leaves of it has another digest."""
    unfinished = f"{secrets.token_hex(16)}.part"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with os.fdopen(os.open(unfinished, flags, 0o600, dir_fd=folder), "wb") as file:
            file.write(data)
        os.rename(unfinished, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with suppress(OSError):
            os.unlink(unfinished, dir_fd=folder)
        raise


def _drop_oldest(folder: int) -> None:
    """Remove what is too much, and what was never finished."""
    for name in _names(folder):
        if UNFINISHED.fullmatch(name):
            with suppress(OSError):
                age = time.time() - os.stat(name, dir_fd=folder, follow_symlinks=False).st_mtime
                if age > WRITING_TIME:
                    os.unlink(name, dir_fd=folder)
    entries = sorted(_entries(folder))
    excess = sum(size for _, size, _ in entries) - MAX_BYTES
    for _, size, name in entries:
        if excess <= 0:
            return
        with suppress(OSError):
            os.unlink(name, dir_fd=folder)
            excess -= size


def _names(folder: int) -> list[str]:
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries]


def _entries(folder: int) -> Iterator[tuple[int, int, str]]:
    """When each library was used last, its size and its name."""
    for name in _names(folder):
        if ENTRY.fullmatch(name):
            with suppress(FileNotFoundError):
                status = os.stat(name, dir_fd=folder, follow_symlinks=False)
                yield status.st_mtime_ns, status.st_size, name


def _digest(key: str, data: bytes) -> str:
    """Of both, so that no library takes another one's place."""
    return hashlib.sha256(key.encode() + data).hexdigest()
