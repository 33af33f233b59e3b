"""The search for one optimum: from the law's run, on meshes that grow finer.

Kinks of the plant in its states (abs, min, max and the sign of dry friction) have no slope that a
search could follow over them. They are therefore smoothed first, |a| by sqrt(a^2 + eps^2) and
sign(a) by a/sqrt(a^2 + eps^2), and eps falls from solution to solution, each from the one before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.studies.optimal.collocation import CollocationGrid, gauss_scheme
from certrack.studies.optimal.goal import Goal
from certrack.studies.optimal.ipopt import SolverAnswer, minimise
from certrack.studies.optimal.law_run import LawRun
from certrack.studies.optimal.mesh import MESH_SAMPLES, mesh
from certrack.studies.optimal.program import (
    GridValues,
    PlantMotion,
    guess_on,
    motion_on,
    solution,
    transcribe,
)
from certrack.studies.optimal.replay import Replay, replay

#: eps over the largest size that the argument of a kink has in the law's run, one after the other.
SMOOTHINGS = (0.1, 0.03, 0.01, 3e-3, 1e-3)

#: Elements of the first mesh, and the most of the last one: from mesh to mesh they double.
FIRST_ELEMENTS, ELEMENTS = 120, 960

#: A minimum below this part of what the law needs is as good as zero.
NEGLIGIBLE_MINIMUM = 1e-9

#: A mesh is fine enough where the minimum changes by less than this part from the one before.
MINIMUM_CHANGE = 3e-3

#: An optimum is none if the plant deviates from it by more than this part of a state's magnitude.
FOLLOWED = 1e-3


def finest(
    ca: Any, law_run: LawRun, goal: Goal, elements: int, called: Callable[[], None]
) -> tuple[SolvedMesh, float | None]:
    """Search from the law's run, then from the optimum of each mesh on one twice as fine.

    Also the change of the minimum with the last mesh, relative; None of a single mesh. Kinks are as
    little smoothed as the plant follows.
    """
    law_run = replace(law_run, over_time=goal.minimised == "time")
    for first in reversed(_smoothed_less(ca, law_run, goal, called)):
        search, change = _refined(ca, first, goal, elements, called)
        if search.answer.converged and search.played.deviation <= FOLLOWED:
            break
    return search, change


def _refined(
    ca: Any, search: SolvedMesh, goal: Goal, elements: int, called: Callable[[], None]
) -> tuple[SolvedMesh, float | None]:
    """The optimum of the finest mesh, and the change of the minimum with it."""
    law_run, count, change = search.law_run, FIRST_ELEMENTS, None
    while search.answer.converged and count < elements:
        settled = change is not None and change < MINIMUM_CHANGE
        if settled and search.played.deviation < FOLLOWED:
            break
        count = min(2 * count, elements)
        finer = solve_mesh(ca, law_run, goal, count, search.motion, called)
        if not finer.answer.converged:
            break  # a coarser optimum is one, too
        floor = max(abs(search.minimum), abs(finer.minimum), NEGLIGIBLE_MINIMUM)
        search, change = finer, abs(finer.minimum - search.minimum) / floor
    return search, change


def _smoothed_less(
    ca: Any, law_run: LawRun, goal: Goal, called: Callable[[], None]
) -> list[SolvedMesh]:
    """The first mesh, with kinks smoothed less and less, up to where the search finds no optimum.

    Where nothing is to be smoothed, or the first search finds none, that is all.
    """
    if not law_run.has_kinks:
        return [_coarsest(ca, law_run, goal, FIRST_ELEMENTS, called)]
    widest = replace(law_run, smoothing=SMOOTHINGS[0])
    searches = [_coarsest(ca, widest, goal, FIRST_ELEMENTS, called)]
    for smoothing in SMOOTHINGS[1:]:
        last = searches[-1]
        if last.answer.converged:
            sharper = replace(law_run, smoothing=smoothing)
            solved = solve_mesh(ca, sharper, goal, FIRST_ELEMENTS, last.motion, called)
            if not solved.answer.converged:
                break
            searches.append(solved)
    return searches


def _coarsest(
    ca: Any, law_run: LawRun, goal: Goal, count: int, called: Callable[[], None]
) -> SolvedMesh:
    """The first mesh; the shortest time is sought within the law's, then within the horizon."""
    ends = [law_run.horizon]
    if goal.minimised == "time" and 0 < law_run.law.time < law_run.horizon:
        ends.insert(0, law_run.law.time)
    for end in ends:
        motion = PlantMotion(law_run.states, law_run.inputs, end)
        search = solve_mesh(ca, law_run, goal, count, motion, called)
        if search.answer.converged:
            break
    return search


@dataclass(frozen=True)
class SolvedMesh:
    """A solved program.

    Attributes
    ----------
    law_run : LawRun
    answer : SolverAnswer
    of_time : bool
        Whether the time was minimised.
    ends : (E + 1,) array, s
    values : GridValues
        States and inputs on the mesh.
    motion : PlantMotion
        The same as functions of the time.
    """

    law_run: LawRun
    answer: SolverAnswer
    of_time: bool
    ends: Array
    values: GridValues
    motion: PlantMotion

    @property
    def minimum(self) -> float:
        """What was minimised, over a unit of its own; the time itself."""
        return self.motion.end if self.of_time else self.answer.minimum

    @cached_property
    def played(self) -> Replay:
        """What the plant does with the input found."""
        values = self.values
        return replay(self.law_run, self.ends, values.inputs, values.begins, self.of_time)


def solve_mesh(
    ca: Any,
    law_run: LawRun,
    goal: Goal,
    elements: int,
    first: PlantMotion,
    called: Callable[[], None],
) -> SolvedMesh:
    """Solve on the mesh that a motion makes, from that motion."""
    times = np.linspace(0.0, first.end, MESH_SAMPLES)
    breaks = law_run.breaks[law_run.breaks < first.end]
    grid = CollocationGrid(mesh(times, first.inputs(times), elements, breaks), gauss_scheme())
    guess = guess_on(grid, first)
    program = transcribe(ca, law_run, goal, grid, guess)
    answer = minimise(ca, program, called)
    values, stretch = solution(guess, answer.vector)
    stretched = CollocationGrid(grid.ends * stretch, grid.scheme)
    of_time = goal.minimised == "time"
    motion = motion_on(stretched, values)
    return SolvedMesh(law_run, answer, of_time, stretched.ends, values, motion)
