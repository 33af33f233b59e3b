"""The saved certificate: everything a third party needs to check it.

The file is JSON; see docs/certificate-file.md.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from certrack.certificates.bootstrap.check import claimed_bound
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.exact import Proof
from certrack.certificates.implemented.certify import claim_of, largest_bound
from certrack.certificates.implemented.document import (
    record_of,
)
from certrack.certificates.implemented.premises import premises_as_implemented
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.regional import is_of_starts
from certrack.certificates.layout import (
    FORMAT,
    MAX_CERTIFICATE_BYTES,
    REGION_KEY,
    digest_of,
)
from certrack.certificates.level_set import KeptRegion, premises_from_x0
from certrack.certificates.online.certify import OnlineProof
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.ranges.certify import cover_bound
from certrack.certificates.ranges.proofs import CellProof
from certrack.certificates.region import claim_text, is_only_in_region
from certrack.certificates.sampled_adaptive.certify import sampled_claim
from certrack.certificates.sampled_adaptive.premises import premises_of_sampled_adaptive
from certrack.certificates.sampled_adaptive.proof import (
    SampledAdaptiveProof,
)
from certrack.core.errors import CertrackError, InputError
from certrack.core.files import write_text
from certrack.core.version import version
from certrack.systems.system import System, require_system
from certrack.systems.writer import to_text

#: What a document holds: a stage, a cell, that of moving gains, or one of an implemented loop; and
#: the region that the states keep.
Stage = (
    Proof
    | CellProof
    | OnlineProof
    | ImplementedProof
    | BootstrapStage
    | SampledAdaptiveProof
    | KeptRegion
)


def to_document(system: System, *stages: Stage) -> dict[str, Any]:
    """The certificate as a JSON-ready dictionary.

    Parameters
    ----------
    system : System
    *stages : Proof
        One for a semidefinite bound, two or three for a cascade, the cells that fill the
        ranges of constants, or the proofs of the implemented loop; and the region that the states
        keep, where a premise holds there only.

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
    region = next((stage for stage in stages if isinstance(stage, KeptRegion)), None)
    stages = tuple(stage for stage in stages if not isinstance(stage, KeptRegion))
    if not stages:
        raise InputError("stages", "there is no proof to save")
    adaptive = [stage for stage in stages if isinstance(stage, SampledAdaptiveProof)]
    if adaptive:
        rests = premises_of_sampled_adaptive(system, adaptive[0])
        return _document(system, sampled_claim(adaptive[0]), rests, adaptive[:1])
    cells = tuple(stage for stage in stages if isinstance(stage, CellProof))
    sampled = tuple(stage for stage in stages if isinstance(stage, ImplementedProof))
    system = system if sampled and is_of_starts(system) else system.long_run
    if sampled:
        rests_on = premises_as_implemented(system, sampled)
    else:
        rests_on = premises_from_x0(system, region)
    grounded = tuple(stage for stage in stages if isinstance(stage, BootstrapStage))
    if cells or sampled or grounded:
        bound = cover_bound(cells) if cells else ""
        bound = largest_bound(sampled) if sampled else bound
        bound = claimed_bound(grounded) if grounded else bound
    else:
        bound = [stage for stage in stages if isinstance(stage, Proof | OnlineProof)][-1].bound
    if sampled:
        claim = claim_of(system, bound, rests_on)
    else:
        claim = claim_text(bound, is_only_in_region(rests_on))
    return _document(system, claim, rests_on, stages, region)


def _document(
    system: System,
    claim: str,
    rests_on: tuple[Premise, ...],
    stages: Sequence[Stage],
    region: KeptRegion | None = None,
) -> dict[str, Any]:
    """The file's body, with its digest."""
    if broken := contradicted(rests_on):
        raise InputError("premises", f"the truth contradicts one: {broken[0]}")
    body: dict[str, Any] = {
        "format": FORMAT,
        "made_by": f"certrack {version()}",
        "claim": claim,
        "premises": [premise.record() for premise in rests_on],
        "system": to_text(system.replace(law=system.law.settled(system.plant))),
        "proof": [json.loads(json.dumps(record_of(stage))) for stage in stages],
    }
    if region is not None:
        body[REGION_KEY] = json.loads(json.dumps(record_of(region.stage)))
    return body | {"sha256": digest_of(body)}


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
