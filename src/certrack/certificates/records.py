"""The numbers of a proof as they stand in a certificate file: well formed, or refused."""

from __future__ import annotations

from typing import Any

from certrack.certificates.exact import Proof, from_text
from certrack.certificates.layout import refusing_malformed_proof
from certrack.certificates.online.certify import OnlineProof
from certrack.certificates.ranges.proofs import CellProof, numbers
from certrack.certificates.ranges.rational import MAX_HULL_POINTS
from certrack.core.errors import InputError


def stage_record(entries: Any) -> Proof:
    """One stage, well formed."""
    names = ("alpha", "P", "lam", "nu", "k", "bound", "shift")
    if not isinstance(entries, dict) or set(entries) != set(names):
        raise InputError("proof", "must have " + ", ".join(names))
    with refusing_malformed_proof():
        vectors = {name: decimal_texts(entries[name]) for name in ("lam", "nu", "k")}
        rows = tuple(decimal_texts(row) for row in entries["P"])
        alpha, bound, shift = decimal_texts([entries[name] for name in ("alpha", "bound", "shift")])
        return Proof(alpha, rows, vectors["lam"], vectors["nu"], vectors["k"], bound, shift)


def decimal_texts(values: Any) -> tuple[str, ...]:
    """A list of decimal texts."""
    if not isinstance(values, (list, tuple)):
        raise TypeError("a list is missing")
    for value in values:
        from_text(value)
    return tuple(values)


def cell_record(entries: Any) -> CellProof:
    """One cell of a proof, well formed."""
    if not isinstance(entries, dict) or set(entries) != {"cell", "bound", "points"}:
        raise InputError("proof", "a cell must have cell, bound and points")
    points = entries["points"]
    if not isinstance(points, list) or len(points) > MAX_HULL_POINTS:
        raise InputError("proof", f"points must be a list of at most {MAX_HULL_POINTS} stages")
    with refusing_malformed_proof():
        (bound,) = decimal_texts([entries["bound"]])
        cell = tuple((str(low), str(high)) for low, high in entries["cell"])
        if not all(low <= high for low, high in numbers(cell)):
            raise ValueError("an interval is empty")
    return CellProof(cell, bound, tuple(map(stage_record, points)))


def online_record(entries: Any) -> OnlineProof:
    """The proof for gains that move, well formed."""
    if not isinstance(entries, dict) or set(entries) != {"bound", "ends"}:
        raise InputError("proof", "that of moving gains must have bound and ends")
    ends = entries["ends"]
    if not isinstance(ends, list) or len(ends) not in (1, 2):
        raise InputError("proof", "ends must be a list of one or two stages")
    with refusing_malformed_proof():
        (bound,) = decimal_texts([entries["bound"]])
    return OnlineProof(bound, tuple(map(stage_record, ends)))
