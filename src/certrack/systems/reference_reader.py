"""The reference of a system file: a formula, a kind with its keys, or a file of samples."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references import Reference, SoftStart, SymbolicReference, known_references
from certrack.references.keys import TRANSIENT
from certrack.systems.keys import reference_keys
from certrack.systems.samples_file import SamplesFile, check_time_unit, read_samples
from certrack.systems.tables import read_bytes, read_values, refuse_keys_of_another
from certrack.systems.value_units import check_value_unit, converted


def read_reference(
    table: Any,
    constants: Mapping[str, Any],
    folder: Path | None,
    duration: float,
    unit: str = "",
) -> Reference:
    """The reference that ``[reference]`` states.

    Parameters
    ----------
    table : object
        What the file has there.
    constants : mapping
        Those of the plant.
    folder : Path, optional
        Where files of samples lie.
    duration : float, s
        Of the run.
    unit : str
        Of the output; empty if the file does not say.
    """
    if not isinstance(table, dict):
        raise InputError("reference", "must be a table [reference]", table)
    if "transient" in table:
        entries = dict(table)
        transient = TRANSIENT.evaluated("reference.transient", entries.pop("transient"), constants)
        return SoftStart(read_reference(entries, constants, folder, duration, unit), transient)
    if "signal" in table:
        values = read_values("reference", table, constants)
        return SymbolicReference(
            signal=values["signal"],
            bound=values.get("bound"),
            declared=values.get("bounds"),
            constants=tuple(constants.items()),
        )
    if "kind" not in table:
        raise InputError("reference", "must have a signal or a kind", sorted(table))
    kinds = known_references()
    kind = checks.choice("reference.kind", table["kind"], kinds)
    entries = dict(table)
    file = entries.pop("file", None) if kind == "samples" else None
    if file is not None:
        samples = _samples_of_file(file, folder, entries.pop("columns", None))
        entries = _with_samples(entries, str(file), samples, duration, unit)
    elif kind == "samples":
        for name in ("columns", "value_unit"):
            if name in entries:
                raise InputError(f"reference.{name}", "is for a file of samples", entries[name])
    keys = {name: reference_keys(name) for name in kinds}
    refuse_keys_of_another("reference", entries, "reference", keys)
    values = read_values("reference", entries, constants, keys[kind])
    del values["kind"]
    try:
        return kinds[kind].make(**values)
    except InputError as problem:
        row = re.fullmatch(r"reference\.(?:times|values)\[(\d+)\]", problem.key)
        if file is None or row is None:
            raise
        what = f"row {samples.rows[int(row[1])]} of {file}: {problem.expected}"
        raise InputError("reference.file", what, problem.got) from None


def _with_samples(
    entries: dict[str, Any], file: str, samples: SamplesFile, duration: float, unit: str
) -> dict[str, Any]:
    """The entries with times and values, their units checked, instead of what is of the file."""
    for name in ("times", "values"):
        if name in entries:
            raise InputError(f"reference.{name}", "must be left out beside reference.file")
    if "time_unit" not in entries:
        check_time_unit(file, samples, duration)
    values = samples.values
    if "value_unit" in entries:
        stated = checks.text("reference.value_unit", entries.pop("value_unit"))
        values = converted(values, stated, unit)
    else:
        check_value_unit(file, samples.header, unit)
    return entries | {"times": samples.times, "values": values}


def _samples_of_file(name: Any, folder: Path | None, columns: Any) -> SamplesFile:
    """Times and values from a CSV file beside the system file."""
    key = "reference.file"
    relative = PurePosixPath(checks.text(key, name))
    if folder is None or relative.is_absolute() or ".." in relative.parts or "\\" in str(name):
        raise InputError(key, "must lie beside the system file or below it", name)
    try:
        data = read_bytes(folder / relative)
    except OSError as problem:
        raise InputError(
            key, f"cannot be read ({problem.strerror}) in {folder.resolve()}", name
        ) from None
    if columns is not None:
        entries = checks.sequence("reference.columns", columns, 2, "time and y_d")
        columns = [
            str(entry) if isinstance(entry, int) else checks.text(f"reference.columns[{i}]", entry)
            for i, entry in enumerate(entries)
        ]
    return read_samples(str(relative), data, columns)
