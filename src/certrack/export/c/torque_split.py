"""The share of two motors in C: NAME_split.h, for a drive that commands both."""

from __future__ import annotations

from certrack.export.c.printer import c_literal
from certrack.export.c.source import CCode
from certrack.export.templates import fill_template
from certrack.loops.energy import motor_numbers


def split_header(code: CCode) -> str:
    """Contents of NAME_split.h, of a system whose truth has two motors."""
    numbers = motor_numbers(code.system)
    return fill_template(
        "c/templates/controller_split.h",
        name=code.name,
        guard=f"{code.name.upper()}_SPLIT_H",
        share=c_literal(numbers.share, code.real),
        damping=c_literal(numbers.damping, code.real),
        one=c_literal(1.0, code.real),
    )
