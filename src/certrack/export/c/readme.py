"""The README that goes with exported C code."""

from __future__ import annotations

from certrack.export.c.source import CCode
from certrack.export.program import unread_states
from certrack.export.templates import fill_template

#: What every such file says.
README_KIND = "tracking controller in C99"


def readme(code: CCode, notes: tuple[str, ...]) -> str:
    """Contents of README.md."""
    implementation, unread = code.system.implementation, unread_states(code.system)
    assert implementation is not None
    states = [f"{s} ({unread[s]})" if s in unread else s for s in code.system.plant.states]
    references = ["y_d", *(f"y_d^({i})" for i in range(1, len(code.program.Y)))]
    return fill_template(
        "c/templates/README.md",
        name=code.name,
        kind=README_KIND,
        number=code.real,
        period=repr(implementation.period),
        notes="".join(f"**Note:** {note}\n\n" for note in notes),
        states=", ".join(states),
        references=", ".join(references),
        members=", ".join(code.members) if code.program.states else "nothing",
    )
