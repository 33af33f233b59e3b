"""A member's reference: the file's, with an amplitude and a frequency of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from certrack.references import SymbolicReference

#: Keeps the declared bounds of a scaled reference above its own, in spite of rounding.
ABOVE_ONE = 1 + 1e-12


def scaled_reference(reference: Any, point: Mapping[str, float]) -> Any:
    """A y_d(F t), with the A and F that a member draws; the reference itself if it draws none."""
    scales = {name: point[name] for name in ("amplitude", "frequency") if name in point}
    if not scales:
        return reference
    assert isinstance(reference, SymbolicReference)
    a, f = scales.get("amplitude", 1.0), scales.get("frequency", 1.0)
    text = reference.signal.text
    if "frequency" in scales:
        text = re.sub(r"\bt\b", "(member_frequency*t)", text)
    if "amplitude" in scales:
        text = f"member_amplitude*({text})"
    constants: dict[str, Any] = dict(reference.constants)
    constants |= {f"member_{name}": value for name, value in scales.items()}
    slack = abs(a) * ABOVE_ONE
    declared = reference.declared
    return SymbolicReference(
        text,  # type: ignore[arg-type]
        None if reference.bound is None else slack * max(1.0, f) * reference.bound,
        None if declared is None else tuple(slack * f**i * Y for i, Y in enumerate(declared)),
        constants,  # type: ignore[arg-type]
    )
