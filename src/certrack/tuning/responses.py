"""The input of a linear loop over a box of starts: its peak, which is exact, and its energy.

x' = (A + b k C) x + b f(t) and u = k C x + f, where f = k_Y (y_d ... y_d^(q+1)), is linear in the
start. Over the box x0 + [-r, r]

    sup |u(t)| = |u_0(t)| + sum_j r_j |k C e^{(A + b k C) t}|_j

with u_0 from the box's centre. w = 0, and the reference is the file's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import expm

from certrack.loops.stability import LinearLoop, linear_loop
from certrack.model.implementation import Implementation
from certrack.systems.system import System
from certrack.tuning.candidate import Candidate
from certrack.tuning.quantities import Quantity

#: Steps of each stretch of the grid; ends of the stretches as parts of the run, since what happens
#: early happens fast.
STRETCH_STEPS, STRETCHES = 512, (1 / 256, 1 / 32, 1 / 4, 1.0)


@dataclass(frozen=True)
class Grid:
    """Times, and the reference at them.

    Attributes
    ----------
    steps : width of the steps of each stretch, s
    signals : one (q + 2, STRETCH_STEPS + 1) array for each stretch
        y_d ... y_d^(q+1).
    """

    steps: tuple[float, ...]
    signals: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, system: System, refined: int = 1) -> Grid:
        """The grid of a run, each step cut into `refined` ones."""
        order = system.controller.coordinates.q + 1
        ends = np.array([0.0, *STRETCHES]) * system.settings.duration
        steps, signals = [], []
        for low, high in zip(ends[:-1], ends[1:], strict=True):
            times = np.linspace(low, high, STRETCH_STEPS * refined + 1)
            steps.append(float(times[1] - times[0]))
            signals.append(np.array(system.reference.values(times, order)))
        return cls(tuple(steps), tuple(signals))


@dataclass(frozen=True)
class InputResponse:
    """The nominal input along a grid.

    Attributes
    ----------
    u : list of arrays, for each stretch
        From the middle of the starts.
    spread : list of arrays
        sum_j r_j |k C e^{Mt}|_j.
    """

    u: list[np.ndarray]
    spread: list[np.ndarray]
    steps: tuple[float, ...]

    @property
    def peak(self) -> float:
        """sup |u| over time and the box."""
        return max(self.peaks)

    @property
    def peaks(self) -> list[float]:
        """sup u and sup -u at the start alone, then after it in each stretch.

        The largest of them has a kink where one becomes larger than another; each of them is
        mostly smooth.
        """
        parts = []
        for u, spread in zip(self.u, self.spread, strict=True):
            for values in (spread + u, spread - u):
                parts += [values[:1], values[1:]] if u is self.u[0] else [values]
        return [float(values.max()) for values in parts if values.size]

    @property
    def energy(self) -> float:
        """Integral of u^2 from the middle of the starts."""
        return float(
            sum(
                h * (u[1:] ** 2 + u[1:] * u[:-1] + u[:-1] ** 2).sum() / 3
                for u, h in zip(self.u, self.steps, strict=True)
            )
        )


class InputPlant(Protocol):
    """Whose input is linear in the start."""

    def response(
        self, candidate: Candidate, grid: Grid, centre: np.ndarray, radius: np.ndarray
    ) -> InputResponse:
        """The input from a box of starts."""


class LinearPlant:
    """A plant and law that are linear, for any gains; makes responses and edges of stability."""

    def __init__(self, loop: LinearLoop) -> None:
        self.loop = loop

    @classmethod
    def of(cls, system: System) -> LinearPlant | None:
        """None where the loop is not linear, the law has memories, or a constant force acts."""
        plain = system.replace(implementation=Implementation(PLAIN_PERIOD))
        loop = linear_loop(plain)
        if loop is None or loop.controller.states or not passes_through_zero(system):
            return None
        return cls(loop)

    def response(
        self, candidate: Candidate, grid: Grid, centre: np.ndarray, radius: np.ndarray
    ) -> InputResponse:
        """The input from a box of starts."""
        loop = replace(self.loop, law=candidate.law)
        row = loop.law_matrix(PLAIN_PERIOD)[0]
        n = len(loop.C)
        k, kY = row[:n] @ loop.C, row[n:]
        M = loop.A + np.outer(loop.b, k)
        inputs, spreads = [], []
        x, power = centre, np.eye(len(M))
        for h, signals in zip(grid.steps, grid.signals, strict=True):
            f = kY @ signals
            E, first, second = _ramp_step(M, loop.b, h)
            forced = np.outer(first, f[:-1]) + np.outer(second, f[1:])
            xs, rows = states_along(E, x, forced), power_rows(E, k @ power, f.shape[-1])
            inputs.append(k @ xs + f)
            spreads.append(np.abs(rows) @ radius)
            x, power = xs[:, -1], np.linalg.matrix_power(E, f.shape[-1] - 1) @ power
        return InputResponse(inputs, spreads, grid.steps)


#: The period at which a memoryless law is read off: its gains do not depend on it.
PLAIN_PERIOD = 1e-3


def passes_through_zero(system: System) -> bool:
    """Whether nothing acts on the plant at rest in the origin."""
    plant = system.plant
    at_rest = dict.fromkeys(plant.symbols, 0)
    formulas = [plant.drift.expr, *(phi.expr for phi in plant.regressor)]
    return all(formula.subs(at_rest) == 0 for formula in formulas) and not system.truth.states


def _ramp_step(M: np.ndarray, b: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x(t + h) = E x + first f(t) + second f(t + h), for a straight f between."""
    n = len(b)
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = M * h, b * h, 1.0
    step = expm(block)
    area, ramp = step[:n, n], step[:n, n + 1]
    return step[:n, :n], area - ramp, ramp


