"""The checker of a saved certificate.

`verify` rebuilds the problem from the system text in exact rationals and checks the inequality;
that uses no solver and no floating point. Then it looks at the premises as `certify` does, and
refuses a file whose own truth contradicts one. See docs/certificate-file.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumptions import assumptions
from certrack.certificates.bootstrap.check import check_bootstrap, claimed_bound
from certrack.certificates.bootstrap.document import bootstrap_stages, is_bootstrap
from certrack.certificates.cascade import check_cascade
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, failed_condition
from certrack.certificates.formulation import error_problem
from certrack.certificates.implemented.certify import claim_of, failed_cover, largest_bound
from certrack.certificates.implemented.document import (
    implemented_proofs,
    is_implemented,
)
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.region import without_polytopes
from certrack.certificates.layout import (
    FORMAT,
    FORMAT_1,
    REGION_KEY,
    check_layout,
    check_layout_as_run,
    check_new_layout,
    digest_of,
    has_entries,
    read_document,
)
from certrack.certificates.level_set import KeptRegion, premises_from_x0
from certrack.certificates.online.certify import failed_online
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.ranges.certify import cover_bound
from certrack.certificates.ranges.proofs import MAX_PROOF_CELLS, check_cells
from certrack.certificates.records import cell_record, online_record, stage_record
from certrack.certificates.region import claim_text, is_only_in_region
from certrack.certificates.sampled_adaptive.certify import sampled_claim
from certrack.certificates.sampled_adaptive.document import (
    is_sampled_adaptive,
    sampled_adaptive_record,
)
from certrack.certificates.sampled_adaptive.premises import premises_of_sampled_adaptive
from certrack.certificates.sampled_adaptive.proof import (
    failed_sampled_adaptive,
)
from certrack.core.budget import within_budget
from certrack.core.errors import InputError
from certrack.core.rounding import rounded_up
from certrack.systems.reader import loads
from certrack.systems.system import System

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
        if is_sampled_adaptive(body):
            return _verify_sampled_adaptive(body)
        if _is_cover(body):
            return _verify_cover(body)
        if _is_online(body):
            return _verify_online(body)
        if is_bootstrap(body):
            return _verify_bootstrap(body)
        stages = _stages(body)
        shifts = tuple(stage.shift for stage in _not_centred(stages))

        def failed(system: System) -> str:
            exact = error_problem(system, rational)
            if len(stages) == 1:
                return failed_condition(exact, stages[0])
            return check_cascade(system, exact, stages)

        return _verified(body, stages[-1].bound, shifts, failed)
    except NoCertificate as refusal:
        return Verdict(False, "", str(refusal))


def _verified(
    body: dict[str, Any],
    bound: str,
    shifts: Iterable[str],
    failed: Callable[[System], str],
) -> Verdict:
    """Check a well formed proof of the continuous law.

    `shifts` are those of stages that have none; `failed` tells of a system what fails.
    """
    if body["sha256"] != digest_of(body):
        return Verdict(False, bound, "the file was changed after it was made")
    region = KeptRegion(stage_record(body[REGION_KEY])) if REGION_KEY in body else None
    of_region = () if region is None else (region.stage.shift,)
    if any(shift != NO_SHIFT for shift in (*shifts, *of_region)):
        return Verdict(False, bound, "a shift stands in a stage that does not use it")
    if body["claim"] not in (claim_text(bound, False), claim_text(bound, True)):
        return Verdict(False, bound, "the claim is not that of the proof")
    system = loads(body["system"], "system")
    if reason := _left_open(system) or failed(system):
        return Verdict(False, bound, reason)
    rests_on = premises_from_x0(system, region)
    if region is not None and not is_only_in_region(rests_on):
        return Verdict(
            False, bound, "a region stands there that no premise needs, or that is not kept"
        )
    if body["claim"] != claim_text(bound, is_only_in_region(rests_on)):
        return Verdict(False, bound, "the claim is of other starts than the premises allow")
    return _rests_on(body, bound, rests_on, assumptions(system))


def _left_open(system: System) -> str:
    """Empty if the system states every number of its law, as a file that is checked anew must."""
    stated = system.law.settled(system.plant) == system.law
    return (
        "" if stated else "the file leaves numbers of its law to be computed: K and r of each end"
    )


def _is_online(body: dict[str, Any]) -> bool:
    """Whether a body claims a bound for gains that move."""
    return has_entries(body, "ends")


def _verify_online(body: dict[str, Any]) -> Verdict:
    """Check a proof for gains that move."""
    check_layout(body)
    if body["format"] != FORMAT or len(body["proof"]) != 1:
        raise InputError("format", f"must be {FORMAT}, with one proof for gains that move")
    proof = online_record(body["proof"][0])
    shifts = (stage.shift for stage in proof.ends)
    return _verified(body, proof.bound, shifts, lambda system: failed_online(system, proof))


def _is_cover(body: dict[str, Any]) -> bool:
    """Whether a body claims a bound by cells of the ranges of constants."""
    return has_entries(body, "cell")


def _verify_cover(body: dict[str, Any]) -> Verdict:
    """Check a proof by cells."""
    check_new_layout(body, "a proof by cells")
    if len(body["proof"]) > MAX_PROOF_CELLS:
        raise InputError("proof", f"must have at most {MAX_PROOF_CELLS} cells")
    cells = tuple(map(cell_record, body["proof"]))
    bound = cover_bound(cells)
    shifts = (stage.shift for cell in cells for stage in cell.points)
    return _verified(body, bound, shifts, lambda system: check_cells(system, cells, bound))


def _verify_bootstrap(body: dict[str, Any]) -> Verdict:
    """Check a proof by a bootstrap."""
    check_new_layout(body, "a bootstrap")
    first, stages = stage_record(body["proof"][0]), bootstrap_stages(body["proof"][1:])

    def failed(system: System) -> str:
        return check_bootstrap(system, error_problem(system, rational), first, stages)

    return _verified(body, claimed_bound(stages), (first.shift,), failed)


def _verify_implemented(body: dict[str, Any]) -> Verdict:
    """Check a proof of the implemented loop."""
    check_layout_as_run(body)
    proofs = implemented_proofs(body["proof"])
    bound = largest_bound(proofs)
    if body["sha256"] != digest_of(body):
        return Verdict(False, bound, "the file was changed after it was made")
    system = loads(body["system"], "system")
    rests_on = premises_as_implemented(system, proofs)
    if body["claim"] != claim_of(system, bound, rests_on):
        return Verdict(False, bound, "the claim is not that of the proof")
    if is_only_in_region(rests_on) and without_polytopes(proofs) != proofs:
        reason = "a bound of w holds in the region of x0 only, and other starts are claimed"
        return Verdict(False, bound, reason)
    if reason := _left_open(system) or failed_cover(system, proofs):
        return Verdict(False, bound, reason)
    return _rests_on(body, bound, rests_on, ())


def _verify_sampled_adaptive(body: dict[str, Any]) -> Verdict:
    """Check a proof of the adaptive law as implemented."""
    check_layout_as_run(body)
    proof = sampled_adaptive_record(body["proof"])
    bound = proof.bound
    if body["sha256"] != digest_of(body):
        return Verdict(False, bound, "the file was changed after it was made")
    if body["claim"] != sampled_claim(proof):
        return Verdict(False, bound, "the claim is not that of the proof")
    system = loads(body["system"], "system")
    if reason := _left_open(system) or failed_sampled_adaptive(system, proof):
        return Verdict(False, bound, reason)
    return _rests_on(body, bound, premises_of_sampled_adaptive(system, proof), ())


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
    return tuple(map(stage_record, body["proof"]))
