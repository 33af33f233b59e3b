"""The proof of the implemented loop in a certificate file."""

from __future__ import annotations

from dataclasses import fields
from fractions import Fraction
from typing import Any

from certrack.certificates.exact import MAX_TEXT_LENGTH, from_text
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.core.errors import InputError

#: Keys of the proof for one delay.
PROOF_KEYS = tuple(entry.name for entry in fields(ImplementedProof))

#: Delays that a file may state proofs for.
MAX_DELAY_PROOFS = 64


def is_implemented(body: Any) -> bool:
    """Whether a body claims a bound of the implemented loop."""
    proof = body.get("proof") if isinstance(body, dict) else None
    return (
        isinstance(proof, list)
        and bool(proof)
        and all(isinstance(entry, dict) and "doublings" in entry for entry in proof)
    )


def implemented_proofs(entries: list[dict[str, Any]]) -> tuple[ImplementedProof, ...]:
    """The proofs of a body, well formed.

    Raises
    ------
    InputError
        If they are not.
    """
    if len(entries) > MAX_DELAY_PROOFS:
        raise InputError("proof", f"must have at most {MAX_DELAY_PROOFS} delays")
    return tuple(map(_delay_proof, entries))


def _delay_proof(entry: dict[str, Any]) -> ImplementedProof:
    if set(entry) != set(PROOF_KEYS):
        raise InputError("proof", f"must have {', '.join(PROOF_KEYS)}")
    try:
        for text in (entry["input"], entry["step"], entry["bound"], *_as_tuple(entry["states"])):
            from_text(text)
        delay = entry["delay"]
        if not isinstance(delay, str) or len(delay) > MAX_TEXT_LENGTH:
            raise TypeError("the delay is no fraction")
        Fraction(delay)
        counts = (*_as_tuple(entry["parts"]), entry["doublings"])
        if len(counts) != 3 or any(type(count) is not int for count in counts):
            raise TypeError("parts must be two integers, doublings one")
    except (TypeError, ValueError, ZeroDivisionError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None
    lists = {"parts": tuple(entry["parts"]), "states": tuple(entry["states"])}
    return ImplementedProof(**(entry | lists))


def _as_tuple(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise TypeError("a list is missing")
    return tuple(value)
