"""Bounds of w that the truth keeps where the states of the implemented loop are.

From x0 the states are proven to stay within |x_i| <= X_i for all t >= 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from certrack.certificates.arithmetic import fraction
from certrack.certificates.exact import from_text
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.start_set import X0
from certrack.certificates.region import StateBounds


def region_of_runs(proofs: Sequence[ImplementedProof]) -> StateBounds | None:
    """Bounds of |x_1| ... |x_n| at all times from x0, over all delays; None if one has none."""
    peaks = [start.peaks[1:-2] for proof in proofs for start in proof.starts if start.of == X0]
    if not proofs or len(peaks) != len(proofs):
        return None
    return tuple(fraction(max(map(from_text, column))) for column in zip(*peaks, strict=True))


def without_polytopes(proofs: Sequence[ImplementedProof]) -> tuple[ImplementedProof, ...]:
    """The proofs without what they say of starts elsewhere than at x0."""
    return tuple(
        replace(proof, starts=tuple(start for start in proof.starts if start.of == X0))
        for proof in proofs
    )
