"""What is said of the bounds on the input."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from certrack.certificates.input_bounds import InputBounds, certify_input
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.core.rounding import printed_bound
from certrack.reports.tables import BOUND_TEXT_DIGITS
from certrack.systems.system import System

#: What cannot be bounded over the starts of an ensemble.
OWN_STATES = (
    "[ensemble].x0 is of the truth's own states (truth.states), and a bound is of a box of the "
    "plant's"
)

#: Names in words.
WORDS = {
    "energy": "energy",
    "rms": "root mean square in the long run",
    "peak": "|u|",
    "ultimate": "|u| in the long run",
}


def bounds_of_input(system: System) -> dict[str, Any]:
    """Bounds from x0, and over the box of starts of the file's ensemble, ready for JSON."""
    rests_on = premises(system)
    broken = contradicted(rests_on)
    here, over = certify_input(system), None
    if broken:
        here = InputBounds(reason=f"a premise is contradicted: {broken[0].detail}")
    starts = None if system.population is None else system.population.x0
    if starts is not None and not here.reason:
        if system.truth.states:
            over = InputBounds(reason=OWN_STATES)
        else:
            over = certify_input(system, [(entry.low, entry.high) for entry in starts])
    return {
        "input": _record(here) | {"premises": [premise.record() for premise in rests_on]},
        "input_over_starts": None if over is None else _record(over),
    }


def _record(bounds: InputBounds) -> dict[str, Any]:
    return bounds.record() | {"verified": not bounds.reason}


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
    law = "continuous law"
    if system.law.observer is not None:
        law += " without the input of law.observer"
    lines = [f"input, {law}, verified exactly: " + "; ".join(shown)] if any(_values(here)) else []
    lines += [f"no bound of {WORDS[k]}: {reason}" for k, reason in here["missing"].items()]
    if over is not None:
        where = "from any start of [ensemble]"
        if over["reason"]:
            lines.append(f"no bound of the input {where}: {over['reason']}")
        new = {k: v for k, v in over["missing"].items() if k not in here["missing"]}
        lines += [f"no bound of {WORDS[k]} {where}: {reason}" for k, reason in new.items()]
    return lines


def _values(record: Mapping[str, Any]) -> Iterator[bool]:
    names = ("energy", "rms_input", "peak_input", "ultimate_input")
    return (record[name] is not None for name in names)
