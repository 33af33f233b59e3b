"""System files: TOML to objects and back.

Every error names the file, the line, the key, what is expected and what came. Numbers may be
formulas of the plant's constants; those of plant and truth keep their text, so that a saved file
reads like the loaded one.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from certrack.core import checks
from certrack.core.budget import within_budget
from certrack.core.errors import InputError
from certrack.laws import Law, known_laws
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth, constants_of_truth
from certrack.systems.keys import LAW_TABLES, TABLES, TRUTH_TABLES, law_keys
from certrack.systems.lines import line_of
from certrack.systems.reference_reader import read_reference
from certrack.systems.shipped import shipped_names, shipped_text
from certrack.systems.system import Settings, System
from certrack.systems.tables import read_bytes, read_values, refuse_keys_of_another
from certrack.systems.toml import parse_toml

#: What loading may take: about five times what a million samples take. See core/budget.py.
LOAD_SECONDS, LOAD_MEGABYTES = 60, 2000

#: Tables of the file, and those that it must have.
SECTIONS = (
    "title",
    "plant",
    "truth",
    "reference",
    "law",
    "simulation",
    "ensemble",
    "implementation",
)
REQUIRED_SECTIONS = SECTIONS[1:6]

#: Tables of the plant.
PLANT_TABLES = ("constants", "ranges", "uncertainty")

#: What is said where a kind of law is not known.
OWN_LAW = (
    "A law of your own: certrack.laws.register makes it known in one Python process; the command "
    "line knows those of installed packages that declare an entry point of the group certrack.laws"
)


def load(source: str | os.PathLike[str]) -> System:
    """Load a system file, or a shipped system by its name.

    Parameters
    ----------
    source : path or name
        E.g. ``"my_drive.toml"`` or ``"example1"``.

    Returns
    -------
    System

    Raises
    ------
    InputError
        If the file cannot be read or anything in it does not fit.

    Examples
    --------
    >>> import certrack
    >>> certrack.load("example1").plant.states
    ('x1', 'x2')
    """
    if not isinstance(source, (str, os.PathLike)):
        raise InputError("source", "must be a path or the name of a shipped system", source)
    path = Path(source)
    try:
        if path.suffix == "" and (
            not path.exists() or (path.is_dir() and str(source) in shipped_names())
        ):
            return loads(shipped_text(str(source)), f"{source}.toml")
        data = read_bytes(path)
    except OSError as problem:
        raise InputError(str(source), f"cannot be read ({problem.strerror or problem})") from None
    except InputError:
        raise
    except ValueError as problem:  # a NUL byte in the name
        raise InputError(str(source), f"is not a file name ({problem})") from None
    return loads(data, str(source), path.parent)


def loads(text: str | bytes, name: str = "<text>", folder: Path | None = None) -> System:
    """Load a system from TOML text.

    Parameters
    ----------
    text : str or bytes
        UTF-8.
    name : str
        What messages call the file.
    folder : Path, optional
        Where sample files lie; without it they are refused.

    Returns
    -------
    System

    Raises
    ------
    InputError
        If anything in it does not fit; it names the key and the line.

    Examples
    --------
    >>> import certrack
    >>> text = certrack.to_text(certrack.load("example1"))
    >>> certrack.loads(text) == certrack.load("example1")
    True
    """
    try:
        return within_budget(
            lambda: _loads(text, name, folder),
            what="",
            seconds=LOAD_SECONDS,
            megabytes=LOAD_MEGABYTES,
        )
    except InputError as problem:
        raise problem if problem.file else problem.within(name) from None


def _loads(text: str | bytes, name: str, folder: Path | None) -> System:
    decoded = _decoded(text)
    try:
        return _read_system(parse_toml(decoded), folder)
    except InputError as problem:
        raise problem.within(name, problem.line or line_of(decoded, problem.key)) from None


def _decoded(text: str | bytes) -> str:
    try:
        decoded = text.decode("utf-8") if isinstance(text, bytes) else text
    except UnicodeDecodeError:
        raise InputError("", "is not a text file (UTF-8)") from None
    if not decoded.strip():
        raise InputError("", "is empty", remedy="certrack new NAME.toml writes a starter file")
    return decoded


def _read_system(tables: dict[str, Any], folder: Path | None) -> System:
    _refuse_keys_above_their_table(tables)
    checks.known_keys("", tables, SECTIONS, required=REQUIRED_SECTIONS)
    plant = _read_plant(tables["plant"])
    constants = plant.constant_values
    settings = Settings(**read_values("simulation", tables["simulation"], constants))
    law = _read_law(tables["law"], constants)
    if law.observer is not None and "implementation" not in tables:
        remedy = "Add a table [implementation]"
        raise InputError("law.observer", "needs samples to estimate from", remedy=remedy)
    return System(
        plant=plant,
        law=law,
        reference=read_reference(
            tables["reference"],
            constants,
            folder,
            settings.duration,
            plant.units[0] if plant.units else "",
        ),
        truth=_read_truth(tables["truth"], plant),
        settings=settings,
        title=checks.text("title", tables.get("title", "")),
        population=_read_population(tables.get("ensemble"), constants),
        implementation=_read_implementation(tables.get("implementation"), constants),
    )


def _refuse_keys_above_their_table(tables: Mapping[str, Any]) -> None:
    """Say of a table or key without the table that it stands in, which one that is."""
    for name in tables:
        if name in SECTIONS:
            continue
        if name in PLANT_TABLES:
            remedy = f"Did you mean [plant.{name}]?"
            raise InputError(name, "is not a table of its own", remedy=remedy)
        tables_of_it = [table for table, keys in TABLES.items() if table and name in keys]
        owners = dict.fromkeys(table.partition("[")[0] for table in tables_of_it)
        if owners:
            remedy = f"It belongs below {' or '.join(f'[{table}]' for table in owners)}"
            raise InputError(name, "stands above its table", remedy=remedy)


def _read_named_values(table: str, entries: Any) -> dict[str, Any]:
    """A table whose names the user chooses."""
    checks.known_keys(table, entries, entries)
    return dict(entries)


def _read_plant(table: Any) -> Plant:
    names = list(dict.fromkeys([*TABLES["plant"], *PLANT_TABLES]))
    checks.known_keys("plant", table, names, required=("states",))
    values = dict(table)
    ranges = _read_named_values("plant.ranges", values.pop("ranges", {}))
    if "uncertainty" in values:
        keys = TABLES["plant.uncertainty"]
        required = [name for name, key in keys.items() if key.required]
        checks.known_keys("plant.uncertainty", values["uncertainty"], keys, required=required)
    if "gain_sign" not in values:
        raise InputError("plant.gain_sign", "is missing", remedy="State 1 or -1")
    values["constants"] = _read_named_values("plant.constants", values.get("constants", {}))
    values["input_gain_range"] = ranges.pop("input_gain", None)
    values["theta_range"] = ranges.pop("theta", None)
    values["constant_ranges"] = ranges
    return Plant(**values)


def _read_truth(table: Any, plant: Plant) -> Truth:
    checks.known_keys("truth", table, [*TABLES["truth"], *TRUTH_TABLES])
    constants = _read_named_values("truth.constants", table.get("constants", {}))
    values = table | {"constants": constants}
    if "tau" in values and "states" not in values:
        numbers = constants_of_truth(plant, constants) if constants else plant.constant_values
        values["tau"] = TABLES["truth"]["tau"].evaluated("truth.tau", values["tau"], numbers)
    for name, kind in TRUTH_TABLES.items():
        if name in values:
            known = plant.constant_values
            values[name] = kind(**read_values(f"truth.{name}", values[name], known))
    return Truth(**values)


def _read_law(table: Any, constants: Mapping[str, Any]) -> Law:
    if not isinstance(table, dict):
        raise InputError("law", "must be a table [law]", table)
    laws = known_laws()
    if "kind" not in table:
        raise InputError("law.kind", "is missing", remedy="Known: " + ", ".join(laws))
    law = laws[checks.choice("law.kind", table["kind"], laws, OWN_LAW)]
    below = {name: table[name] for name in LAW_TABLES if name in table}
    table = {name: value for name, value in table.items() if name not in below}
    refuse_keys_of_another("law", table, "law", {name: law_keys(laws[name]) for name in laws})
    values = read_values("law", table, constants, law_keys(law))
    del values["kind"]
    for name, entries in below.items():
        values[name] = LAW_TABLES[name](**read_values(f"law.{name}", entries, constants))
    return law(**values)


def _read_population(table: Any, constants: Mapping[str, Any]) -> Population | None:
    if table is None:
        return None
    names = [*TABLES["ensemble"], "reference"]
    checks.known_keys("ensemble", table, names)
    entries = dict(table)
    factors = read_values("ensemble.reference", entries.pop("reference", {}), constants)
    if "constants" in entries:
        entries["constants"] = _read_named_values("ensemble.constants", entries["constants"])
    return Population(**read_values("ensemble", entries, constants), **factors)


def _read_implementation(table: Any, constants: Mapping[str, Any]) -> Implementation | None:
    if table is None:
        return None
    return Implementation(**read_values("implementation", table, constants))
