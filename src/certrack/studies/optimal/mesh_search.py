"""The search for one optimum: from the law's run, on meshes that grow finer.

Kinks of the plant in its states (abs, min, max and the sign of dry friction) have no slope that a
search could follow over them. They are therefore smoothed first, |a| by sqrt(a^2 + eps^2) and
sign(a) by a/sqrt(a^2 + eps^2), and eps falls from solution to solution, each from the one before.
A kink that is hardly smoothed wants short elements where it is passed: those that the plant leaves
are divided until it follows, before eps falls further.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from time import monotonic
from typing import Any

import numpy as np

from certrack.core.arrays import Array
from certrack.studies.optimal.collocation import CollocationGrid, gauss_scheme, radau_scheme
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

#: Elements that it leaves by so many times this are cut into four, others into two.
SPLIT_MORE = 10.0


@dataclass(frozen=True)
class SearchRoom:
    """How far a search may go.

    Attributes
    ----------
    ca : module
        ``casadi``.
    goal : Goal
    elements : int
        Of a mesh at most.
    ends_at : float, s
        Of :func:`time.monotonic`.
    called : callable
        Called at every iteration.
    """

    ca: Any
    goal: Goal
    elements: int
    ends_at: float
    called: Callable[[], None]

    @property
    def left(self) -> float:
        """Time that is left, s."""
        return self.ends_at - monotonic()

    @property
    def is_over(self) -> bool:
        """Whether no time is left."""
        return self.left <= 0


def finest(room: SearchRoom, law_run: LawRun) -> tuple[SolvedMesh, float | None]:
    """Search from the law's run, then from the optimum of each mesh on one twice as fine.

    Also the change of the minimum with the last mesh, relative; None of a single mesh. Kinks are as
    little smoothed as the plant follows. Where the time is over, it is the last one that was found.
    """
    law_run = replace(law_run, over_time=room.goal.minimised == "time")
    widths = SMOOTHINGS if law_run.has_kinks else (0.0,)
    best = _coarsest(room, replace(law_run, smoothing=widths[0]))
    if law_run.has_kinks:
        best = _followed(room, best)
    for smoothing in widths[1:]:
        if not best.is_optimum or room.is_over:
            break
        sharper = replace(law_run, smoothing=smoothing)
        first = solve_mesh(room, sharper, best.ends, best.motion, stiff=best.stiff)
        solved = _followed(room, first)
        if not solved.is_optimum:
            break
        best = solved
    return _refined(room, best)


def _followed(room: SearchRoom, search: SolvedMesh) -> SolvedMesh:
    """The optimum where elements that the plant leaves too far are halved or quartered."""
    while search.answer.converged and not search.is_followed and not room.is_over:
        defects = search.played.defects
        parts = np.where(defects > SPLIT_MORE * FOLLOWED, 4, np.where(defects > FOLLOWED, 2, 1))
        if parts.sum() > room.elements:
            break
        ends, stiff = _divided(search.ends, parts), search.law_run.has_jumping_rates
        finer = solve_mesh(room, search.law_run, ends, search.motion, stiff=stiff)
        if not finer.answer.converged:
            break
        search = finer
    return search


def _divided(ends: Array, parts: Array) -> Array:
    """Ends of elements, each cut into so many equal ones."""
    pieces = [
        np.linspace(a, b, count, endpoint=False)
        for a, b, count in zip(ends[:-1], ends[1:], parts, strict=True)
    ]
    return np.append(np.concatenate(pieces), ends[-1])


def _refined(room: SearchRoom, search: SolvedMesh) -> tuple[SolvedMesh, float | None]:
    """The optimum of the finest mesh, and the change of the minimum with it."""
    change: float | None = None
    count = search.elements if search.law_run.smoothing else FIRST_ELEMENTS
    while search.answer.converged and count < room.elements and not room.is_over:
        settled = change is not None and change < MINIMUM_CHANGE
        if settled and search.is_followed:
            break
        count = min(2 * count, room.elements)
        ends = mesh_of(search.law_run, search.motion, count)
        finer = solve_mesh(room, search.law_run, ends, search.motion, stiff=search.stiff)
        if search.law_run.smoothing:
            finer = _followed(room, finer)
        if not finer.answer.converged or (search.is_followed and not finer.is_followed):
            break  # a coarser optimum is one, too
        floor = max(abs(search.minimum), abs(finer.minimum), NEGLIGIBLE_MINIMUM)
        search, change = finer, abs(finer.minimum - search.minimum) / floor
    return search, change


def _coarsest(room: SearchRoom, law_run: LawRun) -> SolvedMesh:
    """The first mesh; the shortest time is sought within the law's, then within the horizon."""
    ends = [law_run.horizon]
    if room.goal.minimised == "time" and 0 < law_run.law.time < law_run.horizon:
        ends.insert(0, law_run.law.time)
    for end in ends:
        motion = PlantMotion(law_run.states, law_run.inputs, end)
        search = solve_mesh(room, law_run, mesh_of(law_run, motion, FIRST_ELEMENTS), motion)
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
    stiff : bool
        Whether by Radau's points: what the plant does not follow by those of Gauss may be stiff.
    """

    law_run: LawRun
    answer: SolverAnswer
    of_time: bool
    ends: Array
    values: GridValues
    motion: PlantMotion
    stiff: bool = False

    @property
    def elements(self) -> int:
        """Their number."""
        return len(self.ends) - 1

    @property
    def is_followed(self) -> bool:
        """Whether the plant follows it."""
        return self.played.deviation <= FOLLOWED

    @property
    def is_optimum(self) -> bool:
        """Whether a search ended here, and the plant follows it."""
        return self.answer.converged and self.is_followed

    @property
    def minimum(self) -> float:
        """What was minimised, over a unit of its own; the time itself."""
        return self.motion.end if self.of_time else self.answer.minimum

    @cached_property
    def played(self) -> Replay:
        """What the plant does with the input found."""
        values = self.values
        return replay(self.law_run, self.ends, values.inputs, values.begins, self.of_time)


def mesh_of(law_run: LawRun, motion: PlantMotion, elements: int) -> Array:
    """The ends of about so many elements, dense where the input of a motion moves."""
    times = np.linspace(0.0, motion.end, MESH_SAMPLES)
    breaks = law_run.breaks[law_run.breaks < motion.end]
    return mesh(times, motion.inputs(times), elements, breaks)


def solve_mesh(
    room: SearchRoom, law_run: LawRun, ends: Array, first: PlantMotion, *, stiff: bool = False
) -> SolvedMesh:
    """Solve on a mesh, from a motion."""
    grid = CollocationGrid(ends, radau_scheme() if stiff else gauss_scheme())
    guess = guess_on(grid, first)
    program = transcribe(room.ca, law_run, room.goal, grid, guess)
    answer = minimise(room.ca, program, room.called, room.left)
    values, stretch = solution(guess, answer.vector)
    stretched = CollocationGrid(grid.ends * stretch, grid.scheme)
    of_time = room.goal.minimised == "time"
    motion = motion_on(stretched, values)
    return SolvedMesh(law_run, answer, of_time, stretched.ends, values, motion, stiff)
