"""Every key of the system file, table by table.

The keys are those of the dataclass fields and reference kinds that they fill; here they are put in
the order of the file, for the loader, for :mod:`certrack.systems.documentation` and for forms.
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any

from certrack.core.keys import Key, keys_of
from certrack.laws import LAWS, Law
from certrack.laws.observer import Observer
from certrack.laws.online import Online
from certrack.model.implementation import Implementation
from certrack.model.motors import Motors, Supply
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import known_references
from certrack.references.keys import FORMULA_KEYS, REFERENCE_KINDS, TRANSIENT
from certrack.systems.system import Settings, System

#: Fields of every law that are tables below its own.
LAW_TABLES: dict[str, type[Any]] = {"observer": Observer, "online": Online}


#: Fields of the truth that are tables below its own.
TRUTH_TABLES: dict[str, type[Any]] = {"motors": Motors, "supply": Supply}


def _keys_below(owner: Any, below: str = "") -> dict[str, Key]:
    """Keys of a class that stand in its table, or in the named table below that."""
    keys: dict[str, Key] = {}
    for field, key in keys_of(owner).items():
        table, _, name = (key.path or field).rpartition(".")
        if table == below:
            keys[name] = key
    return keys


def law_keys(law: type[Law]) -> dict[str, Key]:
    """Keys of ``[law]`` for one law, a user's own among them."""
    kind = Key("choice", help="which law", choices=tuple(LAWS), required=True)
    undescribed = {
        entry.name: Key("any", required=entry.default is MISSING)
        for entry in fields(law)
        if entry.init and entry.name not in LAW_TABLES
    }
    return {"kind": kind, **undescribed, **keys_of(law)}


def reference_keys(kind: str) -> dict[str, Key]:
    """Keys of ``[reference]`` for one kind of reference."""
    choice = Key("choice", help="shape of y_d", choices=tuple(REFERENCE_KINDS), required=True)
    entry = REFERENCE_KINDS[kind] if kind in REFERENCE_KINDS else known_references()[kind]
    return {"kind": choice, **entry.keys, "transient": TRANSIENT}


#: Tables of the file and their keys. Where the keys depend on the kind, it stands in brackets.
TABLES: dict[str, dict[str, Key]] = {
    "": keys_of(System),
    "plant": _keys_below(Plant),
    "plant.ranges": _keys_below(Plant, "ranges"),
    "plant.uncertainty": _keys_below(Uncertainty),
    "truth": _keys_below(Truth),
    **{f"truth.{name}": _keys_below(owner) for name, owner in TRUTH_TABLES.items()},
    "reference": dict(FORMULA_KEYS),
    **{f"reference[{kind}]": reference_keys(kind) for kind in REFERENCE_KINDS},
    **{f"law[{kind}]": law_keys(law) for kind, law in LAWS.items()},
    **{f"law.{name}": _keys_below(owner) for name, owner in LAW_TABLES.items()},
    "simulation": _keys_below(Settings),
    "implementation": _keys_below(Implementation),
    "ensemble": _keys_below(Population),
    "ensemble.reference": _keys_below(Population, "reference"),
}

#: Path -> key, e.g. ``"plant.chain"``, ``"law[adaptive].Gamma"``.
KEYS: dict[str, Key] = {
    f"{table}.{name}" if table else name: key
    for table, keys in TABLES.items()
    for name, key in keys.items()
}


def as_dicts() -> dict[str, dict[str, Any]]:
    """All keys in a form that JSON holds, for the forms of a designer."""
    return {path: key.as_dict() for path, key in KEYS.items()}
