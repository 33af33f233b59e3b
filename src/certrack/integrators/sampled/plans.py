"""Plans of the input within its limits, as the compiled loops take them (``plan.h``)."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

from certrack.core.arrays import Array


class PlanStruct(ctypes.Structure):
    """``Plan`` of plan.h."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("spread", "offsets", "effect")),
        *((name, ctypes.c_double) for name in ("low", "high", "tolerance")),
    ]


@dataclass(frozen=True)
class LimitedPlans:
    """Plans of the input at all samples of a run, and their limits: see ``plan.h``.

    With the input u that the law asks for without limits, and the states x that it takes, the
    moves of the plan at sample i are u + spread x + offsets[i] + L w, where w = 0 costs least.

    Attributes
    ----------
    limits : (low, high)
    spread : (M, n) array
    offsets : (samples, M) array
    effect : (M, M) array, all of them contiguous
        L, lower triangular with ones on its diagonal.
    tolerance : float
        By which a move may leave the limits.
    """

    limits: tuple[float, float]
    spread: Array
    offsets: Array
    effect: Array
    tolerance: float

    def struct(self) -> PlanStruct:
        """For C, as long as this object lives."""
        tables = (self.spread, self.offsets, self.effect)
        return PlanStruct(*(table.ctypes.data for table in tables), *self.limits, self.tolerance)
