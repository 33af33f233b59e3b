"""Whether the tuned design keeps its limits where it is measured, and not only in the search."""

from __future__ import annotations

import math
from collections.abc import Sequence

from certrack.core.rounding import rounded_up
from certrack.tuning.limits import Limit
from certrack.tuning.measure import SIMULATED, Measured


def broken_limits(limits: Sequence[Limit], figures: Measured) -> list[str]:
    """A sentence for each limit that the figures exceed.

    The search knows the loop without its drive, a nominal run, and some corners of the box; the
    figures are of the exact certificate, of the file's run and of an ensemble of starts.
    """
    measured = {"error": figures.certified, "energy": figures.energy}
    if figures.peak_is != SIMULATED:
        measured["peak input"] = figures.peak_input
    said = {}
    for limit in limits:
        value = measured.get(limit.name)
        if value is not None and not math.isnan(value) and not value <= limit.value:
            number = rounded_up(value, 5) if math.isfinite(value) else "none"
            what = "certified error" if limit.name == "error" else limit.name
            said[limit.name] = (
                f"{limit.describe()} is not kept: {what} {number} of the tuned design"
            )
    return list(said.values())
