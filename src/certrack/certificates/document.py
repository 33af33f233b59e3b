"""The saved certificate: everything a third party needs to check it, and the checker.

The file is JSON. `verify` rebuilds the problem from the system text in exact rationals and checks
the inequality; that uses no solver and no floating point. Then it looks at the premises as
`certify` does, and refuses a file whose own truth contradicts one. See docs/certificate-file.md.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.bootstrap.check import check_bootstrap, claimed_bound
from certrack.certificates.bootstrap.document import bootstrap_stages, is_bootstrap
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.cascade import check_cascade
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, failed_condition, from_text
from certrack.certificates.formulation import error_problem
from certrack.certificates.implemented.certify import claim_of, failed_cover, largest_bound
from certrack.certificates.implemented.document import (
    implemented_proofs,
    is_implemented,
    record_of,
)
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.region import is_only_in_region, without_polytopes
from certrack.certificates.implemented.regional import is_of_starts
from certrack.certificates.layout import (
    FORMAT,
    FORMAT_1,
    MAX_CERTIFICATE_BYTES,
    check_layout,
    read_document,
)
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.ranges.certify import cover_bound
from certrack.certificates.ranges.proofs import MAX_PROOF_CELLS, CellProof, check_cells, numbers
from certrack.certificates.ranges.rational import MAX_HULL_POINTS
from certrack.core.budget import within_budget
from certrack.core.errors import CertrackError, InputError
from certrack.core.files import write_text
from certrack.core.rounding import rounded_up
from certrack.core.version import version
from certrack.systems.reader import loads
from certrack.systems.system import System, require_system
from certrack.systems.writer import to_text

#: What checking may take: orders of 50 take a tenth of it. See core/budget.py.
VERIFY_SECONDS, VERIFY_MEGABYTES = 300, 2000

#: The shift of a stage that is not the centred one, the second of three.
NO_SHIFT = "0"


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
    premises : tuple of Premise
        What the claim rests on, and whether the truth of the same file keeps it. Empty if not
        verified, but for contradicted ones.
    """

    verified: bool
    bound: str
    reason: str
    premises: tuple[Premise, ...] = ()

    @property
    def printed_bound(self) -> str:
        """The bound with six digits, rounded up."""
        return rounded_up(self.bound, 6)


#: What a document holds: a stage, a cell, or the proof for one delay.
Stage = Proof | CellProof | ImplementedProof | BootstrapStage


def to_document(system: System, *stages: Stage) -> dict[str, Any]:
    """The certificate as a JSON-ready dictionary.

    Parameters
    ----------
    system : System
    *stages : Proof
        One for a semidefinite bound, two or three for a cascade, the cells that fill the
        ranges of constants, or the proofs of the implemented loop.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If the system's own truth contradicts a premise, or there is no proof.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> certrack.certificates.to_document(system, *found.stages)["format"]
    'certrack-certificate/2'
    """
    if not stages:
        raise InputError("stages", "there is no proof to save")
    cells = tuple(stage for stage in stages if isinstance(stage, CellProof))
    sampled = tuple(stage for stage in stages if isinstance(stage, ImplementedProof))
    system = system if sampled and is_of_starts(system) else system.long_run
    rests_on = premises_as_implemented(system, sampled) if sampled else premises(system)
    if broken := contradicted(rests_on):
        raise InputError("premises", f"the truth contradicts one: {broken[0]}")
    grounded = tuple(stage for stage in stages if isinstance(stage, BootstrapStage))
    if cells or sampled or grounded:
        bound = cover_bound(cells) if cells else ""
        bound = largest_bound(sampled) if sampled else bound
        bound = claimed_bound(grounded) if grounded else bound
    else:
        bound = tuple(stage for stage in stages if isinstance(stage, Proof))[-1].bound
    body: dict[str, Any] = {
        "format": FORMAT,
        "made_by": f"certrack {version()}",
        "claim": claim_of(system, bound, rests_on) if sampled else f"limsup |e_1(t)| <= {bound}",
        "premises": [premise.record() for premise in rests_on],
        "system": to_text(system.replace(law=system.law.settled(system.plant))),
        "proof": [json.loads(json.dumps(record_of(stage))) for stage in stages],
    }
    return body | {"sha256": _digest(body)}


def certificate_text(system: System, stages: Sequence[Stage]) -> str:
    """The text of a certificate file; parameters as of :func:`save_certificate`."""
    text = json.dumps(to_document(system, *stages), indent=1) + "\n"
    if len(text) > MAX_CERTIFICATE_BYTES:  # more than `verify` reads; it is ASCII
        raise CertrackError(
            f"the certificate of {len(text) / 1e6:.0f} MB is larger than "
            f"{MAX_CERTIFICATE_BYTES // 1_000_000} MB, which nobody could check: certify with less "
            "effort"
        )
    return text


def save_certificate(system: System, stages: Sequence[Stage], path: str | os.PathLike[str]) -> None:
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
    require_system(system)
    write_text(Path(path), certificate_text(system, stages))


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
        body = source if isinstance(source, dict) else read_document(Path(source))
        if is_implemented(body):
            return _verify_implemented(body)
        if _is_cover(body):
            return _verify_cover(body)
        if is_bootstrap(body):
            return _verify_bootstrap(body)
        stages = _stages(body)
        proof = stages[-1]
        if body["sha256"] != _digest(body):
            return Verdict(False, proof.bound, "the file was changed after it was made")
        if any(stage.shift != NO_SHIFT for stage in _not_centred(stages)):
            reason = "a shift stands in a stage that does not use it"
            return Verdict(False, proof.bound, reason)
        if body["claim"] != f"limsup |e_1(t)| <= {proof.bound}":
            return Verdict(False, proof.bound, "the claim is not that of the proof")
        system = loads(body["system"], "system")
        exact = error_problem(system, rational)
        reason = (
            failed_condition(exact, proof)
            if len(stages) == 1
            else check_cascade(system, exact, stages)
        )
        if reason:
            return Verdict(False, proof.bound, reason)
        return _rests_on(body, proof.bound, premises(system), assumptions(system))
    except NoCertificate as refusal:
        return Verdict(False, "", str(refusal))


