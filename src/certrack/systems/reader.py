"""System files: TOML to objects and back.

Every error names the file, the key, what is expected and what came. Numbers may be formulas of the
plant's constants; a loaded system keeps their text, so a saved file reads like the loaded one.
"""

from __future__ import annotations

import io
import os
import tomllib
import warnings
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.laws import Law, known_laws
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant, Uncertainty
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.references import Reference, SymbolicReference, piecewise
from certrack.systems.system import Settings, System
from certrack.systems.writer import field_values

MAX_BYTES = 20_000_000

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
PLANT_KEYS = (
    "states chain linear drift regressor gain_sign input_gain theta units constants ranges "
    "uncertainty"
).split()
TRUTH_KEYS = "input_gain theta omega tau constants states rates outputs".split()
POPULATION_KEYS = [
    *(entry.name for entry in fields(Population) if entry.name not in ("amplitude", "frequency")),
    "reference",
]
IMPLEMENTATION_KEYS = [entry.name for entry in fields(Implementation)]
SETTING_KEYS = [entry.name for entry in fields(Settings)]

#: kind -> (maker, required keys, optional keys)
SIGNALS: dict[str, tuple[Callable[..., Reference], tuple[str, ...], tuple[str, ...]]] = {
    "triangle": (piecewise.triangle, ("amplitude", "period"), ("offset", "start", "bound")),
    "trapezoid": (
        piecewise.trapezoid,
        ("amplitude", "period", "rise"),
        ("offset", "start", "bound"),
    ),
    "steps": (piecewise.steps, ("times", "levels", "slope"), ("bound",)),
    "samples": (piecewise.samples, ("times", "values"), ("interpolation", "bound")),
}


def catalog() -> dict[str, str]:
    """Names and titles of the shipped systems."""
    folder = files("certrack.systems") / "catalog"
    names = sorted(
        entry.name.removesuffix(".toml")
        for entry in folder.iterdir()
        if entry.name.endswith(".toml")
    )
    return {
        name: tomllib.loads((folder / f"{name}.toml").read_text("utf-8"))["title"] for name in names
    }


def starter() -> str:
    """Text of a commented system file to begin with."""
    return (files("certrack.systems") / "starter.toml").read_text("utf-8")


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
    """
    path = Path(source)
    try:
        if path.suffix == "" and (
            not path.exists() or (path.is_dir() and str(source) in catalog())
        ):
            return loads(_shipped(str(source)), f"{source}.toml")
        data = _read(path)
    except OSError as problem:
        raise InputError(str(source), f"cannot be read ({problem.strerror or problem})") from None
    except InputError:
        raise
    except ValueError as problem:  # a NUL byte in the name
        raise InputError(str(source), f"is not a file name ({problem})") from None
    return loads(data, str(source), path.parent)


def _read(path: Path) -> bytes:
    with path.open("rb") as stream:
        data = stream.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(str(path), f"is larger than {MAX_BYTES // 1_000_000} MB")
    return data


def _shipped(name: str) -> str:
    known = catalog()
    if name not in known:
        raise InputError(
            name,
            "is neither a file nor a shipped system",
            remedy="Shipped: " + ", ".join(known),
        )
    return (files("certrack.systems") / "catalog" / f"{name}.toml").read_text("utf-8")


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
    """
    try:
        return _system(_parse(text), folder)
    except InputError as problem:
        raise problem.within(name) from None


def _parse(text: str | bytes) -> dict[str, Any]:
    try:
        decoded = text.decode("utf-8") if isinstance(text, bytes) else text
    except UnicodeDecodeError:
        raise InputError("", "is not a text file (UTF-8)") from None
    if not decoded.strip():
        raise InputError("", "is empty", remedy="certrack new NAME.toml writes a starter file")
    try:
        return tomllib.loads(decoded)
    except (tomllib.TOMLDecodeError, ValueError) as problem:
        raise InputError("", f"is not TOML: {problem}") from None
    except RecursionError:
        raise InputError("", "is not TOML: nested too deeply") from None


def _system(tables: dict[str, Any], folder: Path | None) -> System:
    checks.known_keys("", tables, SECTIONS, required=SECTIONS[1:6])
    plant = _plant(tables["plant"])
    known = plant.constant_values
    law = _law(tables["law"], known)
    return System(
        plant=plant,
        law=law,
        reference=_reference(tables["reference"], plant, folder),
        truth=_truth(tables["truth"], plant),
        settings=_settings(tables["simulation"], known),
        title=checks.text("title", tables.get("title", "")),
        population=_population(tables["ensemble"]) if "ensemble" in tables else None,
        implementation=_implementation(tables.get("implementation")),
    )


