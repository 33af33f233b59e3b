"""What is said of certificates: bounds side by side, what they mean, and all of it as JSON."""

from __future__ import annotations

import math
from typing import Any

from certrack.certificates import Certificate, Certificates
from certrack.certificates.claimed_starts import claimed_starts
from certrack.certificates.implemented.drive import NO_IMPLEMENTATION
from certrack.certificates.methods import MOVING_KINDS, RANGE_KINDS
from certrack.certificates.tube import TUBE_ROUNDING, Tube
from certrack.core.rounding import printed_bound, rounded_down
from certrack.reports.sampled import (
    from_its_starts,
    implemented_notes,
    implemented_summary,
    sampled_notes,
    sampled_summary,
)
from certrack.reports.tables import BOUND_TEXT_DIGITS, Table, table

#: What stands for a critical strength without limit.
LARGEST_STRENGTH = 1e9

#: What `best` says of the starts where it is of all.
EVERY_START = "every start"

#: The error counts as settled in the tube where it is within this part of the bound.
SETTLED_MARGIN = 0.1


def certificates_summary(results: Certificates) -> dict[str, Any]:
    """All certificates, ready for JSON; a bound that does not exist is null."""

    def entries(certificate: Certificate) -> dict[str, Any]:
        return {
            "bound": certificate.bound,
            "alpha": certificate.alpha,
            "delta": certificate.delta,
            "verified": certificate.verified,
            "reason": certificate.reason,
        }

    return {
        **{kind: entries(getattr(results, kind)) for kind in (*MOVING_KINDS, *RANGE_KINDS)},
        "implemented": entries(results.implemented) | implemented_summary(results.implemented),
        "sampled": entries(results.sampled) | sampled_summary(results.sampled),
        "attainable": results.attainable,
        "verified": results.verified,
        "best": _best(results),
        "starts_box": results.starts_box,
        "critical_strength": {
            "published": min(results.critical_published, LARGEST_STRENGTH),
            "semidefinite": min(results.critical_semidefinite, LARGEST_STRENGTH),
            "beyond": math.isinf(results.critical_semidefinite),
        },
        "tube": None
        if results.tube is None
        else {
            "start": results.tube.start,
            "floor": results.tube.floor,
            "alpha": results.tube.alpha,
            "kind": results.tube_kind,
            "pieces": results.tube.pieces,
            "verified": results.tube.verified,
        },
        "premises": [premise.record() for premise in results.premises],
    }


def certified_starts(results: Certificates) -> str:
    """From which starts the bounds of the continuous loop hold, in words; nothing for all."""
    if results.starts_box is None:
        return ""
    box = rounded_down(results.starts_box, 3)
    return f" from simulation.x0 and every start with |x_i - x0_i| <= {box}"


def _best(results: Certificates) -> dict[str, Any] | None:
    """The tightest bound if it is verified for this file; None else."""
    if not results.verified:
        return None
    best = results.best
    as_run = best is results.implemented or best is results.sampled
    loop = "implemented" if as_run else "continuous"
    return {
        "method": best.kind,
        "bound": best.bound,
        "verified": True,
        "loop": loop,
        "starts": claimed_starts(results) or EVERY_START,
    }


