"""What is said of a falsification."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from certrack.core.rounding import printed_bound
from certrack.reports.tables import Table, table

if TYPE_CHECKING:
    from certrack.certificates import Certificate
    from certrack.studies.falsifier.drive import DriveFalsification
    from certrack.studies.falsifier.falsify import Falsification
    from certrack.studies.falsifier.lost_starts import LostStarts


def falsification_summary(result: Falsification) -> dict[str, Any]:
    """The worst case and what it says of every certificate, ready for JSON."""
    error, against = result.worst_error, result.against
    others = [c for kind, c in result.certificates.items() if kind != "published"]
    certified = min(c.bound for c in others) if against is None else against.bound
    ratio = certified / error if error and result.alarm is None else None
    settling = result.alarm is None and against is not None and error > against.bound
    return {
        "worst_error": error,
        "certified": certified,
        "ratio": ratio,
        "against": None
        if against is None
        else {"method": against.kind, "bound": against.bound, "loop": "continuous"},
        "alarm": result.alarm,
        "alarm_reason": result.reason or None,
        "own_run": result.own_run,
        "origin": result.origin,
        "search_ended": result.ended,
        "stopped": result.stopped,
        "settling": settling,
        "drive": None if result.drive is None else _of_drive(result.drive),
        "left_out": dict(result.left_out),
        "certificates": {
            kind: _beside(c, error, settling) for kind, c in result.certificates.items()
        },
        "runs": result.evaluations,
    }


def _of_drive(drive: DriveFalsification) -> dict[str, Any]:
    """The worst case of the loop as it is implemented."""
    return {
        "worst_error": drive.worst_error,
        "estimate": drive.estimate,
        "stopped": drive.stopped,
        "certified": drive.certificate.bound,
        "verified": drive.certificate.verified,
        "reason": drive.certificate.reason or None,
        "ratio": drive.certificate.bound / drive.worst_error if drive.worst_error else math.inf,
        "first_escape": _of_escape(drive),
        "runs": drive.runs,
    }


def _of_escape(drive: DriveFalsification) -> dict[str, Any] | None:
    """The nearest start from which the states escape."""
    escape = drive.escape
    if escape is None:
        return None
    x0 = list(escape.system.settings.x0)
    return {"box": list(escape.box), "x0": x0, "in_certified_box": escape.within}


def drive_lines(drive: Mapping[str, Any]) -> list[str]:
    """The same in words."""
    estimate = math.nan if drive["estimate"] is None else drive["estimate"]
    of_rounding = f"with the sensors' rounding at its worst, by the linear loop: {estimate:.6g}"
    certified = printed_bound(drive["certified"])
    if not drive["verified"]:
        certified += f" (not verified: {drive['reason']})"
    lines = [
        f"as implemented, worst |e_1| found: {drive['worst_error']:.6g} (simulated)",
        *([] if drive["estimate"] is None else [of_rounding]),
        f"as implemented, certified limsup |e_1|: {certified}",
    ]
    if (escape := drive["first_escape"]) is not None:
        box = ", ".join(f"+-{half:.4g}" for half in escape["box"])
        lines.append(
            f"as implemented, first escape found at a corner of the box {box}"
            + (": INSIDE the certified box" if escape["in_certified_box"] else "")
        )
    return lines


def _beside(certificate: Certificate, error: float, settling: bool) -> dict[str, Any]:
    """A bound beside the worst error found; a bound that does not exist is null.

    A run that is still settling, within the tube, says nothing against a bound in the long run.
    """
    return {
        "bound": certificate.bound,
        "verified": certificate.verified,
        "ratio": certificate.bound / error if error else math.inf,
        "exceeded": error > certificate.bound and not settling,
    }


def falsification_table(entries: Mapping[str, Mapping[str, Any]]) -> Table:
    """Every bound that exists beside the worst error."""
    rows = [
        (
            kind,
            printed_bound(entry["bound"]),
            "exactly" if entry["verified"] else "-",
            entry["ratio"],
            "EXCEEDED by the case found" if entry["exceeded"] else "",
        )
        for kind, entry in entries.items()
        if entry["bound"] is not None and math.isfinite(entry["bound"])
    ]
    return table("", ["certificate", "bound", "verified", "ratio", "note"], rows)


#: Under which uncertain terms a start is lost, in words.
PATTERN_WORDS = {
    "own": "the file's own disturbances",
    "+": "every uncertain term at its upper bound",
    "-": "every uncertain term at its lower bound",
    "outward": "every uncertain term at its bound, with the sign of its state",
}


def lost_starts_summary(searched: LostStarts) -> dict[str, Any]:
    """What a search of lost starts gave, ready for JSON."""
    start = searched.nearest
    return {
        "box": [list(ends) for ends in searched.box],
        "runs": searched.runs,
        "lost": searched.lost,
        "largest_state": searched.largest,
        "nearest": None
        if start is None
        else {
            "x0": list(start.x0),
            "part": start.part,
            "under": start.pattern,
            "outcome": start.outcome,
            "time": start.time,
        },
    }


def lost_starts_lines(values: Mapping[str, Any], states: Sequence[str]) -> list[str]:
    """The same in words."""
    ends = ", ".join(
        f"{name} in [{low:g}, {high:g}]"
        for name, (low, high) in zip(states, values["box"], strict=True)
    )
    nearest, runs = values["nearest"], values["runs"]
    if nearest is None and values["lost"]:
        return [
            f"{values['lost']} of {runs} runs were lost, none of them when it was run again: {ends}"
        ]
    if nearest is None:
        return [
            f"no start of the box is lost in {runs} runs: {ends}",
            f"largest state of them: {values['largest_state']:.6g}; finding none proves nothing",
        ]
    x0 = ", ".join(
        f"{name} = {value:.10g}" for name, value in zip(states, nearest["x0"], strict=True)
    )
    ended = f"{nearest['outcome']} at t = {nearest['time']:.4g}"
    return [
        f"lost start: {x0}",
        f"under {PATTERN_WORDS[nearest['under']]}: {ended}",
        f"of the box {ends}: {nearest['part']:.3g} of the way from its middle to its end, the "
        "nearest found",
        f"{values['lost']} of {runs} runs were lost",
    ]
