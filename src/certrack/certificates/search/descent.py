"""A quasi-Newton descent for the small smooth functions of a certificate.

BFGS with a start of the inverse Hessian that the function supplies, and a line search that only
steps back: where the function does not exist it is infinite, which SciPy's line searches do not
take, and a step costs here a few microseconds, not a tenth of a millisecond.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

#: A step lowers the function by at least this part of what its slope promises, or is shortened.
DESCENT_SHARE = 1e-4

#: By how much a step is shortened at a time, and when it is given up.
SHORTER, SHORTEST = 0.4, 1e-8

#: Longest step in any variable: they are logarithms.
LONGEST_DESCENT_STEP = 1.5

#: Steps of a descent that may be taken at most.
MAX_DESCENT_STEPS = 100


class Derivatives(Protocol):
    """What the function gives at a point where it exists."""

    @property
    def value(self) -> float:
        """The function."""

    @property
    def gradient(self) -> np.ndarray:
        """Its gradient."""

    @property
    def curvature(self) -> np.ndarray:
        """Positive, about the diagonal of its Hessian."""


@dataclass(frozen=True)
class Lowest:
    """Where a descent ended.

    Attributes
    ----------
    x : array
    point : Derivatives
        There.
    inverse : array
        About the inverse Hessian.
    left : float
        By how much the next step promises to lower the function.
    """

    x: np.ndarray
    point: Derivatives
    inverse: np.ndarray
    left: float


def quasi_newton(
    function: Callable[[np.ndarray], Derivatives | None],
    x: np.ndarray,
    accuracy: float,
    inverse: np.ndarray | None = None,
    shortest: float = SHORTEST,
) -> Lowest | None:
    """The lowest point that is reached; None if the function does not exist at the start.

    Parameters
    ----------
    function : callable
        None where it does not exist.
    x : array
        Where to begin.
    accuracy : float
        It ends where a step promises to lower the function by less.
    inverse : array, optional
        About the inverse Hessian.
    shortest : float
        It ends where so small a part of a step would have to be taken, as at a kink.
    """
    here = function(x)
    if here is None:
        return None
    B, slope = np.diag(1 / here.curvature) if inverse is None else inverse, -math.inf
    for _ in range(MAX_DESCENT_STEPS):
        step = -B @ here.gradient
        slope = float(here.gradient @ step)
        if not slope < 0:
            B = np.diag(1 / here.curvature)
            step = -B @ here.gradient
            slope = float(here.gradient @ step)
        if not -slope > 2 * accuracy:
            break
        length = min(1.0, LONGEST_DESCENT_STEP / float(np.abs(step).max()))
        while True:
            there = function(x + length * step)
            if there is not None and there.value <= here.value + DESCENT_SHARE * length * slope:
                break
            length *= SHORTER
            if length < shortest:
                return Lowest(x, here, B, -slope / 2)
        moved, turned = length * step, there.gradient - here.gradient
        x, here = x + moved, there
        B = _updated(B, moved, turned)
    return Lowest(x, here, B, -slope / 2)


def _updated(B: np.ndarray, moved: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """The inverse Hessian after a step, if its curvature is positive."""
    along = float(moved @ turned)
    if not along > math.sqrt(np.finfo(float).eps) * float(np.abs(moved).max()) * float(
        np.abs(turned).max()
    ):
        return B
    through = B @ turned
    outer = np.outer(through, moved)
    updated: np.ndarray = (
        B
        + np.outer(moved, moved) * ((1 + float(turned @ through) / along) / along)
        - (outer + outer.T) / along
    )
    return updated
