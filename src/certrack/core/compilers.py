"""The C compiler of this machine: where it is, and one way to run it.

Compiled ensembles, the exported controller in the simulated loop and FMUs all need one. They
differ in their flags only; the same problem has the same message everywhere. Nothing is compiled
twice: what was built is kept in memory and, by ``library_cache.py``, on disk.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from certrack.core import library_cache
from certrack.core.errors import CertrackError, one_line, shorten
from certrack.core.library_key import library_key
from certrack.core.processes import run_command

#: Programs that are looked for, in this order, after the one that the variable CC names. gcc comes
#: first: its code for the vectors of an ensemble is the fastest.
COMPILERS = ("gcc", "clang", "cc")

#: The largest ensemble programs take seconds; a compilation that takes longer than this hangs, s.
COMPILE_TIMEOUT = 300.0

#: So many characters of what a compiler says stand in a message.
MAX_REASON = 200

#: The file that is built, within a folder of its own.
LIBRARY = "library.so"

#: What this process has loaded, by key. It stays loaded anyway, however it is asked for.
_LOADED: dict[str, ctypes.CDLL] = {}


class CompilerError(CertrackError):
    """There is no C compiler, or it failed."""


def c_compilers() -> list[str]:
    """Paths of the C compilers of this machine, the preferred one first; empty if there is none.

    First the program that the environment variable CC names, if it exists, then
    :data:`COMPILERS`.
    """
    names = (os.environ.get("CC", ""), *COMPILERS)
    paths = (shutil.which(name) for name in names if name)
    # absolute, for it runs in another folder than the one that CC or PATH is relative to
    return list(dict.fromkeys(str(Path(path).absolute()) for path in paths if path is not None))


def find_c_compiler() -> str:
    """Path of the C compiler.

    Raises
    ------
    CompilerError
        If there is none.
    """
    for path in c_compilers():
        return path
    raise CompilerError("no C compiler was found: install gcc or clang")


def run_compiler(
    arguments: Sequence[str],
    folder: Path,
    *,
    compiler: str | None = None,
    timeout: float = COMPILE_TIMEOUT,
) -> Path:
    """Run a C compiler in a folder.

    Parameters
    ----------
    arguments : texts
        Flags, files and libraries, without ``-o``.
    folder : path
        Where the files are, and where the result is written.
    compiler : path, optional
        Instead of :func:`find_c_compiler`.
    timeout : float, s

    Returns
    -------
    path
        The file that was built.

    Raises
    ------
    CompilerError
        If there is no compiler, or it cannot be run, fails, takes too long or writes nothing.
    """
    path = find_c_compiler() if compiler is None else compiler
    target = folder / LIBRARY
    try:
        code, message = run_command([path, *arguments, "-o", LIBRARY], folder, timeout)
    except OSError as problem:
        raise CompilerError(
            f"the C compiler {path} cannot be run ({problem.strerror}): install gcc or clang"
        ) from None
    except subprocess.TimeoutExpired:
        raise CompilerError(f"the C compiler {path} took longer than {timeout:g} s") from None
    if code:
        raise CompilerError(f"the C compiler {path} failed: {_reason(code, message)}")
    if not target.is_file():
        raise CompilerError(f"the C compiler {path} reported success but wrote no file")
    return target


def shared_library(
    sources: Mapping[str, str],
    flags: Sequence[str],
    *,
    libraries: Sequence[str] = ("-lm",),
    compiler: str | None = None,
    timeout: float = COMPILE_TIMEOUT,
) -> bytes:
    """Contents of the shared library that is compiled from sources, for this machine.

    Parameters
    ----------
    sources : mapping
        Text of every file, by name; those named ``*.c`` are compiled, in this order.
    flags : texts
        Before the files.
    libraries : texts
        After them.
    compiler, timeout
        As in :func:`run_compiler`.

    Raises
    ------
    CompilerError
        As :func:`load_library`: CC may name a compiler for another machine.
    """
    key = _key(sources, flags, libraries, compiler)
    data = None if key is None else library_cache.lookup(key)
    return _build(key, sources, flags, libraries, compiler, timeout)[0] if data is None else data


def load_library(
    sources: Mapping[str, str],
    flags: Sequence[str],
    *,
    libraries: Sequence[str] = ("-lm",),
    compiler: str | None = None,
    timeout: float = COMPILE_TIMEOUT,
) -> ctypes.CDLL:
    """The shared library that is compiled from sources, in memory.

    All who load the same sources get the same one: its functions must not keep anything between
    calls.

    Parameters
    ----------
    sources, flags, libraries, compiler, timeout
        As in :func:`shared_library`.

    Raises
    ------
    CompilerError
        As :func:`run_compiler`; also where the library does not run on this machine.
    """
    key = _key(sources, flags, libraries, compiler)
    if key is None:
        return _build(key, sources, flags, libraries, compiler, timeout)[1]
    if key not in _LOADED:
        _LOADED[key] = (
            _load_stored(key) or _build(key, sources, flags, libraries, compiler, timeout)[1]
        )
    return _LOADED[key]


def function_of(library: ctypes.CDLL, name: str) -> Any:
    """A function of a library that was compiled.

    Raises
    ------
    CompilerError
        If it has none of this name: CC may name what is no C compiler.
    """
    try:
        return getattr(library, name)
    except AttributeError:
        raise CompilerError(f"what the C compiler built has no function {name}") from None


def _key(
    sources: Mapping[str, str], flags: Sequence[str], libraries: Sequence[str], compiler: str | None
) -> str | None:
    """Under which a library is kept; None if none is."""
    if library_cache.is_off():
        return None
    return library_key(sources, flags, libraries, compiler or find_c_compiler())


def _load_stored(key: str) -> ctypes.CDLL | None:
    """The library of a key from the disk: a copy of the bytes that were checked is loaded."""
    data = library_cache.lookup(key)
    if data is None:
        return None
    with _temporary_folder() as folder:
        file = folder / LIBRARY
        _write_file(file, data)
        try:
            return _load(file)
        except CompilerError:
            return None  # what it needs is gone: compiled anew


def _build(
    key: str | None,
    sources: Mapping[str, str],
    flags: Sequence[str],
    libraries: Sequence[str],
    compiler: str | None,
    timeout: float,
) -> tuple[bytes, ctypes.CDLL]:
    """The library, compiled and loaded; it is kept if it has a key."""
    with _temporary_folder() as folder:
        for name, text in sources.items():
            _write_file(folder / name, text.encode())
        units = [name for name in sources if name.endswith(".c")]
        arguments = [*flags, *units, *libraries]
        file = run_compiler(arguments, folder, compiler=compiler, timeout=timeout)
        library, data = _load(file), file.read_bytes()
    if key is not None:
        library_cache.store(key, data)
    return data, library


def _load(file: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(file))  # stays loaded when the file is gone
    except OSError as problem:
        raise CompilerError(
            f"what the C compiler built cannot be loaded: {shorten(str(problem), MAX_REASON)}"
        ) from None


@contextmanager
def _temporary_folder() -> Iterator[Path]:
    """A folder that only this user may enter, for a while."""
    try:
        folder = tempfile.TemporaryDirectory(
            prefix="certrack-",
            ignore_cleanup_errors=True,  # Windows keeps the file of a loaded library
        )
    except OSError as problem:
        raise _nowhere_to_write(problem) from None
    with folder as path:
        yield Path(path)


def _write_file(file: Path, data: bytes) -> None:
    try:
        file.write_bytes(data)
    except OSError as problem:
        raise _nowhere_to_write(problem) from None


def _nowhere_to_write(problem: OSError) -> CompilerError:
    return CompilerError(
        f"no temporary files can be written for the C compiler ({problem.strerror})"
    )


def _reason(code: int, message: str) -> str:
    """The first line that names an error, else the first one, else the exit code."""
    lines = [line for line in message.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line]
    return shorten(one_line((errors or lines or [f"exit code {code}"])[0].strip()), MAX_REASON)
