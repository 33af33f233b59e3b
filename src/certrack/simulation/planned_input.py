"""Plans of the input within its limits, where the formula's own plan would leave them.

The cost of :class:`~certrack.laws.baselines.mpc.Mpc` is, up to a constant, a multiple of
sum_j (v_j - K xi_j)^2, since its last weight solves Riccati's equation. With w_j = v_j - K xi_j,

    v_j = K (A + B K)^j xi_0 + w_j + sum_{i<j} K (A + B K)^{j-1-i} B w_i = free_j + (L w)_j

so a plan is the smallest w with low <= u_j(w) <= high: zero where the free plan keeps the limits.
Long runs find it in C (``plan.h``), by an active-set method; what goes from event to event by maps
asks OSQP. Both agree to OSQP's tolerance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.core.errors import MissingExtra
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.sampled.events import EventTimeline
from certrack.integrators.sampled.maps import SampledMaps, Scalar
from certrack.integrators.sampled.plans import LimitedPlans
from certrack.laws.baselines.mpc import MOVES, Mpc, planned_limits
from certrack.loops.controller import planning_base
from certrack.loops.sampled import SampledLoop
from certrack.systems.system import System

#: Accuracy of the program's solution by OSQP, relative and absolute, and its largest effort.
PLAN_TOLERANCE, PLAN_ITERATIONS = 1e-6, 20_000

#: By which part of the limits an exact solution may leave them.
PLAN_ROUNDING = 1e-10

#: Plans of so many samples ask for the reference at once.
REFERENCE_CHUNK = 2000


def limited_plans(system: System, line: EventTimeline) -> LimitedPlans | None:
    """Plans at all samples of a run; None of a law that plans nothing.

    Parameters
    ----------
    system : System
    line : EventTimeline
        The times of its samples are known beforehand, and with them the reference of all plans.
    """
    law, plant = system.law, system.plant
    limits = planned_limits(law, system.implementation)
    if limits is None:
        return None
    assert isinstance(law, Mpc)
    A, B, K = law.plan_matrices(plant)
    closed = A + np.outer(B, K)
    powers = [np.eye(plant.n)]
    for _ in range(MOVES - 1):
        powers.append(closed @ powers[-1])
    free = np.array([K @ power for power in powers])
    effect = np.array([1.0, *(free[:-1] @ B)])
    L = [[effect[j - i] if i <= j else 0.0 for i in range(MOVES)] for j in range(MOVES)]
    spread = (free - free[0]) / law.known_gain(plant)
    coordinates = law.coordinates(plant)
    feed = coordinates.nu_Y.copy()
    feed[:-1] += K @ coordinates.B  # what is left is the input of a plant that follows
    clock = line.clock[line.samples]
    ahead = law.horizon / MOVES * np.arange(MOVES)
    offsets = []
    for begin in range(0, len(clock), REFERENCE_CHUNK):
        times = (clock[begin : begin + REFERENCE_CHUNK, None] + ahead).ravel()
        Y = system.reference.values(times, coordinates.q + 1)
        fed = (feed @ Y).reshape(-1, MOVES) / law.known_gain(plant)
        followed = coordinates.B @ Y[:-1, ::MOVES]
        offsets.append(fed - fed[:, :1] - (spread @ followed).T)
    largest = max(abs(v) for v in limits if np.isfinite(v))
    return LimitedPlans(
        limits,
        np.ascontiguousarray(spread),
        np.concatenate(offsets),
        np.array(L),
        PLAN_ROUNDING * largest,
    )


class PlannedMaps:
    """Maps of a sampled loop whose command is the first move of a plan.

    Parameters
    ----------
    maps : SampledMaps
        Of the formulas.
    loop : SampledLoop
    line : EventTimeline
    plans : LimitedPlans

    Attributes
    ----------
    solved : int
        How many programs have been solved.
    """

    def __init__(
        self, maps: SampledMaps, loop: SampledLoop, line: EventTimeline, plans: LimitedPlans
    ) -> None:
        self.step, self._control = maps.step, maps.control
        self.solved, self._plans = 0, plans
        self._program: Any = None
        self._times = line.clock[line.samples]
        controller = loop.controller
        self._base = numpy_callable(
            [TIME, controller.measured, controller.states, [*loop.parameters, *loop.pieces]],
            planning_base(controller),
        )

    def control(self, t: Scalar, measured: Array, states: Array, p: Array) -> tuple[Array, Array]:
        """The command within the limits; see :class:`SampledMaps`."""
        u, after = self._control(t, measured, states, p)
        with np.errstate(all="ignore"):
            base = rows(self._base(t, measured, states, p), 1)[:, 0]
        plans = self._plans
        k = int(np.searchsorted(self._times, float(np.ravel(t)[0])))
        plan = base[0] + plans.spread @ base[1:] + plans.offsets[k]
        low, high = plans.limits
        if not np.isfinite(plan).all() or (plan.min() >= low and plan.max() <= high):
            return u, after
        return np.clip([plan[0] + self._correction(plan)], low, high), after

    def _correction(self, plan: Array) -> float:
        """What the program adds to the first move; it starts from the plan before."""
        import scipy.sparse

        low, high = self._plans.limits
        bounds = (low - plan, high - plan)
        self.solved += 1
        if self._program is None:
            self._program = quadratic_programs().OSQP()
            self._program.setup(
                scipy.sparse.csc_matrix(np.eye(MOVES)),
                np.zeros(MOVES),
                scipy.sparse.csc_matrix(self._plans.effect),
                *bounds,
                verbose=False,
                eps_abs=PLAN_TOLERANCE * self._plans.tolerance / PLAN_ROUNDING,
                eps_rel=PLAN_TOLERANCE,
                max_iter=PLAN_ITERATIONS,
                warm_starting=True,
            )
        else:
            self._program.update(l=bounds[0], u=bounds[1])
        return float(self._program.solve(raise_error=False).x[0])


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
