"""The sampled controller as a co-simulation FMU (FMI 2.0 or 3.0), with sources and a binary.

The C of :mod:`certrack.export.c.source` does the work; ``fmi/fmi2.c`` and ``fmi/fmi3.c`` wrap it in
the interface, and a generated ``model.h`` tells them the names. Same system, same compiler: same
bytes.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import sys
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from certrack.core import checks
from certrack.core.compilers import shared_library
from certrack.core.errors import InputError
from certrack.core.files import write_bytes
from certrack.export.c.export import controller_files
from certrack.export.c.source import CCode, c_code
from certrack.export.fmu.description import DESCRIPTIONS, documentation_page
from certrack.export.fmu.monitored import monitored_header, monitored_variables
from certrack.export.identifiers import stem
from certrack.export.monitor import Monitor
from certrack.export.templates import fill_template, packaged_text
from certrack.systems.system import System

FMI_VERSIONS = ("2", "3")

SHARED_SOURCES = ("instance.h",)

#: Files of the interface, by version; the first one is compiled.
WRAPPERS = {
    "2": ("fmi2.c", "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3": ("fmi3.c", "fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}

#: Folder of the binary: (system, machine) -> (FMI 2, FMI 3).
BINARY_FOLDERS = {
    ("linux", "x86_64"): ("linux64", "x86_64-linux"),
    ("linux", "aarch64"): ("aarch64-linux", "aarch64-linux"),
    ("darwin", "x86_64"): ("darwin64", "x86_64-darwin"),
    ("darwin", "arm64"): ("aarch64-darwin", "aarch64-darwin"),
    ("win32", "AMD64"): ("win64", "x86_64-windows"),
}
LIBRARY_SUFFIXES = {"linux": ".so", "darwin": ".dylib", "win32": ".dll"}

FMU_FLAGS = "-std=c99 -O2 -fPIC -shared -fvisibility=hidden".split()

#: Of all files in the archive, so that the bytes do not depend on when it is written.
ARCHIVE_DATE = (1980, 1, 1, 0, 0, 0)


def fmu(
    system: System,
    name: str = "controller",
    *,
    version: str = "2",
    period: float | None = None,
    monitor: Monitor | None = None,
) -> bytes:
    """The controller of a system as an FMU.

    Parameters
    ----------
    system : System
    name : str
        Of the system or its file; the model identifier is derived from it.
    version : {"2", "3"}
        Of FMI.
    period : float > 0, s, optional
        Instead of that of the implementation.
    monitor : Monitor, optional

    Returns
    -------
    bytes
        Contents of NAME.fmu.

    Raises
    ------
    InputError
        If there is no period, or FMI has no name for this machine.
    CompilerError
        If there is no C compiler, or it failed.
    """
    checks.choice("--fmi", version, FMI_VERSIONS)
    code = c_code(system, name, period=period, monitor=monitor)
    interface = (*SHARED_SOURCES, *WRAPPERS[version], "model.h", *["monitored.h"] * bool(monitor))
    if code.name.lower() in {Path(file).stem for file in interface}:
        code = replace(code, name=stem(f"{code.name}_c"))
    folder = BINARY_FOLDERS[_machine()][FMI_VERSIONS.index(version)]
    suffix = LIBRARY_SUFFIXES[sys.platform]
    contents = _sources(code, version)
    token = _token(code, contents, version)
    contents["model.h"] = _model_header(code, token)
    binary = shared_library(contents, FMU_FLAGS)
    compiled = [f"{code.name}.c", WRAPPERS[version][0]]
    described = DESCRIPTIONS[version](code, token, compiled)
    licence = packaged_text("fmu/fmi/LICENSE")
    return _zipped(
        {name: text.encode() for name, text in described.items()}
        | {f"sources/{name}": text.encode() for name, text in contents.items()}
        | {"documentation/index.html": documentation_page(code).encode()}
        | {"documentation/licenses/fmi-headers.txt": licence.encode()}
        | {f"binaries/{folder}/{code.name}{suffix}": binary}
    )


def export_fmu(
    system: System,
    path: str | os.PathLike[str],
    *,
    version: str = "2",
    period: float | None = None,
    monitor: Monitor | None = None,
) -> Path:
    """Write the controller as an FMU, whole or not at all.

    Parameters
    ----------
    system : System
    path : path
        NAME.fmu; NAME names the model.
    version : {"2", "3"}
        Of FMI.
    period : float > 0, s, optional
        Instead of that of the implementation; needed if the system has none.
    monitor : Monitor, optional
        Adds inputs to enable and reset the controller, outputs that say which premise of the
        certificate does not hold, and what the monitor asks for besides.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If there is no period, FMI has no name for this machine, or the file cannot be written.
    CompilerError
        If there is no C compiler, or it failed.

    Examples
    --------
    >>> import certrack
    >>> certrack.export_fmu(certrack.load("dual-motor-drive"), "drive.fmu").name
    'drive.fmu'
    """
    file = Path(path)
    write_bytes(file, fmu(system, file.name, version=version, period=period, monitor=monitor))
    return file


def _sources(code: CCode, version: str) -> dict[str, str]:
    controller = controller_files(code)
    if code.monitor is not None:
        controller["monitored.h"] = monitored_header(code)
    interface = (*SHARED_SOURCES, *WRAPPERS[version])
    return controller | {name: packaged_text(f"fmu/fmi/{name}") for name in interface}


def _token(code: CCode, contents: Mapping[str, str], version: str) -> str:
    """What ties the binary to its description: a hash of both."""
    digest = hashlib.sha256()
    for text in (*contents.values(), *DESCRIPTIONS[version](code, "", []).values()):
        digest.update(text.encode())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16], version=5)}}}"


def _model_header(code: CCode, token: str) -> str:
    """The header that tells the wrapper the names."""
    implementation = code.system.implementation
    assert implementation is not None
    return fill_template(
        "fmu/templates/model.h",
        name=code.name,
        header=f"{code.name}_guard.h" if code.monitor is None else "monitored.h",
        part=code.name if code.monitor is None else "monitored",
        step=f"{code.name}_guarded_step" if code.monitor is None else "monitored_step",
        token=token,
        kept=len(code.members) + len(monitored_variables(code)),
        period=repr(implementation.period),
        start=repr(implementation.initial_input),
    )


def _machine() -> tuple[str, str]:
    machine = sys.platform, platform.machine()
    if machine not in BINARY_FOLDERS:
        raise InputError("export fmu", "FMI has no name for this machine", " ".join(machine))
    return machine


def _zipped(contents: Mapping[str, bytes]) -> bytes:
    """An archive that depends on its contents alone."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as target:
        for name, data in contents.items():
            entry = zipfile.ZipInfo(name, ARCHIVE_DATE)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            target.writestr(entry, data)
    return archive.getvalue()
