"""The base of the methods for sampled controllers: what compiled C and maps have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
import sympy

from certrack.integrators.registers import LANES
from certrack.integrators.sampled.events import EventTimeline, event_timeline
from certrack.integrators.sampled.run import SampledProblem
from certrack.integrators.sampled.sliding import with_modes
from certrack.loops.controller import sampled_controller, starting_state
from certrack.loops.controller_values import controller_values
from certrack.loops.plant import INPUT
from certrack.loops.sampled import loop_values, sample_loop
from certrack.loops.time_switches import switched_sampled_loop
from certrack.model.implementation import Implementation
from certrack.model.noise import keys
from certrack.simulation.sampled import outputs_of
from certrack.studies.ensembles.build_flow import open_numbers
from certrack.studies.ensembles.members import AMPLITUDE
from certrack.studies.ensembles.methods.base import MemberResults, Method
from certrack.studies.ensembles.metric_formulas import (
    IN_TAIL,
    INTEGRAL_METRICS,
    MEMORY_METRICS,
    SETTLING_BAND,
    sampled_totals,
)
from certrack.studies.ensembles.problem import EnsembleProblem
from certrack.studies.ensembles.statistics import Bands

#: Names of what is totalled; the last one is kept by the integrators themselves.
TOTALS = (*INTEGRAL_METRICS, *MEMORY_METRICS[1:], MEMORY_METRICS[0])

#: Gets the number of a time of the grid, the shown values of all members there, and which of them
#: count: those that have to be run alone show what comes after their last time themselves.
OnGridPoint = Callable[[int, np.ndarray, np.ndarray], None]


@dataclass(frozen=True)
class GroupResults:
    """What came of members that were integrated together.

    Attributes
    ----------
    totals : values of each of :data:`TOTALS`, by name
    ends : (N,) array, s
    run_alone : (N,) array of bool
    """

    totals: dict[str, np.ndarray]
    ends: np.ndarray
    run_alone: np.ndarray


class SampledMethod(Method):
    """A method for sampled controllers, which can be asked for other implementations, too.

    Members are integrated in whole vector registers, by :meth:`integrate` of the subclass.

    Parameters
    ----------
    problem : EnsembleProblem
        The members of a system with an implementation.
    threads : int
    adjustable : bool
        Whether :meth:`extremes` is to be asked for other implementations: their numbers are then
        runtime parameters.
    """

    def __init__(self, problem: EnsembleProblem, threads: int, *, adjustable: bool) -> None:
        self.problem, self.threads = problem, threads
        self._counting = Lock()  # several threads count in the same bands
        self._system = system = problem.members.template
        assert system.implementation is not None
        self._implementation = system.implementation
        plant, controller = problem.system.plant, problem.system.controller
        self._controller = sampled_controller(plant, controller, self._implementation)
        free = {*problem.varying, *(self._controller.numbers if adjustable else ())}
        general = sample_loop(system, sampled_totals())
        values = loop_values(general, system).tolist()
        base = dict(zip(general.parameters, values, strict=True))
        names = open_numbers(base, free, general.formulas) if self.any_numbers else ()
        self.numbers = {name: base[name] for name in names}
        fixed = {s: sympy.Float(v) for s, v in base.items() if s not in free and s not in names}
        loop = general.with_numbers(fixed)
        loop, switches = switched_sampled_loop(loop, names, problem.varying)
        if not adjustable:
            problem.refuse_own_times(switches)
        self.segments = problem.segments(switches, base)
        of_members = (s for s in loop.parameters if s not in self.numbers)
        pieces = (IN_TAIL, *loop.pieces)
        loop = replace(loop, parameters=(*of_members, SETTLING_BAND), pieces=pieces)
        self.loop, self.surfaces = with_modes(loop)
        self.shown = (loop.e_1, *loop.plant.outputs, INPUT)
        self.timeline = self._timeline_under(self._implementation)
        self._outputs = outputs_of(self.loop)

    #: Whether numbers that all members share stay symbols in the formulas, as :attr:`numbers`.
    any_numbers = False

    #: Whether the maps want whole vector registers of members.
    whole_registers = True

    @property
    def varies_what_is_planned(self) -> bool:
        """Whether a law that plans ahead knows other numbers in every member."""
        reference = self._system.reference.parameter_symbols
        planned = {AMPLITUDE, *reference, *self._controller.parameters}
        return not planned.isdisjoint(self.problem.varying)

    @abstractmethod
    def integrate(self, group: SampledProblem, on_grid_point: OnGridPoint) -> GroupResults:
        """Integrate members to their end; any number of threads may do so at once."""

    def compute(self, begin: int, end: int, bands: Bands) -> MemberResults:
        """Whole groups of lanes are computed, the members begin ... end-1 are counted."""
        first, last = begin, end
        if self.whole_registers:
            first, last = begin - begin % LANES, -(-end // LANES) * LANES
        part = slice(begin - first, end - first)

        def on_grid_point(k: int, values: np.ndarray, is_counted: np.ndarray) -> None:
            with self._counting:
                for signal, row in enumerate(values):
                    bands.observe(signal, k, row[part][is_counted[part]])

        group = self._group_problem(first, *self.problem.starts_and_parameters(first, last))
        results = self.integrate(group, on_grid_point)
        totals = {name: values[part] for name, values in results.totals.items()}
        metrics = self.problem.metrics(totals)
        return MemberResults(metrics, results.ends[part], results.run_alone[part])

    def extremes(self, members: int, implementation: Implementation) -> tuple[float, float]:
        """Largest tail error and input of the first members under another implementation.

        Parameters
        ----------
        members : int
        implementation : Implementation
            With the structure of the system's own.

        Returns
        -------
        tail_error : float
            inf where a member does not finish.
        peak_input : float
        """
        size = LANES * max(1, members // (LANES * self.threads))
        numbers = self._numbers(implementation)

        def of_group(first: int) -> tuple[float, float]:
            last = first + size if self.whole_registers else min(first + size, members)
            starts, table = self.problem.starts_and_parameters(first, last)
            table |= {name: np.full(last - first, value) for name, value in numbers.items()}
            group = self._group_problem(first, starts, table, implementation)
            results = self.integrate(group, lambda *_: None)
            part = slice(0, members - first)
            done = ~results.run_alone & (results.ends >= self.problem.end)
            tails = np.where(done, results.totals["tail_error"], np.inf)[part]
            return float(tails.max()), float(np.nanmax(results.totals["peak_input"][part]))

        with ThreadPoolExecutor(self.threads) as pool:
            extremes = list(pool.map(of_group, range(0, members, size)))
        return max(tail for tail, _ in extremes), max(peak for _, peak in extremes)

    def _numbers(self, implementation: Implementation) -> dict[sympy.Symbol, float]:
        """Values of the controller's parameters that an implementation may change."""
        system, controller = self.problem.system, self._controller
        values = controller_values(controller, system.plant, system.law, implementation)
        of_name = dict(zip(controller.parameters, values, strict=True))
        return {name: of_name[name] for name in controller.numbers}

    def _timeline_under(self, implementation: Implementation) -> EventTimeline:
        """All events under an implementation: the same for all members."""
        problem = self.problem
        duration, breaks = problem.system.settings.duration, self.segments.edges[1:-1]
        return event_timeline(implementation, duration, breaks, problem.times)

    def _group_problem(
        self,
        first: int,
        starts: np.ndarray,
        table: Mapping[sympy.Symbol, np.ndarray],
        implementation: Implementation | None = None,
    ) -> SampledProblem:
        """Members from `first` on; under another implementation, if one is given."""
        loop, count = self.loop, starts.shape[1]
        events = self.timeline
        if implementation is not None:
            events = self._timeline_under(implementation)
        implementation = implementation or self._implementation
        n, estimates = loop.plant.n, len(starts) - loop.plant.n
        initial = starting_state(loop.controller, (0.0,) * estimates, implementation)
        states = np.repeat(initial[:, None], count, axis=1)
        states[:estimates] = starts[n:]
        return SampledProblem(
            x=starts[:n],
            states=states,
            totals=np.zeros((len(loop.totals), count)),
            parameters=np.array([table[name] for name in loop.parameters]),
            implementation=implementation,
            timeline=events,
            outputs=self._outputs,
            pieces=self.segments.at,
            keys=keys(self.problem.members.seed, first, count),
            tolerance=self.problem.tolerance,
            max_state=self._system.settings.max_state,
            surfaces=self.surfaces,
        )
