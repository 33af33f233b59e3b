"""From which starts the bound holds that a result is summed up by, in words."""

from __future__ import annotations

from certrack.certificates.certify import Certificates
from certrack.certificates.implemented.from_starts import ANY_START, BOX
from certrack.core.rounding import rounded_down


def claimed_starts(results: Certificates) -> str:
    """Empty where the best bound holds from every start; else such as ``from x0``.

    Parameters
    ----------
    results : Certificates
    """
    if results.best is results.sampled:
        return "from x0 and the starts near the reference that the proof states"
    if results.best is results.implemented:
        implemented = results.implemented
        if implemented.starts == ANY_START:
            return ""
        if implemented.starts == BOX:
            return "from x0 and the box of starts"
        return "from x0" + ("" if implemented.polytope is None else " and the proven polytope")
    if results.starts_box is None:
        return ""
    return f"from x0 and every start with |x_i - x0_i| <= {rounded_down(results.starts_box, 3)}"
