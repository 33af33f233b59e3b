"""What a compiled library depends on, as one key: its source, the compiler and the machine."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from certrack.core.processes import run_command

#: Raised by every change of what is kept under a key.
LAYOUT = 1

#: Variables that change what a compiler finds, or the flags that it is given.
VARIABLES = (
    *("CPATH", "C_INCLUDE_PATH", "LIBRARY_PATH", "COMPILER_PATH", "GCC_EXEC_PREFIX"),
    *("SDKROOT", "MACOSX_DEPLOYMENT_TARGET", "LD_RUN_PATH"),
    *("CCC_OVERRIDE_OPTIONS", "NIX_CFLAGS_COMPILE", "NIX_LDFLAGS"),
)

#: Lines of /proc/cpuinfo that say what a processor can do; others change from start to start.
PROCESSOR = set(
    "vendor_id cpu_family model model_name stepping flags Features isa cpu machine".split()
) | {f"CPU_{name}" for name in "implementer architecture variant part revision".split()}

#: A compiler says its version at once, s.
VERSION_TIMEOUT = 5.0


def library_key(
    sources: Mapping[str, str], flags: Sequence[str], libraries: Sequence[str], compiler: str
) -> str:
    """Key of a library: 64 hexadecimal digits.

    Parameters
    ----------
    sources : mapping
        Text of every file, by name.
    flags, libraries : texts
        Arguments of the compiler.
    compiler : path
    """
    variables = [os.environ.get(name) for name in VARIABLES]
    parts = (LAYOUT, list(sources.items()), list(flags), list(libraries), variables)
    text = repr((*parts, _compiler(compiler), machine()))
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _compiler(path: str) -> tuple[object, ...]:
    """Which program it is: a new version has another size, time or text."""
    try:
        real = Path(path).resolve(strict=True)
        status = real.stat()
    except OSError:
        return (path,)
    identity = (path, str(real), status.st_size, status.st_mtime_ns, status.st_ino)
    return (*identity, _version(*identity))


@lru_cache(maxsize=16)
def _version(path: str, *_: object) -> str:
    """What the compiler says of its version (-v), once while its file stays what it is."""
    with suppress(OSError, subprocess.TimeoutExpired), tempfile.TemporaryDirectory() as folder:
        return run_command([path, "-v"], Path(folder), VERSION_TIMEOUT)[1]
    return ""


@lru_cache(maxsize=1)
def machine() -> tuple[object, ...]:
    """Processor, system and C library: what code "for this machine" is made for.

    Where the processor's abilities are not listed, the machine's name stands for them: of a home
    folder that several machines share each then uses its own libraries.
    """
    try:
        listed = Path("/proc/cpuinfo").read_text("utf-8", errors="replace")
    except OSError:
        listed = ""
    pairs = (line.partition(":") for line in listed.partition("\n\n")[0].splitlines())
    known = {name.strip().replace(" ", "_"): value.strip() for name, _, value in pairs}
    can = sorted((name, value) for name, value in known.items() if name in PROCESSOR)
    lists_abilities = {"flags", "Features", "isa"} & known.keys()
    return (
        sys.platform,
        platform.machine(),
        platform.libc_ver(),
        can if lists_abilities else (*can, platform.node()),
    )
