"""Members of a system under held controls, and the slopes of what they end with.

The classical Runge-Kutta method with the same steps for all members and its exact derivative, the
discrete adjoint: in compiled C (``controlled.c``), or in NumPy where there is no compiler.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.kinks import derivative
from certrack.core.lowering import numpy_callable
from certrack.core.memo import remembered
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.native import compiled_library
from certrack.integrators.many.native_source import c_enum, c_function, with_elementary
from certrack.integrators.registers import LANES, whole_registers


@dataclass(frozen=True)
class ControlledFlow:
    """Rates of a system without time, as formulas.

    Attributes
    ----------
    states, controls, parameters : symbols
        Controls are held in every step, parameters for ever.
    rates : formulas
    """

    states: tuple[sympy.Symbol, ...]
    controls: tuple[sympy.Symbol, ...]
    parameters: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]

    @property
    def costates(self) -> tuple[sympy.Symbol, ...]:
        """Weights of the rates in the formulas of :meth:`pullback`."""
        return tuple(sympy.Symbol(f"costate_{i}", real=True) for i in range(len(self.states)))

    def pullback(self) -> list[sympy.Expr]:
        """Derivatives of the weighted sum of the rates, by states, controls and parameters."""
        return [
            sympy.Add(
                *(g * derivative(f, by) for g, f in zip(self.costates, self.rates, strict=True))
            )
            for by in (*self.states, *self.controls, *self.parameters)
        ]


class InputSlopes(NamedTuple):
    """Derivatives of an output at the end.

    Attributes
    ----------
    start : (S, N) array
    controls : (K, C, N) array
        Of the value that is held in each step.
    parameters : (P, N) array
    """

    start: Array
    controls: Array
    parameters: Array


class ControlledRuns:
    """A flow that is integrated.

    Parameters
    ----------
    flow : ControlledFlow
    """

    def __init__(self, flow: ControlledFlow) -> None:
        self._flow = flow
        try:
            self._library: ctypes.CDLL | None = compiled_library(
                "controlled.c", _controlled_source(flow)
            )
        except MethodUnavailable:
            self._library = None

    def run(self, widths: Array, starts: Array, controls: Array, parameters: Array) -> Array:
        """The states (K + 1, S, N) of members at the ends of all steps.

        Parameters
        ----------
        widths : (K,) array
        starts : (S, N) array
        controls : (K, C, N) array
        parameters : (P, N) array
        """
        return self._integrate(widths, starts, controls, parameters, None)[0]

    def run_back(
        self, widths: Array, starts: Array, controls: Array, parameters: Array, output: Array
    ) -> tuple[Array, InputSlopes]:
        """The states, and the slopes of ``output`` (S, N) times the states at the end.

        Weights (S,) are those of every member.
        """
        states, slopes = self._integrate(widths, starts, controls, parameters, output)
        assert slopes is not None
        return states, slopes

    def _integrate(
        self, widths: Array, starts: Array, controls: Array, parameters: Array, output: Array | None
    ) -> tuple[Array, InputSlopes | None]:
        if self._library is None:
            runs = _NumpyRuns(self._flow)
            states = runs.forward(widths, starts, controls, parameters)
            return states, None if output is None else runs.backward(
                widths, states, controls, parameters, output
            )
        count = starts.shape[1]
        filled, parts = whole_registers(count), []
        for first in range(0, count, LANES):
            lanes = filled[first : first + LANES]
            arguments = starts[:, lanes], controls[:, :, lanes], parameters[:, lanes]
            weights = None if output is None else _of_members(output, count)[:, lanes]
            parts.append(self._lanes(widths, *arguments, weights))
        parts_joined = [
            np.concatenate(part, axis=-1)[..., :count] for part in zip(*parts, strict=True)
        ]
        return parts_joined[0], None if output is None else InputSlopes(*parts_joined[1:])

    def _lanes(
        self, widths: Array, starts: Array, controls: Array, parameters: Array, output: Array | None
    ) -> tuple[Array, ...]:
        flow, steps = self._flow, len(widths)
        inputs = [
            np.ascontiguousarray(a, dtype=float) for a in (widths, starts, controls, parameters)
        ]
        states = np.empty((steps + 1, len(flow.states), LANES))
        slopes, back = list[Array](), list[Array]()
        if output is not None:
            slopes = [np.empty(a.shape) for a in inputs[1:]]
            back = [np.ascontiguousarray(output)]
        places = [a.ctypes.data for a in (*inputs, states, *back, *slopes)]
        task = _Task(steps, *places)  # the rest is NULL
        assert self._library is not None
        self._library.integrate(ctypes.byref(task))
        return states, *slopes


def _of_members(output: Array, count: int) -> Array:
    """Weights (S, N) from those of every member, or from (S, N)."""
    weights = np.asarray(output, dtype=float)
    return weights if weights.ndim == 2 else np.repeat(weights[:, None], count, axis=1)


class _Task(ctypes.Structure):
    """``Task`` of controlled.c."""

    _fields_ = [
        ("steps", ctypes.c_int64),
        *(
            (name, ctypes.c_void_p)
            for name in (
                *("widths", "starts", "controls", "parameters", "states", "costate"),
                *("by_start", "by_controls", "by_parameters"),
            )
        ),
    ]


@remembered
def _controlled_source(flow: ControlledFlow) -> str:
    """The generated part of controlled.c."""
    names: dict[sympy.Symbol, str] = {}
    groups = (
        *(("x", flow.states), ("c", flow.controls), ("p", flow.parameters)),
        ("g", flow.costates),
    )
    for letter, symbols in groups:
        names |= {symbol: f"{letter}[{i}]" for i, symbol in enumerate(symbols)}
    targets = [
        f"{to}[{i}]"
        for to, symbols in (("ox", flow.states), ("oc", flow.controls), ("op", flow.parameters))
        for i in range(len(symbols))
    ]
    sizes = {
        "STATES": len(flow.states),
        "CONTROLS": len(flow.controls),
        "PARAMETERS": len(flow.parameters),
    }
    rates = [(f"k[{i}]", rate) for i, rate in enumerate(flow.rates)]
    back = list(zip(targets, flow.pullback(), strict=True))
    arguments = "const V *x, const V *c, const V *p"
    return with_elementary(
        [
            c_enum(sizes),
            c_function("rates", f"{arguments}, V *k", rates, names),
            c_function("pullback", f"{arguments}, const V *g, V *ox, V *oc, V *op", back, names),
        ]
    )


class _NumpyRuns:
    """The same in NumPy, all members at once."""

    def __init__(self, flow: ControlledFlow) -> None:
        self._sizes = [len(v) for v in (flow.states, flow.controls, flow.parameters)]
        arguments: Sequence[Sequence[sympy.Symbol]] = (flow.states, flow.controls, flow.parameters)
        self._rates = numpy_callable(arguments, list(flow.rates))
        self._pullback = numpy_callable([*arguments, flow.costates], flow.pullback())

    def _stages(self, h: float, x: Array, c: Array, p: Array) -> tuple[list[Array], list[Array]]:
        places, rates = [x], [self._values(self._rates(x, c, p), x)]
        for part in (0.5 * h, 0.5 * h, h):
            places.append(x + part * rates[-1])
            rates.append(self._values(self._rates(places[-1], c, p), x))
        return places, rates

    @staticmethod
    def _values(rows: Sequence[Array], x: Array) -> Array:
        return np.array([np.broadcast_to(row, x.shape[1:]) for row in rows])

    def forward(self, widths: Array, starts: Array, controls: Array, parameters: Array) -> Array:
        states = [starts]
        with np.errstate(all="ignore"):
            for h, c in zip(widths.tolist(), controls, strict=True):
                _, k = self._stages(h, states[-1], c, parameters)
                states.append(states[-1] + h / 6 * (k[0] + 2 * (k[1] + k[2]) + k[3]))
        return np.array(states)

    def backward(
        self, widths: Array, states: Array, controls: Array, p: Array, output: Array
    ) -> InputSlopes:
        count = states.shape[2]
        costate = _of_members(output, count)
        by_controls, by_parameters = np.zeros(controls.shape), np.zeros(p.shape)
        ends = np.cumsum(self._sizes)[:-1]
        with np.errstate(all="ignore"):
            for n in range(len(widths) - 1, -1, -1):
                h, c = float(widths[n]), controls[n]
                places, _ = self._stages(h, states[n], c, p)
                total, back = costate, np.zeros_like(costate)
                for i, (weight, part) in enumerate(
                    ((h / 6, 0.0), (h / 3, h), (h / 3, 0.5 * h), (h / 6, 0.5 * h))
                ):
                    g = weight * costate + part * back
                    rows = self._values(self._pullback(places[3 - i], c, p, g), costate)
                    back, of_c, of_p = np.split(rows, ends)
                    total = total + back
                    by_controls[n] += of_c
                    by_parameters += of_p
                costate = total
        return InputSlopes(costate, by_controls, by_parameters)
