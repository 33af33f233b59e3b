"""The stages of a bootstrap in a certificate file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.inequality import MULTIPLIERS
from certrack.certificates.bootstrap.polynomial_proof import PolynomialProof
from certrack.certificates.bootstrap.proof import FunctionProof, RowBound
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.exact import from_text
from certrack.certificates.layout import has_entries, refusing_malformed_proof
from certrack.core.errors import InputError

#: Stages, functions of a stage, claims of a function that a file may have.
MAX_STAGES, MAX_FUNCTIONS, MAX_CLAIMS = 64, 256, 256

#: Entries of a vector, and rows of G.
MAX_VECTOR_LENGTH = 2000


def is_bootstrap(body: Any) -> bool:
    """Whether a body claims a bound by a bootstrap."""
    return has_entries(body, "region", after=1)


def bootstrap_stages(entries: list[Any]) -> tuple[BootstrapStage, ...]:
    """The stages of a body, well formed.

    Raises
    ------
    InputError
        If they are not.
    """
    if len(entries) > MAX_STAGES:
        raise InputError("proof", f"must have at most {MAX_STAGES} stages of a bootstrap")
    with refusing_malformed_proof():
        return tuple(_stage_of(entry) for entry in entries)


def _stage_of(entry: Any) -> BootstrapStage:
    require_fields(entry, BootstrapStage)
    functions = list_of(entry["functions"], _any_function, MAX_FUNCTIONS)
    return BootstrapStage(region_record(entry["region"]), functions)


def region_record(region: Any) -> Region:
    """A region, well formed."""
    require_fields(region, Region)
    pairs = {"box", "regressor"}
    single = {"row", "drift", "remainder"}
    parts = {
        name: list_of(region[name], pair_of_texts)
        if name in pairs
        else pair_of_texts(region[name])
        if name in single
        else list_of(region[name], one_text)
        for name in (entry.name for entry in fields(Region))
    }
    return Region(**parts)


def _any_function(entry: Any) -> FunctionProof | PolynomialProof:
    polynomial = isinstance(entry, dict) and "degree" in entry
    return _polynomial_of(entry) if polynomial else function_record(entry)


def _polynomial_of(entry: Any) -> PolynomialProof:
    require_fields(entry, PolynomialProof)
    if type(entry["degree"]) is not int or type(entry["reference"]) is not bool:
        raise TypeError("degree is no integer, or reference neither true nor false")
    kinds = ("squares", "inputs", "sectors", "majorants", "holds", "grams")
    return PolynomialProof(
        degree=entry["degree"],
        reference=entry["reference"],
        alpha=one_text(entry["alpha"]),
        W=list_of(entry["W"], one_text),
        mu=list_of(entry["mu"], one_text),
        **{name: list_of(entry[name], lambda texts: list_of(texts, one_text)) for name in kinds},
        claims=list_of(entry["claims"], _claim, MAX_CLAIMS),
    )


def function_record(entry: Any) -> FunctionProof:
    """A quadratic function, well formed."""
    require_fields(entry, FunctionProof)
    return FunctionProof(
        alpha=one_text(entry["alpha"]),
        G=list_of(entry["G"], lambda row: list_of(row, one_text)),
        **{name: list_of(entry[name], one_text) for name in MULTIPLIERS},
        claims=list_of(entry["claims"], _claim, MAX_CLAIMS),
    )


def _claim(entry: Any) -> RowBound:
    require_fields(entry, RowBound)
    for name in ("error", "side"):
        if type(entry[name]) is not int:
            raise TypeError(f"{name} is no integer")
    return RowBound(
        entry["error"], entry["side"], one_text(entry["scale"]), one_text(entry["bound"])
    )


def require_fields(entry: Any, kind: type) -> None:
    """Refuse what is no object with the fields of a kind."""
    names = [field.name for field in fields(kind)]
    if not isinstance(entry, dict) or set(entry) != set(names):
        raise InputError("proof", "must have " + ", ".join(names))


def one_text(value: Any) -> str:
    """A decimal text."""
    from_text(value)
    return str(value)


def pair_of_texts(value: Any) -> tuple[str, str]:
    """Two decimal texts."""
    low, high = list_of(value, one_text, 2)
    return low, high


def list_of(
    values: Any, read: Callable[[Any], Any], most: int = MAX_VECTOR_LENGTH
) -> tuple[Any, ...]:
    """A list that is not too long, each entry read."""
    if not isinstance(values, (list, tuple)):
        raise TypeError("a list is missing")
    if len(values) > most:
        raise ValueError("a list is too long")
    return tuple(read(value) for value in values)
