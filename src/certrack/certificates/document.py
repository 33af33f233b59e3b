"""The saved certificate: everything a third party needs to check it, and the checker.

The file is JSON. `verify` rebuilds the problem from the system text in exact rationals and checks
the inequality; it uses no solver and no floating point. See docs/certificate-file.md.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from certrack.certificates.arithmetic import rational
from certrack.certificates.cascade import check_cascade
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, check, from_text
from certrack.certificates.formulation import error_problem
from certrack.certificates.premises import assumptions
from certrack.core.budget import within_budget
from certrack.core.errors import InputError
from certrack.core.files import write_text
from certrack.core.rounding import rounded_up
from certrack.core.version import version
from certrack.systems.reader import loads
from certrack.systems.system import System
from certrack.systems.writer import to_text

FORMAT = "certrack-certificate/1"

#: A certificate of order 100 has less than 1 MB; reading stops here, whatever a stranger sends.
MAX_CERTIFICATE_BYTES = 20_000_000

#: What checking may take: orders of 50 take a tenth of it. See core/budget.py.
VERIFY_SECONDS, VERIFY_MEGABYTES = 300, 2000

DOCUMENT_KEYS = ("format", "made_by", "claim", "assumptions", "system", "proof", "sha256")


@dataclass(frozen=True)
class Verdict:
    """Result of checking a certificate file.

    Attributes
    ----------
    verified : bool
    bound : str
        The claimed bound on limsup |e_1|, decimal.
    reason : str
        The first condition that fails; empty if verified.
    assumptions : texts
    """

    verified: bool
    bound: str
    reason: str
    assumptions: tuple[str, ...]

    @property
    def printed_bound(self) -> str:
        """The bound with six digits, rounded up."""
        return rounded_up(self.bound, 6)


def to_document(system: System, *stages: Proof) -> dict[str, Any]:
    """The certificate as a JSON-ready dictionary.

    Parameters
    ----------
    system : System
    *stages : Proof
        One for a semidefinite bound, two or three for a cascade.

    Returns
    -------
    dict

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> certrack.certificates.to_document(system, *found.stages)["format"]
    'certrack-certificate/1'
    """
    proof = stages[-1]
    body: dict[str, Any] = {
        "format": FORMAT,
        "made_by": f"certrack {version()}",
        "claim": f"limsup |e_1(t)| <= {proof.bound}",
        "assumptions": assumptions(system),
        "system": to_text(system),
        "proof": [json.loads(json.dumps(asdict(stage))) for stage in stages],
    }
    return body | {"sha256": _digest(body)}


def save_certificate(system: System, stages: Sequence[Proof], path: str | os.PathLike[str]) -> None:
    """Write the certificate to `path`; a failure leaves what was there.

    Parameters
    ----------
    system : System
    stages : sequence of Proof
        ``Certificates.stages``.
    path : path

    Returns
    -------
    None

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> certrack.certificates.save_certificate(system, found.stages, "cert.json")
    >>> certrack.certificates.verify("cert.json").verified
    True
    """
    write_text(Path(path), json.dumps(to_document(system, *stages), indent=1) + "\n")


def verify(source: str | os.PathLike[str] | dict[str, Any]) -> Verdict:
    """Check a certificate file, or its dictionary, in exact arithmetic.

    Parameters
    ----------
    source : path or dict

    Returns
    -------
    Verdict

    Raises
    ------
    InputError
        If the file is not a certificate at all.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> document = certrack.certificates.to_document(system, *found.stages)
    >>> certrack.certificates.verify(document).verified
    True
    >>> certrack.certificates.verify(document | {"claim": "limsup |e_1(t)| <= 0"}).verified
    False
    """
    name = "certificate" if isinstance(source, dict) else str(source)
    try:
        return within_budget(
            lambda: _verify(source), what="", seconds=VERIFY_SECONDS, megabytes=VERIFY_MEGABYTES
        )
    except InputError as problem:
        raise problem.within(name) from None


def _verify(source: str | os.PathLike[str] | dict[str, Any]) -> Verdict:
    try:
        body = source if isinstance(source, dict) else _read_document(Path(source))
        stages = _stages(body)
        proof = stages[-1]
        if body["sha256"] != _digest(body):
            return Verdict(False, proof.bound, "the file was changed after it was made", ())
        system = loads(body["system"], "system")
        exact = error_problem(system, rational)
        if body["assumptions"] != assumptions(system):
            return Verdict(False, proof.bound, "the assumptions are not those of the system", ())
        if body["claim"] != f"limsup |e_1(t)| <= {proof.bound}":
            return Verdict(False, proof.bound, "the claim is not that of the proof", ())
        reason = check(exact, proof) if len(stages) == 1 else check_cascade(system, exact, stages)
    except NoCertificate as refusal:
        return Verdict(False, "", str(refusal), ())
    return Verdict(not reason, proof.bound, reason, tuple(body["assumptions"]))


def _read_document(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_CERTIFICATE_BYTES + 1)
        if len(data) > MAX_CERTIFICATE_BYTES:
            raise InputError("", f"is larger than {MAX_CERTIFICATE_BYTES // 1_000_000} MB")
        body = json.loads(data.decode("utf-8"))
    except OSError as problem:
        raise InputError("", f"cannot be read ({problem.strerror})") from None
    except InputError:
        raise
    except (ValueError, RecursionError):
        raise InputError("", "is not a certificate: not JSON") from None
    return body if isinstance(body, dict) else {}


def _stages(body: dict[str, Any]) -> tuple[Proof, ...]:
    """The proof's one to three stages, well formed."""
    if not isinstance(body, dict) or tuple(sorted(body)) != tuple(sorted(DOCUMENT_KEYS)):
        raise InputError("", "is not a certificate: it must have " + ", ".join(DOCUMENT_KEYS))
    if body["format"] != FORMAT:
        raise InputError("format", f"must be {FORMAT}", body["format"])
    if not all(isinstance(body[key], str) for key in ("claim", "system", "sha256", "made_by")):
        raise InputError("", "is not a certificate: texts expected")
    if not isinstance(body["proof"], list) or len(body["proof"]) not in (1, 2, 3):
        raise InputError("proof", "must be a list of one to three stages")
    return tuple(_proof(entries) for entries in body["proof"])


def _proof(entries: Any) -> Proof:
    names = ("alpha", "P", "lam", "nu", "k", "bound", "shift")
    if not isinstance(entries, dict) or set(entries) != set(names):
        raise InputError("proof", "must have " + ", ".join(names))
    try:
        vectors = {name: _decimal_texts(entries[name]) for name in ("lam", "nu", "k")}
        rows = tuple(_decimal_texts(row) for row in entries["P"])
        alpha, bound, shift = _decimal_texts(
            [entries[name] for name in ("alpha", "bound", "shift")]
        )
        return Proof(alpha, rows, vectors["lam"], vectors["nu"], vectors["k"], bound, shift)
    except (TypeError, ValueError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None


def _decimal_texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, (list, tuple)):
        raise TypeError("a list is missing")
    for value in values:
        from_text(value)
    return tuple(values)


def _digest(body: dict[str, Any]) -> str:
    content = {key: value for key, value in body.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
