"""The stages of a bootstrap in a certificate file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.inequality import MULTIPLIERS
from certrack.certificates.bootstrap.proof import BootstrapStage, FunctionProof, RowBound
from certrack.certificates.exact import from_text
from certrack.core.errors import InputError

#: Stages, functions of a stage, claims of a function that a file may have.
MAX_STAGES, MAX_FUNCTIONS, MAX_CLAIMS = 64, 256, 256

#: Entries of a vector, and rows of G.
MAX_VECTOR_LENGTH = 2000


def is_bootstrap(body: Any) -> bool:
    """Whether a body claims a bound by a bootstrap."""
    proof = body.get("proof") if isinstance(body, dict) else None
    return (
        isinstance(proof, list)
        and len(proof) > 1
        and all(isinstance(entry, dict) and "region" in entry for entry in proof[1:])
    )


def bootstrap_stages(entries: list[Any]) -> tuple[BootstrapStage, ...]:
    """The stages of a body, well formed.

    Raises
    ------
    InputError
        If they are not.
    """
    if len(entries) > MAX_STAGES:
        raise InputError("proof", f"must have at most {MAX_STAGES} stages of a bootstrap")
    try:
        return tuple(_stage_of(entry) for entry in entries)
    except (TypeError, ValueError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None


def _stage_of(entry: Any) -> BootstrapStage:
    _keys(entry, BootstrapStage)
    region = entry["region"]
    _keys(region, Region)
    pairs = {"box", "regressor"}
    single = {"row", "drift", "remainder"}
    parts = {
        name: _many(region[name], _pair)
        if name in pairs
        else _pair(region[name])
        if name in single
        else _many(region[name], _text)
        for name in (entry.name for entry in fields(Region))
    }
    functions = _many(entry["functions"], _function_of, MAX_FUNCTIONS)
    return BootstrapStage(Region(**parts), functions)


def _function_of(entry: Any) -> FunctionProof:
    _keys(entry, FunctionProof)
    return FunctionProof(
        alpha=_text(entry["alpha"]),
        G=_many(entry["G"], lambda row: _many(row, _text)),
        **{name: _many(entry[name], _text) for name in MULTIPLIERS},
        claims=_many(entry["claims"], _claim, MAX_CLAIMS),
    )


def _claim(entry: Any) -> RowBound:
    _keys(entry, RowBound)
    for name in ("error", "side"):
        if type(entry[name]) is not int:
            raise TypeError(f"{name} is no integer")
    return RowBound(entry["error"], entry["side"], _text(entry["scale"]), _text(entry["bound"]))


def _keys(entry: Any, kind: type) -> None:
    names = [field.name for field in fields(kind)]
    if not isinstance(entry, dict) or set(entry) != set(names):
        raise InputError("proof", "must have " + ", ".join(names))


def _text(value: Any) -> str:
    from_text(value)
    return str(value)


def _pair(value: Any) -> tuple[str, str]:
    low, high = _many(value, _text, 2)
    return low, high


def _many(
    values: Any, read: Callable[[Any], Any], most: int = MAX_VECTOR_LENGTH
) -> tuple[Any, ...]:
    if not isinstance(values, (list, tuple)):
        raise TypeError("a list is missing")
    if len(values) > most:
        raise ValueError("a list is too long")
    return tuple(read(value) for value in values)
