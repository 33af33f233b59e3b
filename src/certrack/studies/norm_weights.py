"""Weights of the states in the norm of Assumption 1, proposed where their sizes differ badly.

||x|| adds what is large and what is small in the file's units. Where x_1 is y_d and w is zero, the
states follow: x_{i+1} = (x_i' - sum_j b_ij x_j)/g_i, so |x_j| <= X_j = sum_i |C_ji| Y_i. With
S_jj = X_1/X_j each state is weighed by its own size. That is another assumption on w, so it is
proposed and never applied.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from certrack.certificates.certify import Certificates
from certrack.certificates.methods import certify_semidefinite
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.scope import has_ranges
from certrack.core.errors import InputError
from certrack.core.rounding import in_digits
from certrack.systems.system import System

#: Sizes that differ by less than this need no weights.
SMALLEST_RATIO = 100.0

#: A bound must fall by this part to be worth a word.
WORTH_A_WORD = 0.05

#: Digits of a weight.
SIZE_DIGITS = 3


@dataclass(frozen=True)
class NormWeights:
    """What is proposed.

    Attributes
    ----------
    sizes : X_1 ... X_n
    S : n numbers
        As ``plant.uncertainty.S`` takes them.
    """

    sizes: tuple[float, ...]
    S: tuple[float, ...]

    def text(self, states: tuple[str, ...]) -> str:
        """The sizes, and what may be stated."""
        sizes = ", ".join(f"{x} {v:.3g}" for x, v in zip(states, self.sizes, strict=True))
        return f"along the reference the states are up to {sizes}, and gamma ||x|| adds them alike"

    @property
    def remedy(self) -> str:
        """The line of the file, and what it means."""
        return (
            f"state S = [{', '.join(f'{v:g}' for v in self.S)}] in [plant.uncertainty] if "
            "|w_k| <= gamma_k ||S x|| + beta_k holds: another assumption, so nothing applies it "
            "by itself"
        )


def proposed_weights(system: System) -> NormWeights | None:
    """Weights for a file that states gamma and no S, if its states differ badly in size."""
    u = system.plant.uncertainty
    if u.S is not None or not any(t * g for t, g in zip(u.tau, u.gamma, strict=True)):
        return None
    plant = system.plant
    try:
        Y = np.array(system.reference.bounds(plant.n - 1).values, dtype=float)
    except InputError:
        return None
    C = np.eye(1, plant.n)  # x_1 = y_d; the columns are its derivatives
    for i, g in enumerate(plant.g):
        rate = np.concatenate([[0.0], C[i, :-1]])
        C = np.vstack([C, (rate - plant.b[i, : i + 1] @ C) / g])
    sizes = np.abs(C) @ Y
    if not (np.isfinite(sizes).all() and (sizes > 0).all()):
        return None
    if sizes.max() < SMALLEST_RATIO * sizes.min():
        return None
    S = tuple(in_digits(sizes[0] / size, SIZE_DIGITS) for size in sizes)
    return NormWeights(tuple(sizes.tolist()), S)


def helpful_weights(system: System, certificates: Certificates) -> tuple[NormWeights, float] | None:
    """Weights with which the bound is clearly smaller, and that bound; None if there are none."""
    weights = proposed_weights(system)
    if weights is None:
        return None
    plant = system.plant
    stated = replace(plant, uncertainty=replace(plant.uncertainty, S=weights.S))
    weighed = system.replace(plant=stated)
    if has_ranges(system):
        before = min(certificates.vertices.bound, certificates.peak.bound)
        after = certify_ranges(weighed, "fast").best.bound
    else:
        before, after = certificates.semidefinite.bound, certify_semidefinite(weighed)[0].bound
    better = math.isfinite(after) and after < (1 - WORTH_A_WORD) * before
    return (weights, after) if better else None
