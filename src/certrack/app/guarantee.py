"""Bounds with their words: an estimate in floats, and what is proven."""

from __future__ import annotations

import math
import time
from typing import Any

from certrack.app.frames import FrameKind, pack_frame
from certrack.certificates import Certificate, Certificates
from certrack.certificates.estimates.estimate import BoundEstimate
from certrack.certificates.implemented.drive import NO_IMPLEMENTATION
from certrack.core.rounding import printed_bound, rounded_down
from certrack.reports.tables import BOUND_TEXT_DIGITS
from certrack.systems.system import System


def estimate_frame(bound: BoundEstimate, design: int, began: float) -> bytes:
    """An estimate, which is no proof.

    Parameters
    ----------
    bound : BoundEstimate
    design : int
    began : float
        ``time.perf_counter()`` when the work began.
    """
    tube = bound.tube
    header = {
        "bound": bound.bound,
        "text": printed_bound(bound.bound, BOUND_TEXT_DIGITS),
        "method": bound.method,
        "reason": bound.reason,
        "shares": shares_of(bound),
        "shares_of": bound.method,
        "tube": None
        if tube is None
        else {"pieces": [[0.0, tube.start**2, tube.bound**2]], "alpha": tube.alpha},
        "ms": _milliseconds(began),
    }
    return pack_frame(FrameKind.BOUND, header, design=design)


def shares_of(bound: BoundEstimate) -> list[tuple[str, float]]:
    """What each cause adds to the bound, as parts of it."""
    total = sum(bound.shares.values())
    return [(name, value / total) for name, value in bound.shares.items()] if total else []


def certificates_frame(
    system: System,
    results: Certificates,
    near: BoundEstimate,
    *,
    effort: str,
    design: int,
    began: float,
    nominal: BoundEstimate | None = None,
) -> bytes:
    """All certificates of a design.

    Parameters
    ----------
    system : System
    results : Certificates
    near : BoundEstimate
        Of the same design: it tells where the bound comes from.
    effort : str
    design : int
    began : float
    nominal : BoundEstimate, optional
        Of the continuous law with the constants as they stand: it tells in the place of `near`,
        where that does not.
    """
    causes = near if near.shares or nominal is None else nominal
    best, broken = results.best, results.contradicted
    exists = best.exists
    as_run = best is results.implemented or best is results.sampled
    header = {
        "effort": effort,
        "bound": best.bound if exists else None,
        "text": printed_bound(best.bound if exists else None, BOUND_TEXT_DIGITS),
        "method": best.kind if exists else "",
        "loop": "implemented" if as_run else "continuous",
        "verified": results.verified,
        "reason": _reason(system, results),
        "contradicted": [premise.record() for premise in broken],
        "premises": [premise.record() for premise in results.premises],
        "certificates": _rows(results),
        "shares": shares_of(causes),
        "shares_of": causes.method,
        "shares_nominal": causes is not near,
        "tube": _tube_record(results),
        "facts": _facts(system, results),
        "ms": _milliseconds(began),
    }
    return pack_frame(FrameKind.EXACT, header, design=design)


def _tube_record(results: Certificates) -> dict[str, Any] | None:
    tube = results.tube
    if tube is None:
        return None
    pieces = tube.pieces or ((0.0, tube.start, tube.floor),)
    return {"pieces": pieces, "alpha": tube.alpha, "kind": results.tube_kind}


def _rows(results: Certificates) -> list[dict[str, Any]]:
    """Every certificate of this loop, in the order of the command line."""
    sampled = results.implemented.reason != NO_IMPLEMENTATION
    rows = []
    drives = ("sampled",) if results.sampled.exists else ("implemented",)
    for kind in (*results.kinds, *drives) if sampled else results.kinds:
        entry: Certificate = getattr(results, kind)
        rows.append(
            {
                "kind": kind,
                "bound": entry.bound if entry.exists else None,
                "text": printed_bound(entry.bound if entry.exists else None, BOUND_TEXT_DIGITS),
                "verified": entry.verified,
                "reason": "" if entry.verified else entry.reason,
            }
        )
    return rows


def _reason(system: System, results: Certificates) -> str:
    """Why there is no bound, or why nothing is of the loop as the drive runs it."""
    if results.contradicted:
        return results.contradicted[0].detail
    if not results.best.exists:
        return results.reason
    if results.best is results.sampled or system.implementation is None:
        return ""
    if results.sampled.verified:
        return "of the continuous law: the file's start is not one that sampled is proven for"
    if not results.implemented.verified:
        return f"of the continuous law: {results.implemented.reason}"
    return ""


def _facts(system: System, results: Certificates) -> list[tuple[str, str]]:
    """What else a user asks: when the error is within the band, how much more is tolerated."""
    unit = output_unit(system)
    facts: list[tuple[str, str]] = []
    if (band := system.settings.band) is not None and results.tube is not None:
        seconds = results.tube.settling_time(band)
        when = "never" if math.isinf(seconds) else f"after {printed_bound(seconds, 3)} s"
        facts.append((f"within \N{PLUS-MINUS SIGN}{band:g}{unit}, proven", when))
    if results.starts_box is not None:
        box = f"x0 \N{PLUS-MINUS SIGN} {rounded_down(results.starts_box, 3)}"
        facts.append(("holds from starts in", box))
    scale = results.critical_semidefinite
    if scale:
        text = (
            "no limit" if math.isinf(scale) else f"{rounded_down(scale, 4)} \N{MULTIPLICATION SIGN}"
        )
        facts.append(("tolerates uncertainty", text))
    if results.critical_ranges is not None:
        strength = rounded_down(results.critical_ranges.scale, 4)
        facts.append(("tolerates ranges", f"{strength} \N{MULTIPLICATION SIGN}"))
    return facts


def output_unit(system: System) -> str:
    """The unit of the output with a blank before it; empty where it has none."""
    unit = (system.plant.units or ("",))[0]
    return "" if unit in ("", "1") else f" {unit}"


def _milliseconds(began: float) -> float:
    return round(1e3 * (time.perf_counter() - began), 1)
