"""The search of the continuous loop's worst cases: population, kernels, ascent, the file's own.

It makes large what is asked for: the error, the input, a state or an estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from certrack.core.errors import InputError
from certrack.core.kinks import JUMPING
from certrack.core.progress import Progress
from certrack.laws.adaptive import Adaptive
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.adversary import Adversary
from certrack.studies.falsifier.ascent.search import ascend
from certrack.studies.falsifier.evolution import Search
from certrack.studies.falsifier.linear.estimated import estimated_case, is_estimated
from certrack.studies.falsifier.linear.search import LinearCase, NothingTried, continuous_case
from certrack.studies.falsifier.loop import AdversarialLoop
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
from certrack.systems.system import System

#: Where a worst case comes from.
SEARCH, OWN, KERNELS, ASCENT = "search", "own", "kernels", "ascent"


@dataclass(frozen=True)
class Hunted:
    """The cases of one search.

    Attributes
    ----------
    cases, runs : mappings of str to System and Run
        By origin.
    evaluations : int
        Runs spent.
    left_out : mapping of str to str
        Why kernels or ascent were not tried.
    seeded : pair of AdversarialLoop and array, or None
        The best point of the population.
    ended : str
        Why it stopped, in words.
    """

    cases: Mapping[str, System]
    runs: Mapping[str, Run]
    evaluations: int
    left_out: Mapping[str, str]
    seeded: tuple[AdversarialLoop, np.ndarray] | None
    ended: str


def hunt(
    system: System,
    bounds: tuple[float, ...],
    budget: int,
    seed: int,
    progress: Progress,
    output: SoughtOutput = ERROR,
) -> Hunted:
    """Search the worst admissible cases of a continuous loop.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_{q+1}
    budget, seed : int
    progress : callable
        Gets the runs so far, the budget and the worst so far.
    output : SoughtOutput
        What is made large.

    Raises
    ------
    InputError
        If a name of the plant is one of the search's own, or nothing can be searched.
    """
    left_out: dict[str, str] = {}
    linear = seeded = None
    ended = list[str]()
    try:
        case = estimated_case if is_estimated(system) else continuous_case
        linear = case(system, bounds, output)
    except NothingTried as refusal:
        left_out[KERNELS] = str(refusal)
    cases, evaluations = {OWN: system}, 0
    search = _search(_worst_member(system, linear), linear, budget, progress, output)
    if search is not None:
        evolved = search.evolve(budget, seed)
        candidates = (evolved, search.polish(evolved, budget))
        best = min(candidates, key=lambda point: float(search.scores(point[:, None])[0]))
        cases, evaluations = {SEARCH: search.loop.case(best)} | cases, search.evaluations
        seeded = search.loop, best
        ended.append(f"the budget of {budget} runs is spent")
    runs: dict[str, Run] = {}
    for origin, written in cases.items():  # each may take seconds, where it sticks
        progress(evaluations, budget, max(map(output.tail, runs.values()), default=None))
        runs[origin] = simulate(written)
    if linear is not None:
        ended.append("the linear program of the kernels is solved")
        cases[KERNELS], runs[KERNELS] = linear.system, linear.run
    if linear is None or is_estimated(system):
        try:
            earlier = [(case, runs[origin]) for origin, case in cases.items()]
            ascent = ascend(system, bounds, earlier, budget, seed, progress, output)
            evaluations += ascent.runs
            cases[ASCENT], runs[ASCENT] = ascent.case.system, ascent.case.run
            ended.append(f"the last turn of the ascent gained {100 * ascent.last_gain:.2g} %")
        except NothingTried as refusal:
            left_out[ASCENT] = str(refusal)
    return Hunted(cases, runs, evaluations, left_out, seeded, "; ".join(ended))


def _search(
    system: System,
    linear: LinearCase | None,
    budget: int,
    progress: Progress,
    output: SoughtOutput,
) -> Search | None:
    """The search; None for a plant or law that is not smooth, where something else is tried.

    That is the linear case, or the ascent, which follows the adaptive law across kinks.
    """
    Adversary.against(system)  # refuses names of the user
    try:
        return Search(AdversarialLoop(system, budget, output), budget, progress)
    except InputError:
        if linear is None and not _has_kinks_only(system):
            raise
        return None


def _has_kinks_only(system: System) -> bool:
    """Whether the loop is that of the adaptive law, and nothing of it jumps."""
    formulas = (system.plant.drift, *system.plant.regressor)
    jumps = any(formula.expr.has(*JUMPING) for formula in formulas)
    return isinstance(system.law, Adaptive) and not jumps


def _worst_member(system: System, linear: LinearCase | None) -> System:
    """The system, with its constants where the linear loop is worst."""
    if linear is None:
        return system
    member = linear.system.truth
    constants, theta = member.constants, member.theta
    truth = replace(system.truth, constants=constants, theta=theta, input_gain=member.input_gain)
    return system.replace(truth=truth)
