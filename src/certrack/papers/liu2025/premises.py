"""Whether the paper's constants cover what its examples simulate."""

from __future__ import annotations

import numpy as np

from certrack.certificates.assumption_1 import check_assumption_1
from certrack.papers.liu2025.claim import Claim, judged
from certrack.systems.reader import load


def premises_claim(where: str, name: str) -> Claim:
    """Assumptions 1 and 2 with the constants that the paper gives."""
    system = load(name)
    violations = check_assumption_1(system)
    t = np.linspace(0, system.settings.duration, 200_001)
    largest = float(np.abs(system.reference.values(t, 1)).sum(axis=0).max())
    D = system.reference.declared_bound
    assert D is not None
    return Claim(
        where,
        "Assumptions 1 and 2 hold with the constants stated",
        "a search for a point where |w_k| exceeds gamma_k ||xi|| + beta_k (not a proof); largest "
        "|y_d| + |y_d'|",
        f"no violation in 40,000 points a term; {largest:.3f} against D = {D:g}"
        if not violations
        else str(violations[0]),
        judged(not violations and largest <= D),
    )
