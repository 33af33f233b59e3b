"""The proof of the sampled adaptive loop in a certificate file: well formed, or refused."""

from __future__ import annotations

from typing import Any

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.document import (
    MAX_FUNCTIONS,
    MAX_STAGES,
    function_record,
    list_of,
    one_text,
    pair_of_texts,
    region_record,
    require_fields,
)
from certrack.certificates.bootstrap.proof import FunctionProof
from certrack.certificates.layout import has_entries, refusing_malformed_proof
from certrack.certificates.sampled_adaptive.proof import (
    InvariantSet,
    SampledAdaptiveProof,
    SampledStage,
)
from certrack.core.errors import InputError


def is_sampled_adaptive(body: Any) -> bool:
    """Whether a body claims a bound of the adaptive law as implemented."""
    return has_entries(body, "invariant")


def sampled_adaptive_record(entries: list[Any]) -> SampledAdaptiveProof:
    """The one proof of a body.

    Raises
    ------
    InputError
        If it is not well formed.
    """
    if len(entries) != 1:
        raise InputError("proof", "must be one, for an adaptive law as implemented")
    with refusing_malformed_proof():
        require_fields(entries[0], SampledAdaptiveProof)
        entry = entries[0]
        return SampledAdaptiveProof(
            invariant=_invariant_of(entry["invariant"]),
            row=list_of(entry["row"], one_text),
            stages=list_of(entry["stages"], _sampled_stage_of, MAX_STAGES),
        )


def _invariant_of(entry: Any) -> InvariantSet:
    require_fields(entry, InvariantSet)
    region, function = region_record(entry["region"]), function_record(entry["function"])
    return InvariantSet(
        region=region,
        law=one_text(entry["law"]),
        estimates=list_of(entry["estimates"], one_text),
        function=function,
        room=one_text(entry["room"]),
        starts=list_of(entry["starts"], one_text),
        priors=list_of(entry["priors"], pair_of_texts),
    )


def _sampled_stage_of(entry: Any) -> SampledStage:
    require_fields(entry, SampledStage)
    functions: tuple[FunctionProof, ...] = list_of(
        entry["functions"], function_record, MAX_FUNCTIONS
    )
    region: Region = region_record(entry["region"])
    return SampledStage(
        region=region,
        pace=pair_of_texts(entry["pace"]),
        law=one_text(entry["law"]),
        estimates=list_of(entry["estimates"], one_text),
        functions=functions,
    )