def certificates_table(results: Certificates) -> Table:
    """Bounds side by side."""
    notes = {
        "published": "the paper's; its last step is not valid for every gain",
        "corrected": "with rho2",
        "rate": "V' <= -alpha V + Delta",
        "semidefinite": "best Lyapunov function",
        "cascade": "e_n first, then e_1 with e_n as bounded input",
        "bootstrap": "functions on the set that is reached, again and again",
        "vertices": "one Lyapunov function for all constants, which may vary",
        "peak": "peak gains for all constants, which may vary"
        if results.kinds == RANGE_KINDS
        else "peak gains of the error loop",
        "cells": "the ranges cut into cells, for constants that stand still",
        "online": "for every motion of the gains between their ends",
        "implemented": "peak gains of the loop as the drive runs it"
        + (": the one to ship with" if results.implemented.verified else ""),
        "sampled": f"the adaptive law as the drive runs it, {from_its_starts(results.sampled)}",
    }
    rows, last = [], ""
    sampled = results.implemented.reason != NO_IMPLEMENTATION
    drives = ("sampled",) if results.sampled.exists else ("implemented",)
    for kind in (*results.kinds, *drives) if sampled else results.kinds:
        entry: Certificate = getattr(results, kind)
        checked = "exactly" if entry.verified else "-"
        text = entry.reason if entry.reason and not entry.verified else notes[kind]
        bound = printed_bound(entry.bound if entry.exists else None, BOUND_TEXT_DIGITS)
        rows.append([kind, bound, checked, "as above" if text == last else text])
        last = text
    return table("limsup |e_1| <=", ["certificate", "bound", "verified", "note"], rows)


def certificates_notes(results: Certificates) -> list[str]:
    """Critical strengths, tube and assumptions in words."""
    if results.kinds == RANGE_KINDS and results.tightest:
        attained, lines = results.attainable, ["the nominal certificates do not cover plant.ranges"]
        if attained is not None:
            lines.append(
                "attainable by the continuous law at the worst corner of the ranges: "
                f"{rounded_down(attained, 5)} (a linear program over references; no proof)"
            )
    else:
        lines = [
            "critical strength (common scale of tau): published "
            f"{_strength_text(results.critical_published)}, semidefinite "
            f"{_strength_text(results.critical_semidefinite)}"
        ]
    lines = [*implemented_notes(results.implemented, BOUND_TEXT_DIGITS), *lines]
    lines = [*sampled_notes(results.sampled, BOUND_TEXT_DIGITS), *lines]
    if results.starts_box is not None:
        where = f"a premise holds in a region only, so the bounds hold{certified_starts(results)}"
        lines.insert(0, where)
    if results.tube is not None:
        lines.append(_of_tube(results, results.tube))
    return lines


def _of_tube(results: Certificates, tube: Tube) -> str:
    """Where the tube begins, and when it is near the bound that holds in the long run.

    With a soft start the tube has a floor of its own, which the bound may be far below.
    """
    bound = getattr(results, results.tube_kind).bound
    level, where, later = (1 + SETTLED_MARGIN) * bound, f"the bound of {results.tube_kind}", ""
    if not math.isfinite(bound) or math.isinf(tube.settling_time(level)):
        floor = math.sqrt(tube.floor) * TUBE_ROUNDING
        level = (1 + SETTLED_MARGIN) * floor
        where = f"its floor of {printed_bound(floor, BOUND_TEXT_DIGITS)}"
        if math.isfinite(bound):
            later = f"; it counts a soft start for ever, the bound of {results.tube_kind} does not"
    start = printed_bound(float(tube(0.0)), BOUND_TEXT_DIGITS)
    if tube.settling_time(level) == 0:  # as it begins, and so ever after
        lasting = printed_bound(level, BOUND_TEXT_DIGITS)
        verified = "" if tube.verified else " (the start is not verified)"
        return (
            f"tube from x0: |e_1| <= {start} at t = 0, and |e_1| <= {lasting} at all times, "
            f"{100 * SETTLED_MARGIN:g} % above {where}{later}{verified}"
        )
    settled = printed_bound(tube.settling_time(level), BOUND_TEXT_DIGITS)
    verified = "" if tube.verified else " (the start is not verified)"
    return (
        f"tube from x0: |e_1| <= {start} at t = 0, within {100 * SETTLED_MARGIN:g} % of {where} "
        f"after {settled} s{later}{verified}"
    )


def _strength_text(scale: float) -> str:
    """A critical strength, rounded down."""
    if not scale:
        return "none"
    if math.isinf(scale):
        return f"> {LARGEST_STRENGTH:.0e} (no term grows with the state)".replace("e+0", "e")
    return rounded_down(scale, BOUND_TEXT_DIGITS)
