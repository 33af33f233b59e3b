"""The best possible trajectory of a system's true plant, and how far its law is from it.

The trajectory knows everything beforehand: the plant as it really is, its disturbance and the whole
reference. No law can do better from that start, so the ratio of the law's cost to it says how much
is left to gain. An optimum is found by direct collocation on meshes that grow finer, each made from
the input of the optimum before; what the plant really does with the input found is integrated by
another method. It is a local optimum, found and not proven.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from time import monotonic
from typing import Any

from certrack.core import checks
from certrack.core.arrays import Array
from certrack.core.casadi_forms import casadi
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.loops.plant import measured
from certrack.simulation.run import Run
from certrack.studies.optimal.goal import Goal, TrajectoryCost
from certrack.studies.optimal.law_run import LawRun, law_run_of
from certrack.studies.optimal.mesh_search import (
    ELEMENTS,
    FIRST_ELEMENTS,
    FOLLOWED,
    NEGLIGIBLE_MINIMUM,
    SearchRoom,
    finest,
)
from certrack.systems.system import System, require_system

#: All searches may take so long, s.
OPTIMA_SECONDS = 300.0

#: The most that may be asked for.
MAX_ELEMENTS = 20_000

#: Nearer than this the start counts as at the reference.
AT_REFERENCE = 1e-9

#: A law keeps a limit that it exceeds by this part.
LIMIT_ROUNDING = 1e-6


@dataclass(frozen=True)
class Optimum:
    """One optimal trajectory.

    Attributes
    ----------
    goal : Goal
    converged : bool
        Whether the search ended at a local optimum.
    reason : str
        Why not; empty if it did.
    cost : TrajectoryCost
        What it costs, by the integration of the plant with its input.
    ends : (E + 1,) array, s
    inputs : (2, E) array
        At the begin and at the end of every element, straight between.
    times : (N,) array, s
    states : (S, N) array
        States of the simulated plant in that integration.
    output, reference : (N,) arrays
        x_1 as it is measured, and y_d.
    mesh_error : float or None
        Relative change of the minimum from the mesh before to the last one; None of a single mesh.
    deviation : float
        Largest defect of the trajectory at the ends of elements, relative to the largest magnitude
        of each state.
    smoothing : float
        eps of the kinks, as a part of the largest size of their arguments in the law's run; 0 where
        nothing is smoothed.
    timed_out : bool
        Whether the search ended because its time was over: longer, it might have found less.
    """

    goal: Goal
    converged: bool
    reason: str
    cost: TrajectoryCost
    ends: Array
    inputs: Array
    times: Array
    states: Array
    output: Array
    reference: Array
    mesh_error: float | None
    deviation: float
    smoothing: float = 0.0
    timed_out: bool = False

    @property
    def minimum(self) -> float:
        """The value of what was minimised."""
        return float(getattr(self.cost, self.goal.minimised))

    def record(self) -> dict[str, Any]:
        """Ready for JSON, without the trajectories."""
        return {
            **self.goal.record(),
            "converged": self.converged,
            "reason": self.reason,
            **self.cost.record(),
            "mesh_error": self.mesh_error,
            "deviation": self.deviation,
            "smoothing": self.smoothing,
            "timed_out": self.timed_out,
        }


@dataclass(frozen=True)
class Optima:
    """A law's run, and optima of the same plant from the same start.

    Attributes
    ----------
    run : Run
        The law's own, up to the horizon.
    law : TrajectoryCost
        What it costs.
    optima : tuple of Optimum
    """

    run: Run
    law: TrajectoryCost
    optima: tuple[Optimum, ...]

    @property
    def horizon(self) -> float:
        """End of the runs, s."""
        return self.run.system.settings.duration

    @property
    def converged(self) -> bool:
        """Whether every optimum that was asked for was found."""
        return all(optimum.converged for optimum in self.optima)

    def excess(self, optimum: Optimum) -> float | None:
        """How many times the minimum the law needs of it.

        None where the law does not keep the limits, the minimum is as good as zero, or there is
        none.
        """
        law = self.law
        limits = optimum.goal.limits.items()
        within = all(getattr(law, n) <= limit * (1 + LIMIT_ROUNDING) for n, limit in limits)
        needed = self.law_of(optimum)
        if not (optimum.converged and within and optimum.minimum > NEGLIGIBLE_MINIMUM * needed):
            return None
        return needed / optimum.minimum

    def law_of(self, optimum: Optimum) -> float:
        """What the law has of what was minimised."""
        return float(getattr(self.law, optimum.goal.minimised))

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "horizon": self.horizon,
            "law": self.law.record(),
            "optima": [
                entry.record() | {"law_over_minimum": self.excess(entry)} for entry in self.optima
            ],
        }

    def __repr__(self) -> str:
        shown = ", ".join(
            f"least {entry.goal.minimised} {entry.minimum:.4g} (law {self.law_of(entry):.4g})"
            for entry in self.optima
        )
        return f"Optima({shown})"


def optimal(
    system: System,
    objective: str | None = None,
    *,
    squared_error: float | None = None,
    energy: float | None = None,
    peak_input: float | None = None,
    horizon: float | None = None,
    elements: int = ELEMENTS,
    time_limit: float = OPTIMA_SECONDS,
    progress: Progress = silent,
) -> Optima:
    """Find the best possible trajectories of a system's true plant, and compare its law.

    Of all inputs u(t), minimise one of int e_1^2 dt, int u^2 dt, max |u| and the time to y_d,
    subject to x' = f(t, x, u) with the truth of the file, x(0), and limits of the others.

    Parameters
    ----------
    system : System
    objective : str, optional
        ``"squared_error"``, ``"energy"``, ``"peak"`` or ``"time"``. By default three optima are
        found: the least squared error at the law's own energy and peak, the least energy at its
        squared error, and the least squared error at its peak alone.
    squared_error, energy, peak_input : float, optional
        Limits of the integral of e_1^2, the integral of u^2, and |u|.
    horizon : float, optional, s
        End of the runs; by default the duration of the file's simulation.
    elements : int
        Of the last mesh at most: on each the input is a line.
    time_limit : float, s
        Of all searches together; then each optimum is the last one that was found.
    progress : callable
        Called as ``progress(done, total, iterations)`` with the searches that are done, and the
        iterations of the one that goes on.

    Returns
    -------
    Optima

    Raises
    ------
    InputError
        Where limits contradict the objective, or the law's own run does not reach the horizon.
    MissingExtra
        Without CasADi.

    Notes
    -----
    The optima are local ones, found from the law's run; nothing is proven of them.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.optimal(system, "energy", squared_error=0.155, horizon=6)
    >>> found.optima[0].cost.energy < found.law.energy / 10
    True
    """
    require_system(system)
    count = checks.integer("elements", elements, least=FIRST_ELEMENTS, most=MAX_ELEMENTS)
    limits = {"squared_error": squared_error, "energy": energy, "peak": peak_input}
    goal = None if objective is None else Goal(objective, **limits)
    stated = {"squared_error": squared_error, "energy": energy, "peak_input": peak_input}
    stated |= {"horizon": horizon, "time_limit": time_limit}
    for key, value in stated.items():
        if value is not None:
            checks.real(key, value, above=0)
    ca = casadi("the search for optimal trajectories")
    law_run = law_run_of(system, horizon, silent)
    goals = _against_the_law(law_run.law, limits) if goal is None else (goal,)
    if goal is not None and goal.minimised == "time" and law_run.distance() < AT_REFERENCE:
        raise InputError(
            "objective", "the run begins at the reference: no time is needed to reach it", "time"
        )
    optima, begin = [], monotonic()
    for i, one in enumerate(goals):
        progress(i, len(goals), None)
        iterations = itertools.count(1)

        def called(i: int = i, iterations: Iterator[int] = iterations) -> None:
            progress(i, len(goals), next(iterations))

        left = time_limit - (monotonic() - begin)  # what one does not need is the others'
        ends_at = monotonic() + left / (len(goals) - i)
        optima.append(_optimum(SearchRoom(ca, one, count, ends_at, called), law_run))
    progress(len(goals), len(goals), None)
    return Optima(law_run.run, law_run.law, tuple(optima))


def _against_the_law(law: TrajectoryCost, limits: dict[str, float | None]) -> tuple[Goal, ...]:
    """The goals by which a law is judged; limits that are given replace the law's own cost."""
    limits = {name: value or getattr(law, name) for name, value in limits.items()}  # none is 0
    return (
        Goal("squared_error", energy=limits["energy"], peak=limits["peak"]),
        Goal("energy", squared_error=limits["squared_error"]),
        Goal("squared_error", peak=limits["peak"]),
    )


def _optimum(room: SearchRoom, law_run: LawRun) -> Optimum:
    """The optimum of the finest mesh that was solved, and what the plant does with its input."""
    search, change = finest(room, law_run)
    timed_out = room.is_over
    played, converged, reason = search.played, search.answer.converged, search.answer.reason
    if converged and played.deviation > FOLLOWED:
        converged, reason = False, "the plant does not follow what the program takes for its motion"
    system = law_run.system
    return Optimum(
        goal=room.goal,
        converged=converged,
        reason=reason,
        cost=played.cost,
        ends=search.ends,
        inputs=search.values.inputs,
        times=played.times,
        states=played.states,
        output=measured(system, played.states)[0],
        reference=system.reference.values(played.times, 0)[0],
        mesh_error=change,
        deviation=played.deviation,
        smoothing=search.law_run.smoothing,
        timed_out=timed_out,
    )
