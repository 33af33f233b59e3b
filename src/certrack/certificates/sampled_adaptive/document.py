"""The proof of the sampled adaptive loop in a certificate file: well formed, or refused."""

from __future__ import annotations

from typing import Any

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.document import (
    MAX_FUNCTIONS,
    MAX_STAGES,
    function_record,
    keys_of,
    list_of,
    pair_of_texts,
    region_record,
    text_of,
)
from certrack.certificates.bootstrap.proof import FunctionProof
from certrack.certificates.sampled_adaptive.proof import (
    KeptSet,
    SampledAdaptiveProof,
    SampledStage,
)
from certrack.core.errors import InputError


def is_sampled_adaptive(body: Any) -> bool:
    """Whether a body claims a bound of the adaptive law as implemented."""
    proof = body.get("proof") if isinstance(body, dict) else None
    return (
        isinstance(proof, list)
        and bool(proof)
        and all(isinstance(entry, dict) and "kept" in entry for entry in proof)
    )


def sampled_adaptive_record(entries: list[Any]) -> SampledAdaptiveProof:
    """The one proof of a body.

    Raises
    ------
    InputError
        If it is not well formed.
    """
    if len(entries) != 1:
        raise InputError("proof", "must be one, for an adaptive law as implemented")
    try:
        keys_of(entries[0], SampledAdaptiveProof)
        entry = entries[0]
        return SampledAdaptiveProof(
            kept=_kept_of(entry["kept"]),
            row=list_of(entry["row"], text_of),
            stages=list_of(entry["stages"], _stage_of, MAX_STAGES),
        )
    except (TypeError, ValueError) as problem:
        raise InputError("proof", f"must hold decimal texts ({problem})") from None


def _kept_of(entry: Any) -> KeptSet:
    keys_of(entry, KeptSet)
    region, function = region_record(entry["region"]), function_record(entry["function"])
    return KeptSet(
        region=region,
        law=text_of(entry["law"]),
        estimates=list_of(entry["estimates"], text_of),
        function=function,
        room=text_of(entry["room"]),
        starts=list_of(entry["starts"], text_of),
        priors=list_of(entry["priors"], pair_of_texts),
    )


def _stage_of(entry: Any) -> SampledStage:
    keys_of(entry, SampledStage)
    functions: tuple[FunctionProof, ...] = list_of(
        entry["functions"], function_record, MAX_FUNCTIONS
    )
    region: Region = region_record(entry["region"])
    return SampledStage(
        region=region,
        pace=pair_of_texts(entry["pace"]),
        law=text_of(entry["law"]),
        estimates=list_of(entry["estimates"], text_of),
        functions=functions,
    )
