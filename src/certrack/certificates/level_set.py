"""Where the states of the continuous loop stay: the level set of a proven quadratic function.

A stage proves V' <= -alpha V + Delta wherever the assumptions hold, with 2 V = e^T P e + s N^2, N
the size of the estimates' errors. Let 2 V <= L at the start, L above 2 Delta/alpha. Then 2 V <= L
as long as the states have not left the region

    |x_i| <= X_i = sqrt(L (A^-1 P^-1 A^-T)_ii) + sum_j |(A^-1 B)_ij| Y_j

in which the assumptions hold: x = A^-1 (e + B Y), and a linear form a^T e is at most
sqrt(L a^T P^-1 a). Taken with an L that is a little larger, the region has them strictly inside, so
there is no first time of leaving. Every other proof of the same loop may then rest on the region.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import exact_float, fraction, rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, failed_condition, from_text, root_up
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.region import StateBounds, in_region
from certrack.certificates.start import starting_energy
from certrack.certificates.tube import MAX_BOX_CORNERS, starts_of
from certrack.core.errors import InputError
from certrack.core.once import once
from certrack.references.base import bound_of
from certrack.systems.system import System

#: The level is taken so much larger, relatively: what is inside is strictly inside the region.
LEVEL_SLACK = rational("1e-9")

#: Bisections of the largest box of starts.
BOX_BISECTIONS = 12

#: It is not looked for beyond this, in the states' units.
LARGEST_START_BOX = 1e6


@dataclass(frozen=True)
class KeptRegion:
    """The stage whose level set keeps the states where the premises hold.

    Attributes
    ----------
    stage : Proof
        Of e_1 or of e_n, in all errors.
    """

    stage: Proof


@dataclass(frozen=True)
class _LevelSet:
    """What of a stage does not depend on the start, exact."""

    problem: ErrorProblem
    P: np.ndarray
    floor: Any
    spread: np.ndarray
    of_reference: np.ndarray


@once
def _level_set(system: System, region: KeptRegion) -> _LevelSet | None:
    """The stage, with every condition of it checked; None where nothing follows from it."""
    try:
        problem = error_problem(system, rational)
        coordinates = error_coordinates(system, rational)
        Y = [
            exact_float(bound_of(system.reference, j)[0], rational)
            for j in range(coordinates.B.shape[1])
        ]
    except (NoCertificate, InputError):
        return None
    proof = region.stage
    if all(failed_condition(problem, proof, target) for target in (0, problem.n - 1)):
        return None
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    inverse = solve(coordinates.A, np.eye(problem.n, dtype=object))
    return _LevelSet(
        problem=problem,
        P=P,
        floor=from_text(proof.bound) ** 2,
        spread=np.einsum("ij,ji->i", inverse, solve(P, inverse.T)),
        of_reference=abs(inverse @ coordinates.B) @ np.array(Y, dtype=object),
    )


def region_of_level(
    system: System, region: KeptRegion, box: Sequence[tuple[float, float]] | None = None
) -> StateBounds | None:
    """What the states keep for all t >= 0 from x0, or from a box of starts.

    Parameters
    ----------
    system : System
    region : KeptRegion
        Checked here: every condition of its stage.
    box : n intervals, optional
        Set of initial plant states.

    Returns
    -------
    n Fractions or None
        None where the stage does not hold, where the reference has a transient part (the proof
        leaves it out) or a bound of it is not known, where the reference or the states at t = 0
        have no rule of ball arithmetic, or where the level is 0: nothing is strictly inside then.
    """
    if system.long_run is not system or (level_set := _level_set(system, region)) is None:
        return None
    starts, known = starts_of(system, box)
    if not known:
        return None
    energy = starting_energy(system, level_set.problem, level_set.P, starts)
    level = max(level_set.floor, 2 * energy) * (1 + LEVEL_SLACK)
    if not level > 0:
        return None
    return tuple(
        fraction(from_text(root_up(level * share)) + offset)
        for share, offset in zip(level_set.spread, level_set.of_reference, strict=True)
    )


@once
def premises_from_x0(system: System, region: KeptRegion | None) -> tuple[Premise, ...]:
    """What a certificate of the continuous loop rests on, in a region where that is kept.

    Parameters
    ----------
    system : System
    region : KeptRegion or None
        None where the premises must hold everywhere.
    """
    everywhere = premises(system)
    if region is None:
        return everywhere
    return in_region(system, everywhere, region_of_level(system, region), formulas=True)


def kept_region(system: System, stages: Sequence[Proof]) -> KeptRegion | None:
    """The stage with the largest box of starts whose region repairs what is contradicted.

    None where nothing is contradicted, or no stage keeps the states where the premises hold.

    Parameters
    ----------
    system : System
    stages : of e_1 or of e_n, in all errors
    """
    if not contradicted(premises(system)):
        return None
    candidates = map(KeptRegion, stages)
    held = [region for region in candidates if not contradicted(premises_from_x0(system, region))]
    return max(held, key=lambda region: largest_box(system, region), default=None)


@once
def largest_box(system: System, region: KeptRegion) -> float:
    """The largest r found for which the same is proven from every |x_i - x0_i| <= r.

    0 if none is, if a bound of w is only checked on samples there, if the plant has too many states
    for the corners of a box, or if the truth has states of its own: x0 is in these.
    """
    if 2**system.plant.n > MAX_BOX_CORNERS or system.truth.states:
        return 0.0
    everywhere = premises(system)

    def holds(r: float) -> bool:
        box = [
            (math.nextafter(v - r, -math.inf), math.nextafter(v + r, math.inf))
            for v in system.settings.x0
        ]
        bounds = region_of_level(system, region, box)
        return not contradicted(in_region(system, everywhere, bounds, formulas=True, sampled=False))

    if not holds(0.0):
        return 0.0
    high = 1.0
    while holds(high) and high < LARGEST_START_BOX:
        high *= 2
    low = high / 2 if high > 1 else 0.0
    for _ in range(BOX_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
