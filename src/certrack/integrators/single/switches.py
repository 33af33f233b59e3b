"""Kinks of the state: keep every switch s = sign(f) right while a Taylor integrator runs.

See :mod:`certrack.core.lowering` for how abs, sign, min and max become switches. heyoka locates
f = 0 as an event; here the switches are set at the start and after events, and the finished run is
checked: a switch that disagrees with its function in the middle of a step means a missed event.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows

#: How far ahead a switch looks for the sign of its function, s, and as a part of the time: beyond
#: what rounding blurs; the nearer look is decisive.
FAR_AHEAD, NEAR_AHEAD = 1e-6, 1e-10

#: Steps of a Runge-Kutta method that look as far ahead from a state at rest: each adds four orders.
STEPS_AHEAD = 8

#: A function this small, relative to the states, has no sign: rounding.
ZERO = 1e-9

#: After an event, its function is not looked at for this long, s: rounding would fire it again,
#: and from rest on a kink heyoka would deduce zero. What is missed by it is found by the check.
COOLDOWN = 1e-9


class Switches:
    """The switches of one compiled loop.

    Parameters
    ----------
    states, parameters : symbols
        Symbols of the loop; `parameters` ends with the switch symbols.
    rates : formulas
        Smooth right-hand sides.
    functions : formulas
        What each switch is the sign of.
    """

    def __init__(
        self,
        states: Sequence[sympy.Symbol],
        parameters: Sequence[sympy.Symbol],
        rates: Sequence[sympy.Expr],
        functions: Sequence[sympy.Expr],
    ) -> None:
        self.count = len(functions)
        self.first = len(parameters) - self.count
        arguments = [TIME, states, parameters]
        self._functions = numpy_callable(arguments, functions)
        self._rates = numpy_callable(arguments, rates)
        self._used: list[np.ndarray] = []

    def events(self, hy: Any, functions: Sequence[Any]) -> list[Any]:
        """Terminal events that flip one switch each and let the integration go on."""
        return [
            hy.t_event(function, callback=_Flip(self.first + k), cooldown=COOLDOWN)
            for k, function in enumerate(functions)
        ]

    def begin(self) -> None:
        """Clear the record of the run before."""
        self._used = []

    def record(self, integrator: Any) -> None:
        """Record the parameters that the next step uses."""
        self._used.append(integrator.pars.copy())

    def set(self, integrator: Any, skip: int = -1) -> None:
        """Set every switch to the sign its function has a moment from now.

        Looking ahead a moment settles functions that are zero now, and those that cross zero at
        the same time as number `skip`, whose event has just set it.
        """
        t, state, pars = integrator.time, integrator.state, integrator.pars
        for _ in range(self.count):  # later functions may contain earlier switches
            before = pars[self.first :].copy()
            for moment in (FAR_AHEAD, NEAR_AHEAD * max(1.0, abs(t))):  # the later one decides
                with np.errstate(all="ignore"):
                    ahead = state + moment * np.array(self._rates(t, state, pars), dtype=float)
                    values = self._functions(t + moment, ahead, pars)
                for k, value in enumerate(values):
                    if k != skip and value:
                        pars[self.first + k] = 1.0 if value > 0 else -1.0
            if np.array_equal(before, pars[self.first :]):
                break
        if not pars[self.first :].all():
            self._set_at_rest(t, state, pars)

    def _set_at_rest(self, t: float, state: np.ndarray, pars: np.ndarray) -> None:
        """Set switches whose functions are zero, and so are their rates: as of a chain at rest.

        Steps of the classical Runge-Kutta method tell where they go, however small the values: at
        rest they are exact zeros.
        """
        h = FAR_AHEAD / STEPS_AHEAD
        with np.errstate(all="ignore"):
            for _ in range(STEPS_AHEAD):
                k1 = np.array(self._rates(t, state, pars), dtype=float)
                k2 = np.array(self._rates(t + h / 2, state + h / 2 * k1, pars), dtype=float)
                k3 = np.array(self._rates(t + h / 2, state + h / 2 * k2, pars), dtype=float)
                k4 = np.array(self._rates(t + h, state + h * k3, pars), dtype=float)
                t, state = t + h, state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            for k, value in enumerate(self._functions(t, state, pars)):
                if value and not pars[self.first + k]:
                    pars[self.first + k] = 1.0 if value > 0 else -1.0

    def held(self, t: np.ndarray, states: np.ndarray, pars: np.ndarray) -> np.ndarray:
        """What is negative where a switch disagrees with its function, (count, N)."""
        with np.errstate(all="ignore"):
            values = rows(self._functions(t, states, pars), len(t))
        return values * pars[self.first :, None]

    def missed(self, t: np.ndarray, states: np.ndarray) -> bool:
        """Whether a switch disagrees with its function at the middle (t, states) of some step.

        So does one that was never set, where its function is not zero.
        """
        pars = np.array(self._used[: len(t)]).T
        with np.errstate(all="ignore"):
            values = np.array(
                [np.broadcast_to(f, t.shape) for f in self._functions(t, states, pars)]
            )
        used = pars[self.first :]
        wrong = (values * used < 0) | (used == 0)
        return bool((wrong & (np.abs(values) > ZERO * (1 + np.abs(states).max()))).any())


class _Flip:
    """Event callback: set a switch to the direction in which its function crosses zero."""

    def __init__(self, index: int) -> None:
        self.index = index

    def __call__(self, integrator: Any, direction: int) -> bool:
        if direction:
            integrator.pars[self.index] = float(direction)
        return True
