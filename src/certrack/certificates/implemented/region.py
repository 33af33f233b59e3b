"""Bounds of w that the truth keeps where the states are, but not far away.

From x0 the states are proven to stay within |x_i| <= X_i for all t >= 0. As long as they do, the
bounds of w need to hold there only; and as they hold there, the states never leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumption_1 import UncertainTerm, uncertain_terms
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.start_proof import X0
from certrack.certificates.premise import CHECKED, CONTRADICTED, PROVEN, Premise
from certrack.certificates.premises_of_truth import SEED
from certrack.certificates.sampling import RANDOM_POINTS, Points, random_points
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: End of the name of a premise that holds in a region only.
IN_REGION = " in the region"


def region_of_runs(proofs: Sequence[ImplementedProof]) -> tuple[Fraction, ...] | None:
    """Bounds of |x_1| ... |x_n| at all times from x0, over all delays; None if one has none."""
    peaks = [start.peaks[1:-2] for proof in proofs for start in proof.starts if start.of == X0]
    if not proofs or len(peaks) != len(proofs):
        return None
    exact = (max(map(from_text, column)) for column in zip(*peaks, strict=True))
    return tuple(Fraction(int(value.p), int(value.q)) for value in exact)


def in_region(
    system: System, premises: Sequence[Premise], proofs: Sequence[ImplementedProof]
) -> tuple[Premise, ...]:
    """The premises, those of terms that break their bounds far away only replaced.

    Parameters
    ----------
    system : System
    premises : of :func:`~certrack.certificates.premises_of_truth.premises`
    proofs : of the implemented loop
    """
    region, terms = region_of_runs(proofs), {term.name: term for term in uncertain_terms(system)}
    broken = [p.name for p in premises if p.status == CONTRADICTED and p.name in terms]
    if region is None or not broken:
        return tuple(premises)
    points = _within(random_points(system.plant.n, system.settings.duration, SEED), region)
    replaced = {name: _premise(system, terms[name], region, points) for name in broken}
    return tuple(replaced.get(p.name) or p for p in premises)


def is_only_in_region(rests_on: Sequence[Premise]) -> bool:
    """Whether a premise holds in a region only: then nothing is claimed but from x0."""
    return any(premise.name.endswith(IN_REGION) for premise in rests_on)


def without_polytopes(proofs: Sequence[ImplementedProof]) -> tuple[ImplementedProof, ...]:
    """The proofs without what they say of starts elsewhere than at x0."""
    return tuple(
        replace(proof, starts=tuple(start for start in proof.starts if start.of == X0))
        for proof in proofs
    )


def _within(points: Points, region: Sequence[Fraction]) -> Points:
    """The points, those beyond the region moved to its edge on the ray to the origin."""
    sizes = np.array([float(r) for r in region])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(points.x == 0, np.inf, sizes / np.abs(points.x)).min(axis=0)
    return Points(points.t, points.x * np.minimum(room, 1.0) * (1 - 1e-12))


def _premise(
    system: System, term: UncertainTerm, region: Sequence[Fraction], points: Points
) -> Premise | None:
    """That a term keeps its bound in the region; None if it does not."""
    proven = term.proven_within(region)
    if not proven and term.violation(points, polished=False) is not None:
        return None
    status, how = PROVEN, ""
    if not proven:
        status, how = CHECKED, f"; no point beyond it among {RANDOM_POINTS} random ones there"
    detail = f"tau |{term.name}| <= {term.allowance} holds while {while_within(system, region)}"
    name = f"{term.name}{IN_REGION}"
    return Premise(name, status, f"{detail}, which the states keep from simulation.x0{how}")


def while_within(system: System, region: Sequence[Fraction]) -> str:
    """A region in words."""
    pairs = zip(system.plant.states, region, strict=True)
    return ", ".join(f"|{x}| <= {rounded_up(float_up(rational(r)), 4)}" for x, r in pairs)
