"""What is proven of a design, as far as a tuning waits for it."""

from __future__ import annotations

from certrack.certificates.certificate import Certificate
from certrack.certificates.certify import certify
from certrack.certificates.implemented.certify import KIND
from certrack.certificates.methods import smallest
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.scope import has_ranges
from certrack.systems.system import System


def certified(system: System) -> Certificate:
    """The best certificate of a system: that of the loop as implemented, else the smallest.

    Ranges are cut into cells, which takes seconds: gains that were searched for the corners may be
    too sharp for one proof of the whole box. The loop as implemented, of which the cells take
    minutes, is tried for the whole box only.
    """
    result = certify(system, "fast")
    if not has_ranges(system) or result.best.kind == KIND or result.contradicted:
        return result.best
    ranges = certify_ranges(system.long_run)
    return smallest((ranges.best, result.best)) or result.best
