"""What is said of the largest magnitude found of an output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from certrack.core.rounding import printed_bound

if TYPE_CHECKING:
    from certrack.studies.falsifier.any_output import OutputFalsification
    from certrack.studies.falsifier.drive import DriveFalsification

#: Where a worst case comes from, in words.
ORIGIN_WORDS = {
    "search": "",
    "own": ", the file's own",
    "kernels": ", by kernels and a linear program",
    "ascent": ", by an ascent from the worst of them",
}

#: What the user is told where the worst run has not reached its long run.
OUTPUT_SETTLING = (
    "The worst run has not settled from its start, which may add so much: it says nothing against "
    "a bound in the long run."
)


def output_summary(result: OutputFalsification) -> dict[str, Any]:
    """The worst case of an output beside its bound, ready for JSON."""
    claim = result.claim
    return {
        "output": result.output.name,
        "symbol": result.output.symbol_text,
        "worst": result.worst,
        "certified": claim.bound if claim.exists else None,
        "verified": claim.verified,
        "by": claim.by or None,
        "claim_reason": claim.reason or None,
        "ratio": claim.bound / result.worst if claim.exists and result.worst else None,
        "alarm": result.alarm,
        "alarm_reason": result.reason or None,
        "origin": result.origin,
        "search_ended": result.ended,
        "stopped": result.stopped,
        "settling": result.settling,
        "drive": None if result.drive is None else _of_output_as_implemented(result.drive),
        "left_out": dict(result.left_out),
        "runs": result.evaluations,
    }


def _of_output_as_implemented(drive: DriveFalsification) -> dict[str, Any]:
    certificate = drive.certificate
    return {
        "worst": drive.worst_error,
        "estimate": drive.estimate,
        "stopped": drive.stopped,
        "certified": certificate.bound if certificate.exists else None,
        "verified": certificate.verified,
        "reason": certificate.reason or None,
        "runs": drive.runs,
    }


def output_lines(values: Mapping[str, Any]) -> list[str]:
    """The same in words."""
    name, drive = values["symbol"], values["drive"]
    of = "" if drive is None else "continuous law, "
    origin = ORIGIN_WORDS[values["origin"]]
    lines = [
        f"{of}worst |{name}| found in {values['runs']} runs{origin}: {values['worst']:.6g}",
        f"stopped: {values['search_ended']}",
        f"{of}{_claimed(values, values['claim_reason'], values['by'])}",
    ]
    if values["ratio"] is not None and values["alarm"] is None:
        lines.append(f"certified / found: {values['ratio']:.3g}")
    if values["settling"]:
        lines.append(OUTPUT_SETTLING)
    if drive is None:
        return lines
    lines.append(f"as implemented, worst |{name}| found: {drive['worst']:.6g} (simulated)")
    if drive["estimate"] is not None:
        lines.append(
            f"with the sensors' rounding at its worst, by the linear loop: {drive['estimate']:.6g}"
        )
    lines.append(f"as implemented, {_claimed(values | drive, drive['reason'], None)}")
    return lines


def _claimed(values: Mapping[str, Any], reason: str | None, by: str | None) -> str:
    if values["certified"] is None:
        return f"no bound claimed: {reason}"
    text = f"certified limsup |{values['symbol']}|: {printed_bound(values['certified'])}"
    if not values["verified"]:
        return f"{text} (not verified: {reason})"
    return text if by is None else f"{text} (by {by})"
