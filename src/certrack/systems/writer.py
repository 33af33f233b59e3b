"""Systems to TOML text."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from certrack.core.checks import number_or_text
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, parse
from certrack.core.files import write_text
from certrack.core.rationals import RationalFloat
from certrack.laws import Law, LqrWeights, known_laws
from certrack.model.distribution import Distribution
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.references import PiecewiseReference, Reference, SoftStart, SymbolicReference
from certrack.references.registry import kind_of
from certrack.systems.keys import LAW_TABLES, TRUTH_TABLES
from certrack.systems.system import System, require_system

#: Lists of numbers from this length on are written as one item.
LONG_LIST = 200


def to_text(system: System) -> str:
    """The system as TOML text that :func:`loads` turns into an equal system.

    Parameters
    ----------
    system : System

    Returns
    -------
    str

    Examples
    --------
    >>> import certrack
    >>> certrack.to_text(certrack.load("dual-motor")).splitlines()[0]
    'title = "Dual-motor drive servo (Actuators 14:367, Example 2)"'
    """
    require_system(system)
    import tomlkit

    document = tomlkit.document()
    document["title"] = system.title
    tables = {
        "plant": _plant_table(system.plant),
        "truth": _truth_table(system.truth),
        "reference": _reference_table(system.reference, system.plant),
        "law": _law_table(system.law),
        "simulation": _present(field_values(system.settings)),
    }
    if system.population is not None:
        tables["ensemble"] = _population_table(system.population)
    if system.implementation is not None:
        tables["implementation"] = _implementation_table(system.implementation)
    for name, table in tables.items():
        document[name] = {key: _as_item(value) for key, value in _as_toml(table).items()}
    return tomlkit.dumps(document)


def _as_item(value: Any) -> Any:
    """A long list of numbers as one item: of 50,000 items tomlkit would think for a minute."""
    from tomlkit.items import Float, Trivia

    if not isinstance(value, list) or len(value) < LONG_LIST:
        return value
    return Float(0.0, Trivia(), f"[{', '.join(map(repr, value))}]")


def save(system: System, path: str | os.PathLike[str]) -> None:
    """Write a system file; it appears only when it is complete.

    Parameters
    ----------
    system : System
    path : path

    Returns
    -------
    None

    Raises
    ------
    InputError
        If the law is not registered, so that nobody could load the file, or the file cannot be
        written.

    Examples
    --------
    >>> import certrack
    >>> certrack.save(certrack.load("example1"), "mine.toml")
    >>> certrack.load("mine.toml") == certrack.load("example1")
    True
    """
    require_system(system)
    if known_laws().get(system.law.kind) is not type(system.law):
        raise InputError(
            "law.kind",
            "is not registered, so the file could not be loaded",
            system.law.kind,
            "Decorate the law with certrack.laws.register, and make it anew",
        )
    write_text(Path(path), to_text(system))


def _as_toml(value: Any) -> Any:
    """Expressions as numbers or text, tuples as lists."""
    if isinstance(value, Distribution):
        return value.written
    if isinstance(value, Expression):
        return number_or_text(value.text)
    if isinstance(value, RationalFloat):
        return value.text
    if isinstance(value, LqrWeights):
        return _as_toml(field_values(value))
    if isinstance(value, dict):
        return {name: _as_toml(entry) for name, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [_as_toml(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value


def _present(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _plant_table(plant: Plant) -> dict[str, Any]:
    values = field_values(plant)
    ranges = {"input_gain": values.pop("input_gain_range"), "theta": values.pop("theta_range")}
    ranges |= {name: [low, high] for name, low, high in values.pop("constant_ranges")}
    constants = dict(values.pop("constants"))
    uncertainty = _present(field_values(values.pop("uncertainty")))
    if not uncertainty["constants_vary"]:
        del uncertainty["constants_vary"]
    table = _present(values) | {"constants": constants}
    return table | {"ranges": _present(ranges), "uncertainty": uncertainty}


def _truth_table(truth: Truth) -> dict[str, Any]:
    values = _present(field_values(truth))
    if truth.states is not None:
        del values["theta"]
    for name in TRUTH_TABLES:
        if name in values:
            values[name] = {
                key: value
                for key, value in _present(field_values(values[name])).items()
                if value != math.inf
            }
    return values | {"constants": dict(truth.constants)}


def _reference_table(reference: Reference, plant: Plant) -> dict[str, Any]:
    if isinstance(reference, SoftStart):
        return _reference_table(reference.target, plant) | {"transient": reference.transient}
    if isinstance(reference, SymbolicReference) and not reference.fields:
        signal: Any = reference.signal
        constants = {name: value.expr for name, value in reference.constants}
        if any(plant.constant_values.get(name) != value for name, value in constants.items()):
            signal = parse(
                "reference.signal", reference.numeric, ["t"]
            )  # the file has no such name
        values = {"signal": signal, "bounds": reference.declared}
    elif isinstance(reference, (PiecewiseReference, SymbolicReference)):
        values = dict(reference.fields)
    else:  # its fields are its keys
        kind = kind_of(reference)
        if kind is None:  # registered elsewhere: in the notebook of a cluster, for example
            raise InputError(
                "reference",
                "is of a class that is not registered in this process",
                type(reference).__name__,
                "Put it into a module that every process imports",
            )
        return {"kind": kind} | _present(field_values(reference))
    return _present(values | {"bound": reference.declared_bound})


def toml_table(law: Law) -> dict[str, Any]:
    """A law as the entries of its table in a file."""
    entries: dict[str, Any] = _as_toml(_law_table(law))
    return entries


def _law_table(law: Law) -> dict[str, Any]:
    values = _present(field_values(law))
    if not law.sampled_feedforward:
        values.pop("sampled_feedforward", None)
    for name in LAW_TABLES:
        if name in values:
            below = _present(field_values(values[name]))
            values[name] = {key: value for key, value in below.items() if value != ()}
    return {"kind": law.kind} | values


def _population_table(population: Population) -> dict[str, Any]:
    values = _present(field_values(population))
    scales = {name: values.pop(name) for name in ("amplitude", "frequency") if name in values}
    constants = dict(values.pop("constants"))
    return (
        values
        | ({"constants": constants} if constants else {})
        | ({"reference": scales} if scales else {})
    )


def field_values(instance: Any) -> dict[str, Any]:
    """The fields of a dataclass that its constructor takes, not copied."""
    return {entry.name: getattr(instance, entry.name) for entry in fields(instance) if entry.init}


def _implementation_table(implementation: Implementation) -> dict[str, Any]:
    """What differs from the defaults."""
    return {
        entry.name: value
        for entry in fields(implementation)
        if (value := getattr(implementation, entry.name)) != entry.default
    }
