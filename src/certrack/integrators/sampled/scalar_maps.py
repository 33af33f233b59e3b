"""The maps of a sampled loop for one member without heyoka, in plain Python numbers.

A step of one member costs NumPy as much as a step of a hundred: nearly all of it is calls.
"""

from __future__ import annotations

import math

import numpy as np

from certrack.core.arrays import Array
from certrack.core.expressions import TIME
from certrack.core.scalar import NotOrdinary, ScalarFunction
from certrack.core.select import STEP_BEGIN, STEP_LENGTH
from certrack.integrators.sampled.maps import NumpyMaps, Scalar
from certrack.integrators.scalar_step import SCALAR_DORMAND_PRINCE
from certrack.loops.controller import resolved
from certrack.loops.plant import INPUT
from certrack.loops.sampled import AREA, SIDES, SQUARE, SampledLoop


class ScalarMaps:
    """Maps for one column; whatever is not an ordinary number is left to NumPy.

    Parameters
    ----------
    loop : SampledLoop
    """

    def __init__(self, loop: SampledLoop) -> None:
        self._numpy = NumpyMaps(loop)
        p = [*loop.parameters, *loop.pieces]
        plant, controller = loop.plant, loop.controller
        command, update = resolved(controller)
        self._control = ScalarFunction(
            [TIME, controller.measured, controller.states, p], [command, *update]
        )
        self._rates = ScalarFunction([TIME, plant.states, INPUT, p], [*plant.rates, loop.e_1])
        self._slope = ScalarFunction([TIME, plant.states, INPUT, p], [loop.slope])
        names = [name for name, _ in loop.totals]
        self._totals = ScalarFunction(
            [STEP_BEGIN, STEP_LENGTH, SIDES, SQUARE, AREA, INPUT, names, p],
            [formula for _, formula in loop.totals],
        )
        self._n = plant.n

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        """See :class:`~certrack.integrators.sampled.maps.SampledMaps`."""
        try:
            u, *after = self._control(_number(t), *map(_numbers, (measured, states, p)))
        except NotOrdinary:
            return self._numpy.control(t, measured, states, p)
        return np.array([u]), np.array(after, dtype=float)[:, None]

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        """See :class:`~certrack.integrators.sampled.maps.SampledMaps`."""
        try:
            numbers = _numbers(x), float(u[0]), _numbers(totals), _numbers(p)
            end, after, error = self._step(_number(t), _number(h), _number(allowed), *numbers)
        except (NotOrdinary, OverflowError):
            return self._numpy.step(t, h, allowed, x, u, totals, p)
        return np.array(end)[:, None], np.array(after)[:, None], np.array([error])

    def _step(
        self,
        t: float,
        h: float,
        allowed: float,
        x: list[float],
        u: float,
        totals: list[float],
        p: list[float],
    ) -> tuple[list[float], list[float], float]:
        pair, n = SCALAR_DORMAND_PRINCE, self._n
        slopes, end = pair.step(h, x, lambda c, inner: self._rates(t + c * h, inner, u, p))
        e = [slope[n] for slope in slopes]
        (begin_slope,), (end_slope,) = self._slope(t, x, u, p), self._slope(t + h, end, u, p)
        square = h * sum(b * e[j] * e[j] for j, b in pair.end)
        area = h * sum(b * e[j] for j, b in pair.end)
        sides = [e[0], e[-1], begin_slope, end_slope]
        after = self._totals(t, h, sides, square, area, u, totals, p)
        total = 0.0
        for i, (a, b) in enumerate(zip([*x, e[0]], [*end, e[-1]], strict=True)):
            total += (pair.error_of(h, slopes, i) / (allowed * (1.0 + max(abs(a), abs(b))))) ** 2
        return end, after, math.sqrt(total / n)


def _number(value: Scalar) -> float:
    return float(value[0]) if isinstance(value, np.ndarray) else float(value)


def _numbers(column: Array) -> list[float]:
    values: list[float] = column[:, 0].tolist()
    if not math.isfinite(sum(values)):
        raise NotOrdinary("not a finite number")
    return values