def states_along(E: np.ndarray, x: np.ndarray, forced: np.ndarray) -> np.ndarray:
    """x_0 ... x_N of x_{k+1} = E x_k + forced_k, by doubling."""
    total = np.concatenate([x[:, None], forced], axis=1)
    shift, power = 1, E
    while shift < total.shape[1]:
        total[:, shift:] += power @ total[:, :-shift].copy()
        shift, power = 2 * shift, power @ power
    return total


def power_rows(E: np.ndarray, row: np.ndarray, count: int) -> np.ndarray:
    """Row E^k for k = 0 ... count - 1."""
    rows, power = row[None, :], E
    while len(rows) < count:
        rows = np.vstack([rows, rows @ power])
        power = power @ power
    return rows[:count]


@dataclass(frozen=True, eq=False)
class BoxResponse:
    """The input from a box of starts, computed once for each candidate."""

    plant: InputPlant
    grid: Grid
    box: np.ndarray

    def of(self, candidate: Candidate) -> InputResponse:
        """The response of a candidate."""
        box = self.box
        centre, radius = box.mean(axis=1), (box[:, 1] - box[:, 0]) / 2
        return candidate.once(
            self, lambda: self.plant.response(candidate, self.grid, centre, radius)
        )


class BoxPeak(Quantity):
    """The largest |u| over time and the box of starts, of a linear loop."""

    name = "peak input"

    def __init__(self, response: BoxResponse) -> None:
        self._response = response

    def value(self, candidate: Candidate) -> float:
        return self._response.of(candidate).peak


class PartPeak(BoxPeak):
    """The same of one sign and in one stretch of time: one of `InputResponse.peaks`."""

    def __init__(self, response: BoxResponse, place: int) -> None:
        super().__init__(response)
        self._place = place

    @classmethod
    def every(cls, response: BoxResponse, candidate: Candidate) -> list[Quantity]:
        """All of them."""
        return [cls(response, place) for place in range(len(response.of(candidate).peaks))]

    def value(self, candidate: Candidate) -> float:
        return self._response.of(candidate).peaks[self._place]


class StartPeak(BoxPeak):
    """The largest |u| from the file's start, which a drive's limits must admit."""

    name = "input from x0"


class LinearEnergy(Quantity):
    """Integral of u^2 over the run from the file's start, of a linear loop."""

    name = "energy"

    def __init__(self, plant: InputPlant, grid: Grid, x0: np.ndarray) -> None:
        self._response = BoxResponse(plant, grid, np.stack([x0, x0], axis=1))

    def value(self, candidate: Candidate) -> float:
        return self._response.of(candidate).energy
