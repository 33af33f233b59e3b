"""Many runs of one closed loop at once, in eight lanes of a Taylor integrator (heyoka).

For smooth right-hand sides and smooth references; the parameters and starts of every lane differ.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certrack.core.errors import InputError
from certrack.core.heyoka import quiet_heyoka
from certrack.core.lowering import extract_switches, to_heyoka
from certrack.integrators.registers import LANES, whole_registers
from certrack.loops.continuous import ClosedLoop

#: A member that needs more steps has not finished; a run takes tens to hundreds.
MAX_STEPS = 20_000


class TaylorBatch:
    """A closed loop compiled for several lanes. Not for two threads at once.

    Parameters
    ----------
    loop : ClosedLoop
        Without kinks and reference pieces.
    tolerance : float
    """

    def __init__(self, loop: ClosedLoop, tolerance: float) -> None:
        hy = quiet_heyoka()
        rates, kinks = extract_switches(loop.rates)
        if kinks or loop.pieces:
            raise InputError("system", "must be smooth to be run in lanes", remedy="Use simulate")
        self._escaped = hy.taylor_outcome.err_nf_state
        used = set().union(*(rate.free_symbols for rate in rates))
        indices = [i for i, symbol in enumerate(loop.parameters) if symbol in used]
        self._used = np.array(indices, dtype=int)  # heyoka refuses parameters that nothing uses
        variables = [hy.expression(state.name) for state in loop.states]
        known = dict(zip(loop.states, variables, strict=True))
        known |= {loop.parameters[i]: hy.par[k] for k, i in enumerate(indices)}
        self._integrator = hy.taylor_adaptive_batch(
            list(zip(variables, to_heyoka(rates, known), strict=True)),
            np.zeros((len(variables), LANES)),
            tol=tolerance,
            pars=np.zeros((len(indices), LANES)),
        )

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
        starts : (S, N) array
        parameters : (P, N) array
        times : (T,) array
            Increasing, from 0.
        on_batch : callable
            Gets states (T, S, lanes), which lanes escaped, and the slice of members they belong
            to; a member that ended early has NaN from there on.
        max_steps : int
            A member that needs more has not finished.
        """
        ta, count = self._integrator, starts.shape[1]
        grid = np.repeat(times[:, None], LANES, axis=1)
        for first in range(0, count, LANES):
            last = min(first + LANES, count)
            lanes = last - first
            members = first + whole_registers(lanes)
            ta.set_time(0.0)
            ta.state[:] = starts[:, members]
            ta.pars[:] = parameters[self._used][:, members]
            _, states = ta.propagate_grid(grid, max_steps=max_steps)
            escaped = np.array([entry[0] == self._escaped for entry in ta.propagate_res[:lanes]])
            on_batch(states[:, :, :lanes], escaped, slice(first, last))
