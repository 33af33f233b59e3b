"""The input of a linear loop as its controller runs it, over a box of starts.

With the state xi_k before a sample (plant, memories, waiting inputs), of which the start decides
all but the inputs before it,

    xi_{k+1} = M xi_k + G Y_k,    u_k = K xi_k + K_Y Y_k,    xi_0 = P x_0 + p

and over the box of starts |u_k| is at most |u_k of the middle| + sum_j r_j |K M^k P|_j. Limits,
quantisation, noise and disturbance are left out.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import sympy

from certrack.core.lowering import numpy_callable
from certrack.loops.controller_values import controller_values
from certrack.loops.observers import INPUT_BEFORE
from certrack.loops.stability import LinearLoop, linear_loop
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.companion import is_memoryless
from certrack.tuning.responses import (
    Grid,
    InputResponse,
    LinearPlant,
    passes_through_zero,
    power_rows,
    states_along,
)

#: Samples of a run at most.
LONGEST_RESPONSE = 2**17


class SampledPlant:
    """A plant and its sampled controller, both linear, for any numbers of the controller."""

    def __init__(self, loop: LinearLoop, system: System) -> None:
        assert system.implementation is not None
        self.loop, self._drive = loop, system.implementation
        controller, T = loop.controller, self._drive.period
        by = (*controller.measured, INPUT_BEFORE)
        table = [sympy.diff(preset, v) for preset in controller.presets for v in by]
        self._presets = numpy_callable(controller.parameters, table)
        count = math.floor(system.settings.duration / T) + 1
        times = float(self._drive.offset) + T * np.arange(count)
        order = system.controller.coordinates.q + 1
        self._signals = np.array(system.reference.values(times, order))

    @classmethod
    def of(cls, system: System) -> SampledPlant | None:
        """None where the loop is not linear, a constant force acts, or samples are too many."""
        drive, loop = system.implementation, linear_loop(system)
        if drive is None or loop is None or not passes_through_zero(system):
            return None
        if system.settings.duration / drive.period > LONGEST_RESPONSE:
            return None
        return cls(loop, system)

    def response(
        self, candidate: Candidate, grid: Grid, centre: np.ndarray, radius: np.ndarray
    ) -> InputResponse:
        """The input from a box of starts; the grid is that of the samples, whatever is given."""
        loop, T = replace(self.loop, law=candidate.law), float(self._drive.period)
        row = loop.law_matrix(T)[0]
        n, memories = len(loop.C), len(loop.controller.states)
        M, G = loop.period_maps(T, float(self._drive.run_delay))
        K = np.zeros(len(M))
        K[:n], K[n : n + memories] = row[:n] @ loop.C, row[n : n + memories]
        P, p = self._first(loop, len(M))
        signals = self._signals
        xi = states_along(M, P @ centre + p * self._drive.initial_input, G @ signals[:, :-1])
        u = K @ xi + row[n + memories :] @ signals
        spread = np.abs(power_rows(M, K, signals.shape[1]) @ P) @ radius
        return InputResponse([u], [spread], (T,))

    def _first(self, loop: LinearLoop, size: int) -> tuple[np.ndarray, np.ndarray]:
        """xi_0 over the start, and over the input before the first sample."""
        n, memories = len(loop.C), len(loop.controller.states)
        values = controller_values(loop.controller, loop.system.plant, loop.law, self._drive)
        flat = [np.asarray(v, dtype=float) for v in self._presets(*values)]
        table = np.array(flat).reshape(memories, n + 1)
        P, p = np.zeros((size, n)), np.zeros(size)
        P[:n], p[:n] = loop.plant_over(float(self._drive.offset))
        P[n : n + memories] = table[:, :n] @ P[:n]
        p[n : n + memories] = table[:, n] + table[:, :n] @ p[:n]
        p[n + memories :] = 1.0
        return P, p


def input_plant(system: System) -> LinearPlant | SampledPlant | None:
    """What gives the input of a linear loop: as it runs, if its law has memories of its own."""
    if system.implementation is None or is_memoryless(system.law):
        return LinearPlant.of(system)
    return SampledPlant.of(system)
