"""Export of the controller as C99 with its acceptance test."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certrack.core.errors import InputError
from certrack.core.files import write_folder
from certrack.core.lowering import numpy_callable
from certrack.export.c.golden import golden
from certrack.export.c.readme import KIND, readme
from certrack.export.c.source import CCode, c_code
from certrack.export.c.test_source import test_source
from certrack.systems.system import System

#: Below this part of itself per sample, leakage is lost in the rounding of float.
STALLS = 1e-4


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


def files(code: CCode) -> dict[str, str]:
    """All files of an export, by name."""
    vectors = golden(code.system, code.program, code.real)
    return {
        f"{code.name}.h": code.header,
        f"{code.name}.c": code.source,
        f"{code.name}_test.c": test_source(code, vectors),
        "README.md": readme(code, notes(code)),
    }


def export(
    system: System,
    folder: str | os.PathLike[str],
    name: str = "controller",
    *,
    real: str = "double",
    period: float | None = None,
) -> Exported:
    """Write the controller as C to a folder: header, source, test and README, or nothing.

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

    Raises
    ------
    InputError
        If something does not fit, or the folder cannot be written to.
    """
    code = c_code(system, name, real=real, period=period)
    return Exported(code.name, write_all(Path(folder), files(code)), notes(code))


def notes(code: CCode) -> tuple[str, ...]:
    """What the user of this code should know."""
    share = _leak_share(code)
    if code.real == "double" or not share < STALLS:
        return ()
    stall = float(np.finfo(np.float32).eps) / 2 / share
    return (
        f"in float, estimates stall up to {stall:.1g} (relative) short of where leakage takes "
        f"them: it changes them by only {share:.1g} of themselves per sample. Use --real double "
        "or a longer period if that matters.",
    )


def _leak_share(code: CCode) -> float:
    """Part of itself by which leakage changes the slowest estimate per sample; inf without."""
    from dataclasses import replace

    from certrack.loops.controller import sampled_controller

    system, implementation = code.system, code.system.implementation
    assert implementation is not None
    controller = system.controller
    exact = sampled_controller(
        system.plant, controller, replace(implementation, update="exact_leak")
    )
    count = len(exact.estimates)
    if not count or not exact.leak:
        return np.inf
    leak = numpy_callable(controller.symbols, exact.leak)(*controller.values)
    rates = np.abs(np.diag(np.array(leak, dtype=float).reshape(count, count)))
    return float(rates[rates > 0].min(initial=np.inf) * implementation.period)


def write_all(folder: Path, texts: dict[str, str]) -> tuple[Path, ...]:
    """Write files to a folder, all or none.

    Raises
    ------
    InputError
        If the folder cannot be made or written to, or has a README.md of another kind.
    """
    readme = folder / "README.md"
    try:
        strange = readme.exists() and KIND not in readme.read_text("utf-8", "replace")
    except OSError as problem:
        raise InputError(str(readme), f"cannot be read ({problem.strerror})") from None
    if strange:
        raise InputError(
            str(readme), "is not of an exported controller", remedy="Choose another folder"
        )
    return write_folder(folder, texts)
