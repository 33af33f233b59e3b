"""What is said of ranges: what each constant costs, and how far all may grow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from certrack.certificates.ranges.strength import STRENGTH_ACCURACY
from certrack.core.rounding import printed_bound, rounded_down
from certrack.reports import certificates
from certrack.reports.tables import BOUND_TEXT_DIGITS, Table, short_number, table

if TYPE_CHECKING:
    from certrack.certificates import Certificates


def costs_table(results: Certificates) -> Table:
    """What each range costs, the dearest first."""
    rows = []
    for entry in sorted(results.constants, key=lambda c: c.known):
        known = printed_bound(
            entry.known if math.isfinite(entry.known) else None, BOUND_TEXT_DIGITS
        )
        share = entry.cost / entry.bound if math.isfinite(entry.bound) and entry.bound else math.nan
        rows.append(
            [
                entry.name,
                f"[{short_number(entry.low)}, {short_number(entry.high)}]",
                known,
                entry.cost,
                f"{100 * share:.0f} %" if math.isfinite(share) else "-",
            ]
        )
    proven = all(entry.verified for entry in results.constants)
    title = (
        "what each range costs: limsup |e_1| <= if that constant were known, "
        f"{'each proven' if proven else 'not all verified'}"
    )
    return table(title, ["constant", "range", "if known", "costs", "of it"], rows, digits=3)


def strength_line(results: Certificates) -> list[str]:
    """How far all ranges may grow together."""
    strength = results.critical_ranges
    if strength is None:
        return []
    what = "critical strength (common scale of all half widths of plant.ranges): "
    if math.isinf(strength.scale):
        return [f"{what}> 1e9 (there is a certificate even there)"]
    if not strength.scale:
        return [f"{what}none: {strength.reason}"]
    scale = rounded_down(strength.scale, BOUND_TEXT_DIGITS)
    beyond = f"{100 * STRENGTH_ACCURACY:g} %"
    return [f"{what}{scale}; within {beyond} beyond it: {strength.reason}"]


def ranged_summary(results: Certificates) -> dict[str, Any]:
    """All certificates, ready for JSON, and what is said of ranges."""
    values, strength = certificates.certificates_summary(results), results.critical_ranges
    critical = values["critical_strength"] | {"ranges": None, "ranges_end": None}
    if strength is not None:
        critical["ranges"] = min(strength.scale, certificates.LARGEST_STRENGTH)
        critical["ranges_end"] = strength.reason or None
        critical["beyond"] = math.isinf(strength.scale)
    constants = [entry.record() for entry in results.constants]
    return values | {"critical_strength": critical, "constants": constants}
