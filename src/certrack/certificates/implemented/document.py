"""The proof of the implemented loop in a certificate file."""

from __future__ import annotations

from dataclasses import asdict, fields
from fractions import Fraction
from typing import Any

from certrack.certificates.exact import MAX_TEXT_LENGTH, from_text
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.slow import StepFunction
from certrack.certificates.implemented.start_proof import StartProof
from certrack.certificates.layout import has_entries, refusing_malformed_proof
from certrack.certificates.ranges.proofs import MAX_PROOF_CELLS, numbers
from certrack.core.errors import InputError

#: Keys of the proof for one delay.
PROOF_KEYS = tuple(entry.name for entry in fields(ImplementedProof))

#: Those that a file without ranges, without jitter, or without rates need not have.
OPTIONAL_KEYS = {"cell", "rates", "slow", "split"}

#: Keys of what is proven of a set of starts.
START_KEYS = tuple(entry.name for entry in fields(StartProof))

#: Delays that a file may state proofs for.
MAX_DELAY_PROOFS = 64

#: Steps that each z of a proof by rates may have.
MAX_PROOF_STEPS = 1000

#: And sets of starts for each delay.
MAX_START_PROOFS = 2


def is_implemented(body: Any) -> bool:
    """Whether a body claims a bound of the implemented loop."""
    return has_entries(body, "doublings")


def record_of(stage: Any) -> dict[str, Any]:
    """The numbers of a stage of any proof; of a sampled loop no empty ones that are optional."""
    record = asdict(stage)
    if isinstance(stage, ImplementedProof):
        for name in OPTIONAL_KEYS:
            if not record[name]:
                del record[name]
    return record


def implemented_proofs(entries: list[dict[str, Any]]) -> tuple[ImplementedProof, ...]:
    """The proofs of a body, well formed.

    Raises
    ------
    InputError
        If they are not.
    """
    if len(entries) > MAX_DELAY_PROOFS * MAX_PROOF_CELLS:
        raise InputError("proof", f"must have at most {MAX_DELAY_PROOFS} delays")
    if len({str(entry.get("delay")) for entry in entries}) > MAX_DELAY_PROOFS:
        raise InputError("proof", f"must have at most {MAX_DELAY_PROOFS} delays")
    return tuple(map(_delay_proof, entries))


def _delay_proof(entry: dict[str, Any]) -> ImplementedProof:
    if not set(PROOF_KEYS) - OPTIONAL_KEYS <= set(entry) <= set(PROOF_KEYS):
        raise InputError("proof", f"must have {', '.join(PROOF_KEYS)}")
    with refusing_malformed_proof():
        split = tuple(map(_as_tuple, _as_tuple(entry.get("split", ()))))
        listed = [*_as_tuple(entry["states"]), *_as_tuple(entry.get("rates", ()))]
        for part in split:
            listed += part
        for text in (entry["input"], entry["step"], entry["bound"], *listed):
            from_text(text)
        delay = entry["delay"]
        if not isinstance(delay, str) or len(delay) > MAX_TEXT_LENGTH:
            raise TypeError("the delay is no fraction")
        Fraction(delay)
        cell = tuple((str(low), str(high)) for low, high in _as_tuple(entry.get("cell", ())))
        if not all(low <= high for low, high in numbers(cell)):
            raise ValueError("an interval is empty")
        slow = tuple(map(_one_z, _as_tuple(entry.get("slow", ()))))
        counts = (*_as_tuple(entry["parts"]), entry["doublings"])
        if len(counts) != 3 or any(type(count) is not int for count in counts):
            raise TypeError("parts must be two integers, doublings one")
    starts = entry["starts"]
    if not isinstance(starts, (list, tuple)) or len(starts) > MAX_START_PROOFS:
        raise InputError("proof", f"starts must be a list of at most {MAX_START_PROOFS}")
    lists = {
        "parts": tuple(entry["parts"]),
        "states": tuple(entry["states"]),
        "rates": tuple(entry.get("rates", ())),
        "starts": tuple(map(_start_proof, starts)),
        "cell": cell,
        "slow": slow,
        "split": split,
    }
    return ImplementedProof(**(entry | lists))


def _one_z(entries: Any) -> StepFunction:
    """One z: pairs of a period and a decimal text."""
    pairs = tuple(map(_as_tuple, _as_tuple(entries)))
    if len(pairs) > MAX_PROOF_STEPS:
        raise ValueError(f"slow has at most {MAX_PROOF_STEPS} steps each")
    for pair in pairs:
        if len(pair) != 2 or type(pair[0]) is not int:
            raise TypeError("a step is a period and a text")
        from_text(pair[1])
    return pairs


def _start_proof(entry: Any) -> StartProof:
    if not isinstance(entry, dict) or set(entry) != set(START_KEYS):
        raise InputError("proof", f"starts must have {', '.join(START_KEYS)}")
    with refusing_malformed_proof():
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
    return StartProof(**(entry | lists | {"region": region}))


def _as_tuple(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise TypeError("a list is missing")
    return tuple(value)
