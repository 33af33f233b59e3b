"""The two maps of a sampled loop, at a sample and between two events, for many members at once.

heyoka compiles both to vector code; without it NumPy evaluates the same formulas. Between samples
the plant takes steps of the pair of Dormand and Prince (order 5, error control of order 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from threading import local
from typing import Any, Protocol

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.expressions import TIME
from certrack.core.heyoka import quiet_heyoka
from certrack.core.lowering import numpy_callable, rows, to_heyoka
from certrack.core.select import STEP_BEGIN, STEP_LENGTH, larger, magnitude
from certrack.integrators.pairs import DORMAND_PRINCE, heyoka_step, heyoka_sum, numpy_step
from certrack.integrators.registers import LANES
from certrack.loops.controller import COMMAND, resolved
from certrack.loops.plant import INPUT
from certrack.loops.sampled import AREA, SIDES, SQUARE, SampledLoop

#: A number for all members, or one for each.
Scalar = float | np.ndarray

#: The pair of all maps.
PAIR = DORMAND_PRINCE


class SampledMaps(Protocol):
    """Both maps; arrays have a column per member, p a row per parameter, then per piece symbol."""

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        """Evaluate the law at a sample.

        Parameters
        ----------
        t : float or (N,) array, s
        measured : (n, N) array
            What the sensors give.
        states : (r, N) array
            States of the controller.
        p : (P, N) array

        Returns
        -------
        u : (N,) array
            Commanded inputs.
        states : (r, N) array
            At the next sample.
        """

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        """Integrate the plant from t to t + h at a constant input.

        Parameters
        ----------
        t, h : float or (N,) array, s
        allowed : float or (N,) array
            Error that is allowed, relative and absolute.
        x : (n, N) array
        u : (N,) array
        totals : (T, N) array
        p : (P, N) array

        Returns
        -------
        x, totals : arrays
            At t + h.
        error : (N,) array
            Estimated error of the states and of the integral of e_1, over the allowed one: the
            step is accurate enough up to 1.
        """


class NumpyMaps:
    """Maps evaluated by NumPy."""

    def __init__(self, loop: SampledLoop) -> None:
        p = [*loop.parameters, *loop.pieces]
        plant, controller = loop.plant, loop.controller
        command, update = resolved(controller)
        self._control = numpy_callable(
            [TIME, controller.measured, controller.states, p], [command, *update]
        )
        self._rates = numpy_callable(
            [TIME, plant.states, INPUT, p], [*plant.rates, loop.e_1, loop.slope]
        )
        names = [name for name, _ in loop.totals]
        self._totals = numpy_callable(
            [STEP_BEGIN, STEP_LENGTH, SIDES, SQUARE, AREA, INPUT, names, p],
            [formula for _, formula in loop.totals],
        )
        self._n = plant.n

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            values = rows(self._control(t, measured, states, p), measured.shape[1])
        return values[0], values[1:]

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        n, count = self._n, x.shape[1]
        with np.errstate(all="ignore"):
            slopes, end = numpy_step(
                PAIR, h, x, lambda node, inner: rows(self._rates(t + node * h, inner, u, p), count)
            )
            e = slopes[:, n]
            sides = np.array([e[0], e[-1], slopes[0, n + 1], slopes[-1, n + 1]])
            square, area = h * (PAIR.B @ e[:-1] ** 2), h * (PAIR.B @ e[:-1])
            after = rows(self._totals(t, h, sides, square, area, u, totals, p), count)
            # of the states and of the integral of e_1: a reference may be faster than the plant
            error = h * np.einsum("s,sij->ij", PAIR.errors[0], slopes[:, : n + 1])
            sizes = np.maximum(np.abs([*x, e[0]]), np.abs([*end, e[-1]]))
            scaled = error / (allowed * (1.0 + sizes))
            return end, after, np.sqrt((scaled**2).sum(axis=0) / n)


class HeyokaMaps:
    """Maps compiled by heyoka.

    Parameters
    ----------
    loop : SampledLoop
    vector : bool
        For a multiple of :data:`LANES` members; otherwise for one.
    """

    #: Rows of the runtime parameters before those of the loop: time, step, allowed error.
    STEP_ROWS = 3

    def __init__(self, loop: SampledLoop, *, vector: bool) -> None:
        hy = quiet_heyoka()
        self._loop = loop
        self._known = {
            name: hy.par[self.STEP_ROWS + i]
            for i, name in enumerate((*loop.parameters, *loop.pieces))
        }
        options = {"batch_size": LANES, "force_avx512": True} if vector else {}
        self._control = hy.cfunc(*self._control_formulas(hy), **options)
        self._step = hy.cfunc(*self._step_formulas(hy), **options)
        self._of_thread = local()  # a thread's own, so that threads may share the maps

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        values = self._call(self._control, (t, 0.0, 0.0), (measured, states), p)
        return values[0], values[1:]

    def step(
        self, t: Scalar, h: Scalar, allowed: Scalar, x: Array, u: Array, totals: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        values = self._call(self._step, (t, h, allowed), (x, u[None], totals), p)
        return values[: len(x)], values[len(x) : -1], values[-1]

    def _call(self, function: Any, step: Sequence[Any], inputs: Sequence[Array], p: Array) -> Array:
        count = inputs[0].shape[1]
        key = (function.nparams, count)
        tables: dict[Any, Array] = self._of_thread.__dict__
        if key not in tables:
            tables[key] = np.empty(key)
        table = tables[key]
        for row, value in zip(table, step, strict=False):
            row[:] = value
        table[self.STEP_ROWS :] = p[: max(0, function.nparams - self.STEP_ROWS)]
        values: Array = function(np.ascontiguousarray(np.concatenate(inputs)), pars=table)
        return values

    def _control_formulas(self, hy: Any) -> tuple[list[Any], list[Any]]:
        controller = self._loop.controller
        names = [*controller.measured, *controller.states]
        inputs = [hy.expression(f"in_{i}") for i in range(len(names))]
        known = self._known | {TIME: hy.par[0]} | dict(zip(names, inputs, strict=True))
        for name, formula in controller.steps:
            (known[name],) = to_heyoka([formula], known, kinks=True)
        update = to_heyoka(controller.update, known, kinks=True)
        return [known[COMMAND], *update], inputs

    def _step_formulas(self, hy: Any) -> tuple[list[Any], list[Any]]:
        loop, plant = self._loop, self._loop.plant
        names = [*plant.states, INPUT, *(name for name, _ in loop.totals)]
        inputs = [hy.expression(f"in_{i}") for i in range(len(names))]
        t, h, allowed = hy.par[0], hy.par[1], hy.par[2]
        known = self._known | dict(zip(names, inputs, strict=True))
        x, n = inputs[: plant.n], plant.n

        def rates(node: float, states: Sequence[Any]) -> list[Any]:
            when = {TIME: t + float(node) * h} if node else {TIME: t}
            at = known | dict(zip(plant.states, states, strict=True)) | when
            return to_heyoka([*plant.rates, loop.e_1, loop.slope], at, kinks=True)

        slopes, end = heyoka_step(PAIR, h, x, rates(0.0, x), rates)
        first, last = slopes[0], slopes[-1]
        e = [k[n] for k in slopes[:-1]]
        place = known | {STEP_BEGIN: t, STEP_LENGTH: h, AREA: heyoka_sum(h, PAIR.B, e)}
        place |= {SQUARE: heyoka_sum(h, PAIR.B, [value * value for value in e])}
        place |= zip(SIDES, (e[0], last[n], first[n + 1], last[n + 1]), strict=True)
        totals = to_heyoka([formula for _, formula in loop.totals], place, kinks=True)
        error = self._error(hy, [*x, e[0]], [*end, last[n]], slopes, h, allowed)
        return [*end, *totals, error], inputs

    def _error(
        self,
        hy: Any,
        x: Sequence[Any],
        end: Sequence[Any],
        slopes: Sequence[Sequence[Any]],
        h: Any,
        allowed: Any,
    ) -> Any:
        """Norm of the estimated errors over allowed (1 + |x|), per root of the number of states.

        The errors are those of the states and, last, of the integral of e_1: a reference may be
        faster than the plant.
        """
        a, b = sympy.symbols("a b", real=True)
        squares = []
        for j, (begin, after) in enumerate(zip(x, end, strict=True)):
            ends = {a: begin, b: after}
            (size,) = to_heyoka([larger(magnitude(a), magnitude(b))], ends, kinks=True)
            error = heyoka_sum(h, PAIR.errors[0], [k[j] for k in slopes])
            scaled = error / (allowed * (1.0 + size))
            squares.append(scaled * scaled)
        return hy.sqrt(hy.sum(squares) * (1.0 / (len(squares) - 1)))
