"""Export of the controller as C99 with its acceptance test."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from certrack.core.errors import InputError
from certrack.core.files import write_folder
from certrack.export.c.acceptance_test import acceptance_test
from certrack.export.c.guard import guard_header
from certrack.export.c.monitor import monitor_header
from certrack.export.c.readme import README_KIND, readme
from certrack.export.c.source import CCode, c_code
from certrack.export.c.torque_split import split_header
from certrack.export.golden_vectors import golden_vectors
from certrack.export.monitor import Monitor
from certrack.systems.system import System


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes
    ----------
    name : str
        Prefix of files and functions.
    files : paths
    notes : texts
        What the user should know.
    """

    name: str
    files: tuple[Path, ...]
    notes: tuple[str, ...]


def controller_files(code: CCode) -> dict[str, str]:
    """Contents of the files of a controller, by name; those that run on the drive."""
    files = {
        f"{code.name}.h": code.header,
        f"{code.name}.c": code.source,
        f"{code.name}_guard.h": guard_header(code),
    }
    if code.monitor is not None:
        files[f"{code.name}_monitor.h"] = monitor_header(code)
    if code.system.truth.motors is not None:
        files[f"{code.name}_split.h"] = split_header(code)
    return files


def c_files(code: CCode) -> dict[str, str]:
    """Contents of all files of an export, by name."""
    vectors = golden_vectors(code.system, code.program, code.real)
    return {
        **controller_files(code),
        f"{code.name}_test.c": acceptance_test(code, vectors),
        "README.md": readme(code, code.notes),
    }


def export_c(
    system: System,
    folder: str | os.PathLike[str],
    name: str = "controller",
    *,
    real: str = "double",
    period: float | None = None,
    monitor: Monitor | None = None,
) -> Exported:
    """Write the controller as C to a folder: header, source, guard, test and README, or nothing.

    Parameters
    ----------
    system : System
    folder : path
        Made if it does not exist.
    name : str
        Of the system or its file.
    real : {"double", "float"}
    period : float > 0, s, optional
        Instead of that of the system's implementation; needed if it has none.
    monitor : Monitor, optional
        Adds NAME_monitor.h: enable and disable, reset of the estimates, flags for the premises of
        the certificate, and what the monitor asks for besides.

    Where the truth has two motors, NAME_split.h shares u between them.

    Returns
    -------
    Exported

    Raises
    ------
    InputError
        If something does not fit, or the folder cannot be written to.

    Examples
    --------
    >>> import certrack
    >>> written = certrack.export_c(certrack.load("example1"), "firmware", "drive", period=0.001)
    >>> [path.name for path in written.files]
    ['drive.h', 'drive.c', 'drive_guard.h', 'drive_test.c', 'README.md']
    """
    code = c_code(system, name, real=real, period=period, monitor=monitor)
    return Exported(code.name, write_all(Path(folder), c_files(code)), code.notes)


def write_all(folder: Path, texts: dict[str, str]) -> tuple[Path, ...]:
    """Write files to a folder, all or none.

    Raises
    ------
    InputError
        If the folder cannot be made or written to, or has a README.md of another kind.
    """
    readme_file = folder / "README.md"
    try:
        foreign = README_KIND not in readme_file.read_text("utf-8", "replace")
    except FileNotFoundError:
        foreign = False
    except OSError as problem:
        raise InputError(
            str(folder), f"cannot be written ({problem.strerror})", remedy="Choose another folder"
        ) from None
    if foreign:
        raise InputError(
            str(readme_file), "is not of an exported controller", remedy="Choose another folder"
        )
    return write_folder(folder, texts)
