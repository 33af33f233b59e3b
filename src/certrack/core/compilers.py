"""The C compiler of this machine: where it is, and one way to run it.

Compiled ensembles, the exported controller in the simulated loop and FMUs all need one. They
differ in their flags only; the same problem has the same message everywhere.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from certrack.core.errors import CertrackError, one_line, shorten

#: Programs that are looked for, in this order, after the one that the variable CC names. gcc comes
#: first: its code for the vectors of an ensemble is the fastest.
COMPILERS = ("gcc", "clang", "cc")

#: The largest ensemble programs take seconds; a compilation that takes longer than this hangs, s.
COMPILE_TIMEOUT = 300.0

#: So many characters of what a compiler says stand in a message.
MAX_REASON = 200

#: The file that is built, within a folder of its own.
LIBRARY = "library.so"


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
        code, message = _run_command([path, *arguments, "-o", LIBRARY], folder, timeout)
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
    with _temporary_library(sources, flags, libraries, compiler, timeout) as file:
        _load(file)
        return file.read_bytes()


def load_library(
    sources: Mapping[str, str],
    flags: Sequence[str],
    *,
    libraries: Sequence[str] = ("-lm",),
    compiler: str | None = None,
    timeout: float = COMPILE_TIMEOUT,
) -> ctypes.CDLL:
    """The shared library that is compiled from sources, in memory.

    Parameters
    ----------
    sources, flags, libraries, compiler, timeout
        As in :func:`shared_library`.

    Raises
    ------
    CompilerError
        As :func:`run_compiler`; also where the library does not run on this machine.
    """
    with _temporary_library(sources, flags, libraries, compiler, timeout) as file:
        return _load(file)


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


def _load(file: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(file))  # stays loaded when the file is gone
    except OSError as problem:
        raise CompilerError(
            f"what the C compiler built cannot be loaded: {shorten(str(problem), MAX_REASON)}"
        ) from None


@contextmanager
def _temporary_library(
    sources: Mapping[str, str],
    flags: Sequence[str],
    libraries: Sequence[str],
    compiler: str | None,
    timeout: float,
) -> Iterator[Path]:
    """The library as a file, for a while."""
    with ExitStack() as stack:
        try:
            temporary = tempfile.TemporaryDirectory(
                prefix="certrack-",
                ignore_cleanup_errors=True,  # Windows keeps the file of a loaded library
            )
            folder = Path(stack.enter_context(temporary))
            for file, text in sources.items():
                (folder / file).write_text(text, "utf-8")
        except OSError as problem:
            raise CompilerError(
                f"no temporary files can be written for the C compiler ({problem.strerror})"
            ) from None
        units = [file for file in sources if file.endswith(".c")]
        arguments = [*flags, *units, *libraries]
        yield run_compiler(arguments, folder, compiler=compiler, timeout=timeout)


def _run_command(command: Sequence[str], folder: Path, timeout: float) -> tuple[int, str]:
    """Exit code and standard error of a command, which starts a group of processes of its own.

    A compiler starts others, which would go on if it alone were ended.
    """
    process = subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        _, message = process.communicate(timeout=timeout)
    except BaseException:  # also where the user interrupts
        _kill_group(process)
        raise
    return process.returncode, message.decode(errors="replace")


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """End a process and all that it started."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
    if process.stderr is not None:
        process.stderr.close()  # not read to its end: what survives may hold it open


def _reason(code: int, message: str) -> str:
    """The first line that names an error, else the first one, else the exit code."""
    lines = [line for line in message.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line]
    return shorten(one_line((errors or lines or [f"exit code {code}"])[0].strip()), MAX_REASON)
