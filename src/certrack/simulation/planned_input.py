"""Plans of the input within its limits, where the formula's own plan would leave them.

The cost of :class:`~certrack.laws.baselines.mpc.Mpc` is, up to a constant, a multiple of
sum_j (v_j - K xi_j)^2, since its last weight solves Riccati's equation. With w_j = v_j - K xi_j,

    v_j = K (A + B K)^j xi_0 + w_j + sum_{i<j} K (A + B K)^{j-1-i} B w_i = free_j + (L w)_j

so a plan is the smallest w with low <= u_j(w) <= high: zero where the free plan keeps the limits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import MissingExtra
from certrack.core.expressions import TIME, symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.sampled.events import EventTimeline
from certrack.integrators.sampled.maps import SampledMaps, Scalar
from certrack.integrators.sampled.solution import StepTable
from certrack.laws.baselines.mpc import MOVES, Mpc, planned_limits
from certrack.loops.sampled import SampledLoop
from certrack.systems.system import System

#: Accuracy of the program's solution, relative and absolute, and its largest effort.
PLAN_TOLERANCE, PLAN_ITERATIONS = 1e-6, 20_000

#: Plans of so many samples ask for the reference at once.
REFERENCE_CHUNK = 2000


class PlannedMaps:
    """Maps of a sampled loop whose command is the first move of a plan.

    Parameters
    ----------
    maps : SampledMaps
        Of the formulas.
    loop : SampledLoop
    system : System
        With an :class:`~certrack.laws.baselines.mpc.Mpc`.
    line : EventTimeline
        The times of its samples are known beforehand, and with them the reference of all plans.

    Attributes
    ----------
    solved : int
        How many programs have been solved.
    """

    def __init__(
        self, maps: SampledMaps, loop: SampledLoop, system: System, line: EventTimeline
    ) -> None:
        law, plant = system.law, system.plant
        limits = planned_limits(law, system.implementation)
        assert isinstance(law, Mpc) and limits is not None
        self.step, self._control = maps.step, maps.control
        self.solved, self._limits = 0, limits
        A, B, K = law.plan_matrices(plant)
        closed = A + np.outer(B, K)
        powers = [np.eye(plant.n)]
        for _ in range(MOVES - 1):
            powers.append(closed @ powers[-1])
        self._free = np.array([K @ power for power in powers])
        effect = np.array([1.0, *(self._free[:-1] @ B)])
        self._L = np.array(
            [[effect[j - i] if i <= j else 0.0 for i in range(MOVES)] for j in range(MOVES)]
        )
        self._g_n = law.known_gain(plant)
        self._program: Any = None
        coordinates = law.coordinates(plant)
        clock = line.clock[line.samples]
        self._times = clock
        offsets = law.horizon / MOVES * np.arange(MOVES)
        followed, fed, Y_at = [], [], []
        feed = coordinates.nu_Y.copy()
        feed[:-1] += K @ coordinates.B  # what is left is the input of a plant that follows
        for begin in range(0, len(clock), REFERENCE_CHUNK):
            times = (clock[begin : begin + REFERENCE_CHUNK, None] + offsets).ravel()
            Y = system.reference.values(times, coordinates.q + 1)
            fed.append((feed @ Y).reshape(-1, MOVES))
            Y_at.append(Y[:, ::MOVES].T)
            followed.append((coordinates.B @ Y[:-1, ::MOVES]).T)
        self._fed, self._followed = np.concatenate(fed), np.concatenate(followed)
        self._read_times = line.times[line.samples]
        self._law_input = _input_of(system)
        self._Y = np.concatenate(Y_at)
        controller = loop.controller
        steps: dict[Any, Any] = {}
        for name, formula in controller.steps:
            steps[name] = formula.xreplace(steps)
        known = dict(controller.values)
        self._states = numpy_callable(
            [TIME, controller.measured, controller.states, [*loop.parameters, *loop.pieces]],
            [known.get(z, z).xreplace(steps) for z in controller.measured],
        )

    def keep_limits(self, record: StepTable) -> bool:
        """Whether the plans of the formula keep the limits at all samples of a run.

        Parameters
        ----------
        record : StepTable
            Of the formula's loop, whose controller measures the states as they are.
        """
        last = len(record.ends) - 1
        steps = np.minimum(np.searchsorted(record.ends, self._read_times), last)
        x = record.columns[: len(self._followed[0]), steps]
        return self._within(self._plans(x[:, :1], slice(1))) and self._within(
            self._plans(x, slice(None))
        )

    def _plans(self, x: Array, samples: slice) -> Array:
        """Inputs of the formula's own plans, (K, 20), from the states at K samples."""
        u = self._law_input(x, self._Y[samples])
        free = (x.T - self._followed[samples]) @ self._free.T
        fed = self._fed[samples]
        return u[:, None] + (free - free[:, :1] + fed - fed[:, :1]) / self._g_n

    def _within(self, plans: Array) -> bool:
        low, high = self._limits
        return bool(plans.min() >= low and plans.max() <= high)

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        """The command within the limits; see :class:`SampledMaps`."""
        u, after = self._control(t, measured, states, p)
        with np.errstate(all="ignore"):
            x = rows(self._states(t, measured, states, p), 1)
        k = int(np.searchsorted(self._times, float(np.ravel(t)[0])))
        plan = self._plans(x, slice(k, k + 1))
        if not np.isfinite(plan).all() or self._within(plan):
            return u, after
        return np.clip(plan[:, 0] + self._correction(plan[0]), *self._limits), after

    def _correction(self, plan: Array) -> float:
        """What the program adds to the first move; it starts from the plan before."""
        import scipy.sparse

        low, high = self._limits
        bounds = (low - plan, high - plan)
        self.solved += 1
        if self._program is None:
            self._program = quadratic_programs().OSQP()
            self._program.setup(
                scipy.sparse.csc_matrix(np.eye(MOVES)),
                np.zeros(MOVES),
                scipy.sparse.csc_matrix(self._L),
                *bounds,
                verbose=False,
                eps_abs=PLAN_TOLERANCE * max(abs(v) for v in self._limits if np.isfinite(v)),
                eps_rel=PLAN_TOLERANCE,
                max_iter=PLAN_ITERATIONS,
                warm_starting=True,
            )
        else:
            self._program.update(l=bounds[0], u=bounds[1])
        return float(self._program.solve(raise_error=False).x[0])


def _input_of(system: System) -> Callable[[Array, Array], Array]:
    """The law's input as a function of K states, (n, K), and of the reference, (K, q + 2)."""
    controller, constants = system.controller, system.plant.constant_values
    names = [*controller.symbols, *map(symbol, constants)]
    numbers = [*controller.values, *map(float, constants.values())]
    signals = controller.signals
    evaluate = numpy_callable([signals.x, signals.Y, names], [controller.equations.u])

    def at(x: Array, Y: Array) -> Array:
        with np.errstate(all="ignore"):
            values: Array = rows(evaluate(x, Y.T, numbers), x.shape[1])[0]
        return values

    return at


def quadratic_programs() -> Any:
    """The module that solves them.

    Raises
    ------
    MissingExtra
    """
    try:
        import osqp
    except ImportError:
        raise MissingExtra("OSQP", "mpc", "the mpc law within limits of the input") from None
    return osqp
