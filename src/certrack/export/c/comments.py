"""What the header of exported C says in comments: for which system, of which inputs and states."""

from __future__ import annotations

import sympy

from certrack.core.version import version
from certrack.export.c.printer import comment
from certrack.export.program import ControllerProgram, unread_states
from certrack.laws import Law, Linear
from certrack.laws.baselines.base import Baseline
from certrack.laws.integral import INTEGRAL
from certrack.systems.system import System
from certrack.systems.writer import to_text

#: Characters; a longer text of the system is not repeated in the header.
MAX_SYSTEM_TEXT = 20_000


def introduction(name: str, system: System) -> str:
    """What the first comment says."""
    implementation = system.implementation
    assert implementation is not None
    law = system.law.settled(system.plant)
    text = to_text(system.replace(law=law)).splitlines()
    if sum(map(len, text)) > MAX_SYSTEM_TEXT:
        text = [f"({sum(map(len, text))} characters: too long to be repeated here)"]
    order = system.controller.coordinates.q
    lines = [
        f"{name}: tracking controller, sampled every {implementation.period!r} s.",
        "",
        f"Written by certrack {version()}. Design: {law.kind} law, {_gains(law)},",
        f"feed-forward order {order}. This is no certificate: guarantees are proven in continuous",
        "time; simulate the sampled loop before you rely on them.",
        "",
        "The system it was made for:",
        "",
        *(f"  {line}" for line in text),
    ]
    return comment(lines)


def _gains(law: Law) -> str:
    """What the comment names of the law."""
    if isinstance(law, Linear):
        return f"K = ({', '.join(f'{value:g}' for value in law.K or ())})"
    if isinstance(law, Baseline):
        return ", ".join(f"{name} = {getattr(law, name):g}" for name in law.tuned)
    return f"c = ({', '.join(f'{value:g}' for value in law.c)}) 1/s"


def inputs_comment(system: System) -> str:
    """The comment on the entries of x."""
    states, unread = ", ".join(system.plant.states), unread_states(system)
    if not unread:
        return f"/* Measured plant states x: {states}. */"
    notes = (f" * {name}: {note}." for name, note in unread.items())
    return "\n".join([f"/* Plant states x, measured: {states};", *notes, " */"])


def member_note(program: ControllerProgram, symbol: sympy.Symbol) -> str:
    """A comment on a member of the state."""
    kind, _, which = program.labels[symbol].partition("_")
    if symbol in program.controller.estimates:
        if symbol == INTEGRAL:
            return " /* integral of x_1 - y_d */"
        notes = {"delta": "estimate of 1/g_n", "theta": "estimate of an unknown parameter"}
        return f" /* {notes[kind]} */" if kind in notes and which.startswith("hat") else ""
    notes = {
        "before": "the state before it, one sample ago",
        "speed": "its filtered difference",
        "first": "1 before the first sample, then 0",
        "sample": "number of the sample: its time over the period",
        "u": "the last input",
        "predicted": "what the observer expects at the next sample",
        "d": "what acts on its rate, estimated",
        "past": "a command that still acts",
    }
    of_a_state = ("before", "speed", "predicted", "d")
    return f" /* {which}: {notes[kind]} */" if kind in of_a_state else f" /* {notes[kind]} */"
