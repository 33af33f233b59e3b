"""Which integrator runs the adversaries side by side: heyoka's lanes, or else NumPy."""

from __future__ import annotations

from certrack.core.heyoka import has_heyoka
from certrack.integrators.many.numpy_batch import NumpyBatch
from certrack.integrators.many.taylor_batch import TaylorBatch
from certrack.loops.continuous import ClosedLoop


def batch_of(loop: ClosedLoop, tolerance: float) -> TaylorBatch | NumpyBatch:
    """An integrator of many members of a smooth closed loop.

    Parameters
    ----------
    loop : ClosedLoop
    tolerance : float
    """
    return TaylorBatch(loop, tolerance) if has_heyoka() else NumpyBatch(loop, tolerance)
