"""The proof of the implemented loop in a certificate file."""

from __future__ import annotations

from dataclasses import asdict, fields
from fractions import Fraction
from typing import Any

from certrack.certificates.exact import MAX_TEXT_LENGTH, from_text
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.start_proof import StartProof
from certrack.core.errors import InputError

#: Keys of the proof for one delay.
PROOF_KEYS = tuple(entry.name for entry in fields(ImplementedProof))

#: Keys of what is proven of a set of starts.
START_KEYS = tuple(entry.name for entry in fields(StartProof))

#: Delays that a file may state proofs for.
MAX_DELAY_PROOFS = 64

#: And sets of starts for each delay.
MAX_START_PROOFS = 2


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


def written(stage: ImplementedProof) -> dict[str, Any]:
    """The keys of a proof, without those that have nothing to say."""
    return {name: value for name, value in asdict(stage).items() if name != "rates" or value}


def _delay_proof(entry: dict[str, Any]) -> ImplementedProof:
    entry = {"rates": [], **entry}  # which is written only where there are some
    if set(entry) != set(PROOF_KEYS):
        raise InputError("proof", f"must have {', '.join(PROOF_KEYS[:-1])}, and rates with jitter")
    try:
        listed = (*_as_tuple(entry["states"]), *_as_tuple(entry["rates"]))
        for text in (entry["input"], entry["step"], entry["bound"], *listed):
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
    starts = entry["starts"]
    if not isinstance(starts, (list, tuple)) or len(starts) > MAX_START_PROOFS:
        raise InputError("proof", f"starts must be a list of at most {MAX_START_PROOFS}")
    lists = {
        "parts": tuple(entry["parts"]),
        "states": tuple(entry["states"]),
        "rates": tuple(entry["rates"]),
        "starts": tuple(map(_start_proof, starts)),
    }
    return ImplementedProof(**(entry | lists))


def _start_proof(entry: Any) -> StartProof:
    if not isinstance(entry, dict) or set(entry) != set(START_KEYS):
        raise InputError("proof", f"starts must have {', '.join(START_KEYS)}")
    try:
        region = tuple(map(_as_tuple, _as_tuple(entry["region"])))
        if any(len(pair) != 2 for pair in region):
            raise TypeError("a region has pairs")
        ends = [text for pair in region for text in pair]
        lists = {name: _as_tuple(entry[name]) for name in ("states", "peaks")}
        for text in (*ends, *lists["states"], entry["input"], *lists["peaks"]):
            from_text(text)
        if any(type(entry[name]) is not int for name in ("doublings", "middle")):
            raise TypeError("doublings and middle must be integers")
        if any(type(entry[name]) is not str for name in ("of", "phase")):
            raise TypeError("of and phase must be words")
    except (TypeError, ValueError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None
    return StartProof(**(entry | lists | {"region": region}))


def _as_tuple(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise TypeError("a list is missing")
    return tuple(value)