def _plant(table: Any) -> Plant:
    checks.known_keys("plant", table, PLANT_KEYS, required=("states",))
    values = dict(table)
    constants = values.pop("constants", {})
    checks.known_keys("plant.constants", constants, constants)
    ranges = values.pop("ranges", {})
    checks.known_keys("plant.ranges", ranges, ("input_gain", "theta"))
    uncertainty = values.pop("uncertainty", None)
    if "gain_sign" not in values:
        raise InputError("plant.gain_sign", "is missing", remedy="State 1 or -1")
    plain = Plant(
        **values,
        constants=constants,
        input_gain_range=ranges.get("input_gain"),
        theta_range=ranges.get("theta"),
    )
    if uncertainty is None:
        return plain
    names = ("tau", "gamma", "beta")
    checks.known_keys("plant.uncertainty", uncertainty, names, required=names)
    known = plain.constant_values
    bounds = {
        name: checks.reals(
            f"plant.uncertainty.{name}",
            uncertainty[name],
            plain.n,
            "one number per state",
            known,
            least=0,
        )
        for name in names
    }
    return Plant(**{**field_values(plain), "uncertainty": Uncertainty(**bounds)})


def _truth(table: Any, plant: Plant) -> Truth:
    checks.known_keys("truth", table, TRUTH_KEYS)
    values = dict(table)
    constants = values.pop("constants", {})
    checks.known_keys("truth.constants", constants, constants)
    return Truth(**values, constants=constants).bound_to(plant)


def _law(table: Any, known: Mapping[str, Any]) -> Law:
    if not isinstance(table, dict):
        raise InputError("law", "must be a table [law]", table)
    if "kind" not in table:
        raise InputError("law.kind", "is missing", remedy="Known: " + ", ".join(known_laws()))
    laws = known_laws()
    law = laws[checks.choice("law.kind", table["kind"], laws)]
    entries = {entry.name: entry for entry in fields(law)}
    required = [name for name, entry in entries.items() if entry.default is MISSING]
    checks.known_keys("law", table, ["kind", *entries], required)
    values = {
        name: _numbers(f"law.{name}", value, known)
        for name, value in table.items()
        if name != "kind"
    }
    return law(**values)


def _numbers(key: str, value: Any, known: Mapping[str, Any]) -> Any:
    """Evaluate formulas of the constants in (nested) lists; the law checks shapes and limits."""
    if isinstance(value, list):
        return [_numbers(f"{key}[{i}]", entry, known) for i, entry in enumerate(value)]
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise InputError(key, "must be a number, a formula, or a list of them", value)
    if isinstance(value, int):
        return value
    return checks.real(key, value, known, infinite=True)


def _reference(table: Any, plant: Plant, folder: Path | None) -> Reference:
    if not isinstance(table, dict):
        raise InputError("reference", "must be a table [reference]", table)
    known = plant.constant_values
    if "signal" in table:
        checks.known_keys("reference", table, ("signal", "bound", "bounds"))
        bound = table.get("bound")
        return SymbolicReference(
            signal=table["signal"],
            bound=None if bound is None else checks.real("reference.bound", bound, known, above=0),
            declared=table.get("bounds"),
            constants=tuple(known.items()),
        )
    if "kind" not in table:
        raise InputError("reference", "must have a signal or a kind", sorted(table))
    kind = checks.choice("reference.kind", table["kind"], SIGNALS)
    make, required, optional = SIGNALS[kind]
    values = {name: value for name, value in table.items() if name != "kind"}
    if kind == "samples" and "file" in values:
        values |= _samples(values.pop("file"), folder)
    checks.known_keys("reference", values, (*required, *optional), required)
    for name, value in values.items():
        values[name] = (
            value if name == "interpolation" else _numbers(f"reference.{name}", value, known)
        )
    return make(**values)


def _samples(name: Any, folder: Path | None) -> dict[str, list[float]]:
    """Times and values from a CSV file beside the system file."""
    key = "reference.file"
    relative = PurePosixPath(checks.text(key, name))
    if folder is None or relative.is_absolute() or ".." in relative.parts or "\\" in str(name):
        raise InputError(key, "must lie beside the system file or below it", name)
    try:
        data = _read(folder / relative)
    except OSError as problem:
        raise InputError(key, f"cannot be read ({problem.strerror})", name) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty file is refused below
            table = np.loadtxt(io.StringIO(data.decode("utf-8")), delimiter=",", ndmin=2)
    except ValueError:
        raise InputError(
            key, "must have two numeric columns: time, y_d (no header, or a # line)", name
        ) from None
    if table.shape[1] != 2:
        raise InputError(key, "must have two columns: time, y_d", f"{table.shape[1]} columns")
    return {"times": table[:, 0].tolist(), "values": table[:, 1].tolist()}


def _settings(table: Any, known: Mapping[str, Any]) -> Settings:
    checks.known_keys("simulation", table, SETTING_KEYS, required=("x0", "duration"))
    values = {
        name: value if name == "integrator" else _numbers(f"simulation.{name}", value, known)
        for name, value in table.items()
    }
    return Settings(**values)


def _population(table: Any) -> Population:
    """The [ensemble] table as it stands; the system checks it against the plant."""
    checks.known_keys("ensemble", table, POPULATION_KEYS)
    values = dict(table)
    scales = values.pop("reference", {})
    checks.known_keys("ensemble.reference", scales, ("amplitude", "frequency"))
    constants = values.get("constants", {})
    checks.known_keys("ensemble.constants", constants, constants)
    return Population(**values, **scales)


def _implementation(table: Any) -> Implementation | None:
    """The [implementation] table as it stands; the system checks it against the plant."""
    if table is None:
        return None
    checks.known_keys("implementation", table, IMPLEMENTATION_KEYS, required=("period",))
    return Implementation(**table)