def _is_cover(body: dict[str, Any]) -> bool:
    """Whether a body claims a bound by cells of the ranges of constants."""
    if not isinstance(body, dict):
        return False
    proof = body.get("proof")
    return (
        isinstance(proof, list)
        and bool(proof)
        and all(isinstance(entry, dict) and "cell" in entry for entry in proof)
    )


def _verify_cover(body: dict[str, Any]) -> Verdict:
    """Check a proof by cells."""
    check_layout(body)
    if body["format"] != FORMAT:
        raise InputError("format", f"must be {FORMAT} for a proof by cells", body["format"])
    if len(body["proof"]) > MAX_PROOF_CELLS:
        raise InputError("proof", f"must have at most {MAX_PROOF_CELLS} cells")
    cells = tuple(_cell(entries) for entries in body["proof"])
    bound = cover_bound(cells)
    if body["sha256"] != _digest(body):
        return Verdict(False, bound, "the file was changed after it was made")
    if any(stage.shift != NO_SHIFT for cell in cells for stage in cell.points):
        return Verdict(False, bound, "a shift stands in a stage that does not use it")
    if body["claim"] != f"limsup |e_1(t)| <= {bound}":
        return Verdict(False, bound, "the claim is not that of the proof")
    system = loads(body["system"], "system")
    if reason := check_cells(system, cells, bound):
        return Verdict(False, bound, reason)
    return _rests_on(body, bound, premises(system), assumptions(system))


def _verify_bootstrap(body: dict[str, Any]) -> Verdict:
    """Check a proof by a bootstrap."""
    check_layout(body)
    if body["format"] != FORMAT:
        raise InputError("format", f"must be {FORMAT} for a bootstrap", body["format"])
    first, stages = _proof(body["proof"][0]), bootstrap_stages(body["proof"][1:])
    bound = claimed_bound(stages)
    if body["sha256"] != _digest(body):
        return Verdict(False, bound, "the file was changed after it was made")
    if first.shift != NO_SHIFT:
        return Verdict(False, bound, "a shift stands in a stage that does not use it")
    if body["claim"] != f"limsup |e_1(t)| <= {bound}":
        return Verdict(False, bound, "the claim is not that of the proof")
    system = loads(body["system"], "system")
    exact = error_problem(system, rational)
    if reason := check_bootstrap(system, exact, first, stages):
        return Verdict(False, bound, reason)
    return _rests_on(body, bound, premises(system), assumptions(system))


def _verify_implemented(body: dict[str, Any]) -> Verdict:
    """Check a proof of the implemented loop."""
    check_layout(body)
    if body["format"] != FORMAT:
        raise InputError("format", f"must be {FORMAT} for an implemented loop", body["format"])
    proofs = implemented_proofs(body["proof"])
    bound = largest_bound(proofs)
    if body["sha256"] != _digest(body):
        return Verdict(False, bound, "the file was changed after it was made")
    system = loads(body["system"], "system")
    rests_on = premises_as_implemented(system, proofs)
    if body["claim"] != claim_of(system, bound, rests_on):
        return Verdict(False, bound, "the claim is not that of the proof")
    if is_only_in_region(rests_on) and without_polytopes(proofs) != proofs:
        reason = "a bound of w holds in the region of x0 only, and other starts are claimed"
        return Verdict(False, bound, reason)
    if reason := failed_cover(system, proofs):
        return Verdict(False, bound, reason)
    return _rests_on(body, bound, rests_on, ())


def _cell(entries: Any) -> CellProof:
    """One cell of a proof, well formed."""
    if not isinstance(entries, dict) or set(entries) != {"cell", "bound", "points"}:
        raise InputError("proof", "a cell must have cell, bound and points")
    points = entries["points"]
    if not isinstance(points, list) or len(points) > MAX_HULL_POINTS:
        raise InputError("proof", f"points must be a list of at most {MAX_HULL_POINTS} stages")
    try:
        (bound,) = _decimal_texts([entries["bound"]])
        cell = tuple((str(low), str(high)) for low, high in entries["cell"])
        if not all(low <= high for low, high in numbers(cell)):
            raise ValueError("an interval is empty")
    except (TypeError, ValueError, ZeroDivisionError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None
    return CellProof(cell, bound, tuple(map(_proof, points)))


def _not_centred(stages: tuple[Proof, ...]) -> tuple[Proof, ...]:
    """All stages but the second of three."""
    return stages if len(stages) < 3 else (stages[0], *stages[2:])


def _rests_on(
    body: dict[str, Any], bound: str, rests_on: tuple[Premise, ...], texts: Sequence[str]
) -> Verdict:
    """The verdict on a proof that holds: do the premises, and are they those that are written?"""
    if broken := contradicted(rests_on):
        return Verdict(False, bound, f"a premise is contradicted: {broken[0]}", broken)
    if body["format"] == FORMAT_1:
        if body["assumptions"] != list(texts):
            return Verdict(False, bound, "the assumptions are not those of the system")
    elif body["premises"] != [premise.record() for premise in rests_on]:
        return Verdict(False, bound, "the premises are not those of the system")
    return Verdict(True, bound, "", rests_on)


def _stages(body: dict[str, Any]) -> tuple[Proof, ...]:
    """The proof's one to three stages, well formed."""
    check_layout(body)
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
