"""The layout of a certificate file: its formats and keys, and how it is read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from certrack.core.errors import InputError, shorten

FORMAT = "certrack-certificate/2"

#: Of files before premises had a status: a list of texts, ``assumptions``, in their place.
FORMAT_1 = "certrack-certificate/1"

#: A certificate of order 100 has less than 1 MB; reading stops here, whatever a stranger sends.
MAX_CERTIFICATE_BYTES = 20_000_000

#: Keys of the file, `premises` or `assumptions` among them.
DOCUMENT_KEYS = {
    FORMAT: ("format", "made_by", "claim", "premises", "system", "proof", "sha256"),
    FORMAT_1: ("format", "made_by", "claim", "assumptions", "system", "proof", "sha256"),
}

#: There only where a premise holds in the region that this stage keeps.
REGION_KEY = "region"


def read_document(path: Path) -> dict[str, Any]:
    """The JSON object of a file; no key may stand twice, and no number be infinite."""
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_CERTIFICATE_BYTES + 1)
        if len(data) > MAX_CERTIFICATE_BYTES:
            raise InputError("", f"is larger than {MAX_CERTIFICATE_BYTES // 1_000_000} MB")
        body = json.loads(
            data.decode("utf-8"), object_pairs_hook=_unique_keys, parse_constant=_no_number
        )
    except OSError as problem:
        raise InputError("", f"cannot be read ({problem.strerror})") from None
    except InputError:
        raise
    except (ValueError, RecursionError):
        raise InputError("", "is not a certificate: not JSON") from None
    return body if isinstance(body, dict) else {}


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object in which no key stands twice."""
    table = dict(pairs)
    if len(table) < len(pairs):
        twice = next(key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i]))
        raise InputError("", f"is not a certificate: the key {shorten(twice)!r} stands twice")
    return table


def _no_number(text: str) -> Any:
    raise InputError("", f"is not a certificate: {text} is not JSON")


def check_layout(body: dict[str, Any]) -> None:
    """Refuse a body that has not the keys of its format, or no texts where they belong."""
    if not isinstance(body, dict) or not isinstance(body.get("format"), str):
        raise InputError(
            "", "is not a certificate: it must have " + ", ".join(DOCUMENT_KEYS[FORMAT])
        )
    if body["format"] not in DOCUMENT_KEYS:
        raise InputError("format", f"must be {FORMAT} or {FORMAT_1}", body["format"])
    keys = DOCUMENT_KEYS[body["format"]]
    optional = {REGION_KEY} if body["format"] == FORMAT else set()
    if sorted(map(str, set(body) - optional)) != sorted(keys):
        raise InputError("", "is not a certificate: it must have " + ", ".join(keys))
    if not all(isinstance(body[key], str) for key in ("claim", "system", "sha256", "made_by")):
        raise InputError("", "is not a certificate: texts expected")


def check_new_layout(body: dict[str, Any], what: str) -> None:
    """Refuse a body as :func:`check_layout` does, and the older format, which has no such proof."""
    check_layout(body)
    if body["format"] != FORMAT:
        raise InputError("format", f"must be {FORMAT} for {what}", body["format"])


def check_layout_as_run(body: dict[str, Any]) -> None:
    """The same for a proof of the loop as the drive runs it, which has no region."""
    check_new_layout(body, "an implemented loop")
    if REGION_KEY in body:
        raise InputError(REGION_KEY, "is of a continuous law only")


def has_entries(body: Any, key: str, *, after: int = 0) -> bool:
    """Whether the proof of a body is a list of objects with this key, behind so many others."""
    proof = body.get("proof") if isinstance(body, dict) else None
    return (
        isinstance(proof, list)
        and len(proof) > after
        and all(isinstance(entry, dict) and key in entry for entry in proof[after:])
    )


@contextmanager
def refusing_malformed_proof() -> Iterator[None]:
    """Refuse what is no list, number or decimal text where the proof must have one.

    What is refused by name already, by an `InputError`, keeps its message.
    """
    try:
        yield
    except InputError:  # a ValueError, too
        raise
    except (TypeError, ValueError, ZeroDivisionError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None


def digest_of(body: dict[str, Any]) -> str:
    """The digest that a body has as its ``sha256``."""
    content = {key: value for key, value in body.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
