"""What is said of the bounds on the input."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from certrack.certificates.input_bounds import certify_input
from certrack.core.rounding import printed_bound
from certrack.reports.tables import BOUND_TEXT_DIGITS
from certrack.systems.system import System


def bounds_of_input(system: System) -> dict[str, Any]:
    """Bounds from x0, and over the box of starts of the file's ensemble, ready for JSON."""
    here, over = certify_input(system).record(), None
    starts = None if system.population is None else system.population.x0
    if starts is not None and here["peak_input"] is not None:
        box = [(float(entry.low), float(entry.high)) for entry in starts]
        over = certify_input(system, box).record()
    return {"input": here, "input_over_starts": over}


def input_lines(system: System, bounds: Mapping[str, Any]) -> list[str]:
    """The same in words."""
    if not bounds:
        return []
    here, over = bounds["input"], bounds["input_over_starts"]
    if here["reason"]:
        return [f"no bound of the input: {here['reason']}"]
    parts = {
        "|u| from x0": here["peak_input"],
        f"energy over {system.settings.duration:g} s": here["energy"],
        "|u| in the long run": here["ultimate_input"],
        "root mean square in the long run": here["rms_input"],
        "|u| from any start of [ensemble]": over and over["peak_input"],
        "energy from any of them": over and over["energy"],
    }
    shown = (
        f"{name} <= {printed_bound(value, BOUND_TEXT_DIGITS)}"
        for name, value in parts.items()
        if value is not None
    )
    return ["input, continuous law, verified exactly: " + "; ".join(shown)]
