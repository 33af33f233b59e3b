"""The tail error of many adversaries by C that is compiled for their loop.

It follows |e_1| along every step, where the other integrators look at it on a grid.
"""

from __future__ import annotations

from collections.abc import Collection

import sympy

from certrack.core.arrays import Array
from certrack.core.kinks import along
from certrack.core.lowering import extract_switches
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.taylor_batch import MAX_STEPS
from certrack.integrators.peaks import LargestErrors, PeakFlow
from certrack.loops.continuous import INTEGRALS, ClosedLoop

#: A compiler takes as long as heyoka for so many adversaries: searches of fewer are not worth it.
WORTH_LANES = 2_000

#: Tolerance of a step: a search compares, and the replay has the usual one.
STEP_TOLERANCE = 1e-6


class AdversaryLanes:
    """A smooth closed loop against adversaries, compiled.

    Parameters
    ----------
    loop : ClosedLoop
    values : (P,) array
        Of its parameters.
    varying : symbols
        The parameters that differ between members.
    max_state : float
        A plant state beyond it has escaped.
    signal : formula, optional
        Whose largest magnitude is sought; e_1 if left out.

    Raises
    ------
    MethodUnavailable
        If no compiler can do it, or the loop is not smooth.
    """

    def __init__(
        self,
        loop: ClosedLoop,
        values: Array,
        varying: Collection[sympy.Symbol],
        max_state: float,
        signal: sympy.Expr | None = None,
    ) -> None:
        if loop.pieces or extract_switches(loop.rates)[1]:
            raise MethodUnavailable("the loop is not smooth")
        states = loop.states[: -len(INTEGRALS)]
        fixed = {
            name: sympy.Float(float(value))
            for name, value in zip(loop.parameters, values, strict=True)
            if name not in varying
        }
        signal = loop.e_1 if signal is None else signal
        *rates, signal = (f.xreplace(fixed) for f in (*loop.rates[: len(states)], signal))
        slope = along(signal, dict(zip(states, rates, strict=True)))
        parameters = tuple(name for name in loop.parameters if name in varying)
        self._rows = [loop.parameters.index(name) for name in parameters]
        flow = PeakFlow(states, tuple(rates), parameters, signal, slope, loop.n)
        self._largest = LargestErrors(flow, STEP_TOLERANCE, max_state, MAX_STEPS)

    def tail_errors(
        self, starts: Array, parameters: Array, begin: float, end: float
    ) -> tuple[Array, Array]:
        """Largest magnitude of every member from `begin` to `end`, and how it ended.

        Parameters
        ----------
        starts : (S, N) array
            Plant and controller states.
        parameters : (P, N) array
        begin, end : float, s

        Returns
        -------
        errors : (N,) array
        outcomes : (N,) array of MemberOutcome
        """
        return self._largest.largest(starts, parameters[self._rows], begin, end)
