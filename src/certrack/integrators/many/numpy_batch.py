"""Many runs of one closed loop side by side in NumPy, where heyoka is missing.

All members take the same steps of the pair of Dormand and Prince, as long as the most difficult of
them allows; between the ends of a step they are cubics through value and slope. Made for the search
of the worst case, whose finds are replayed by the ordinary simulation: a few digits suffice.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.core.lowering import extract_switches, numpy_callable, rows
from certrack.core.scalar import NotOrdinary, ScalarFunction
from certrack.integrators.base import ESCAPING
from certrack.integrators.many.taylor_batch import MAX_STEPS
from certrack.integrators.pairs import DORMAND_PRINCE, numpy_step
from certrack.integrators.scalar_step import SCALAR_DORMAND_PRINCE
from certrack.loops.continuous import INTEGRALS, ClosedLoop

#: The shortest step, and the longest, as parts of the time that is integrated over: members that
#: need shorter ones have left all that is admitted.
LEAST_PART, FIRST_PART = 1e-9, 1e-4

#: See :mod:`certrack.integrators.sampled.run`.
STEP_SAFETY, LEAST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 4.0

#: Dense output is a cubic: a step is no longer than so many points of the grid.
POINTS_PER_STEP = 2


class NumpyBatch:
    """A closed loop for many members; the same interface as the Taylor method's eight lanes.

    Parameters
    ----------
    loop : ClosedLoop
        Without kinks and reference pieces.
    tolerance : float
    """

    def __init__(self, loop: ClosedLoop, tolerance: float) -> None:
        if extract_switches(loop.rates)[1] or loop.pieces:
            raise InputError("system", "must be smooth to be run side by side")
        self._rates = numpy_callable([TIME, loop.states, loop.parameters], loop.rates)
        self._one = ScalarFunction([TIME, loop.states, loop.parameters], loop.rates)
        self._tolerance = tolerance
        self._judged = len(loop.states) - len(INTEGRALS)

    def over_time(
        self,
        starts: np.ndarray,
        parameters: np.ndarray,
        times: np.ndarray,
        on_batch: Callable[[np.ndarray, np.ndarray, slice], None],
        max_steps: int = MAX_STEPS,
    ) -> None:
        """Integrate every member over `times` and hand its states to `on_batch`.

        Parameters
        ----------
        starts, parameters, times, on_batch, max_steps
            As :meth:`certrack.integrators.many.taylor_batch.TaylorBatch.over_time`; all members
            come in one batch.
        """
        count = starts.shape[1]
        states = np.full((len(times), *starts.shape), np.nan)
        states[0] = starts
        alive, escaped = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        t, end, x, shown = 0.0, float(times[-1]), starts.astype(float), 1
        h, longest = FIRST_PART * end, POINTS_PER_STEP * float(np.diff(times)[-1])
        for _ in range(max_steps):
            if shown == len(times) or not alive.any():
                break
            limit = longest if shown > 1 else end
            h = min(h, limit, end - t) if t + h < end * (1 - 1e-12) else end - t
            after, slopes, error = self._step(t, h, x[:, alive], parameters[:, alive])
            worst = float(np.nan_to_num(error, nan=np.inf).max())
            if worst > 1.0 and h > LEAST_PART * end:
                h *= max(LEAST_FACTOR, STEP_SAFETY * worst ** (-1 / DORMAND_PRINCE.order))
                continue
            lost = ~(error <= 1.0) | ~(np.abs(after).max(axis=0) < ESCAPING**2)
            k = np.searchsorted(times, t + h * (1 + 1e-12), side="right")
            for j in range(shown, k):
                states[j][:, alive] = _between((times[j] - t) / h, h, x[:, alive], after, slopes)
            shown = max(shown, int(k))
            x[:, alive] = after
            t += h
            if lost.any():
                members = np.flatnonzero(alive)[lost]
                escaped[members], alive[members] = True, False
            h *= (
                min(LARGEST_FACTOR, STEP_SAFETY * max(worst, 1e-9) ** (-1 / DORMAND_PRINCE.order))
                if worst < 1
                else 1
            )
        on_batch(states, escaped, slice(0, count))

    def _step(
        self, t: float, h: float, x: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States after a step, all slopes, and the error of every member over the allowed one."""
        count = x.shape[1]
        if count == 1:
            try:
                return self._scalar_step(t, h, x[:, 0].tolist(), p[:, 0].tolist())
            except NotOrdinary:
                pass
        with np.errstate(all="ignore"):
            slopes, end = numpy_step(
                DORMAND_PRINCE,
                h,
                x,
                lambda node, inner: rows(self._rates(t + node * h, inner, p), count),
            )
            error = h * np.einsum("s,sij->ij", DORMAND_PRINCE.errors[0], slopes)[: self._judged]
            size = 1.0 + np.maximum(np.abs(x), np.abs(end))[: self._judged]
            return end, slopes, np.abs(error / (self._tolerance * size)).max(axis=0)

    def _scalar_step(
        self, t: float, h: float, x: list[float], p: list[float]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same for one member, ten times as fast."""
        slopes, end = SCALAR_DORMAND_PRINCE.step(
            h, x, lambda c, inner: self._one(t + c * h, inner, p)
        )
        worst = max(
            abs(SCALAR_DORMAND_PRINCE.error_of(h, slopes, i)) / (1.0 + max(abs(x[i]), abs(end[i])))
            for i in range(self._judged)
        )
        error = np.array([worst / self._tolerance])
        return np.array(end)[:, None], np.array(slopes)[:, :, None], error


def _between(
    s: float, h: float, begin: np.ndarray, end: np.ndarray, slopes: np.ndarray
) -> np.ndarray:
    """The cubic with the values and slopes of both ends of a step, at its part s."""
    d0, d1, rise = h * slopes[0], h * slopes[-1], end - begin
    with np.errstate(all="ignore"):
        return begin + s * (d0 + s * (3 * rise - 2 * d0 - d1 + s * (d0 + d1 - 2 * rise)))
