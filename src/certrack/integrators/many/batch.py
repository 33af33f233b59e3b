"""Many runs of one closed loop at once: eight lanes of a Taylor integrator (heyoka).

For smooth right-hand sides and smooth references; the parameters and starts of every lane differ.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certrack.core.errors import InputError
from certrack.core.lowering import extract_switches, to_heyoka
from certrack.loops.continuous import ClosedLoop

LANES = 8


class BatchIntegrator:
    """A closed loop compiled for several lanes. Not for two threads at once.

    Parameters
    ----------
    loop : ClosedLoop
        Without kinks and reference pieces.
    tolerance : float
    """

    def __init__(self, loop: ClosedLoop, tolerance: float) -> None:
        import heyoka as hy

        rates, kinks = extract_switches(loop.rates)
        if kinks or loop.pieces:
            raise InputError("system", "must be smooth to be run in lanes", remedy="Use simulate")
        self._escaped = hy.taylor_outcome.err_nf_state
        used = set().union(*(rate.free_symbols for rate in rates))
        own = [i for i, symbol in enumerate(loop.parameters) if symbol in used]
        self._own = np.array(own, dtype=int)
        variables = [hy.expression(state.name) for state in loop.states]
        known = dict(zip(loop.states, variables, strict=True))
        known |= {loop.parameters[i]: hy.par[k] for k, i in enumerate(own)}
        self._integrator = hy.taylor_adaptive_batch(
            list(zip(variables, to_heyoka(rates, known), strict=True)),
            np.zeros((len(variables), LANES)),
            tol=tolerance,
            pars=np.zeros((len(own), LANES)),
        )

    def over_time(
        self,
        starts: np.ndarray,
        parameters: np.ndarray,
        times: np.ndarray,
        look: Callable[[np.ndarray, np.ndarray, slice], None],
        max_steps: int = 20_000,
    ) -> None:
        """Integrate every member over `times` and show its states to `look`.

        Parameters
        ----------
        starts : (S, N) array
        parameters : (P, N) array
        times : (T,) array
            Increasing, from 0.
        look : callable
            Gets states (T, S, lanes), which lanes escaped, and the slice of members they belong
            to; a member that ended early has NaN from there on.
        """
        ta, count = self._integrator, starts.shape[1]
        grid = np.repeat(times[:, None], LANES, axis=1)
        for first in range(0, count, LANES):
            members = np.minimum(np.arange(first, first + LANES), count - 1)  # pad the last batch
            ta.set_time(0.0)
            ta.state[:] = starts[:, members]
            ta.pars[:] = parameters[self._own][:, members]
            _, states = ta.propagate_grid(grid, max_steps=max_steps)
            last = min(first + LANES, count)
            lanes = last - first
            escaped = np.array([entry[0] == self._escaped for entry in ta.propagate_res[:lanes]])
            look(states[:, :, :lanes], escaped, slice(first, last))
