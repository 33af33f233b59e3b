"""Lost starts: which start of a box does the loop not bring back?

The loop is that of the file, as implemented where it says so, with its reference and its true
constants. Starts of a box are run under the file's own disturbances and under uncertain terms at
their bounds: the corners, then random starts, then starts around those whose states are largest in
the second half of their run, since near the edge of what is brought back a run lingers. Between a
start that is lost and the middle of the box, the nearest lost one is bisected. What is found is run
once more, as the system that replays it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.integrators.base import Outcome
from certrack.simulation.run import Run
from certrack.simulation.simulator import Simulator, simulate
from certrack.studies.falsifier.linear.case import WITHIN_BOUND
from certrack.systems.system import System, require_system

#: Corners that are tried first: all of them up to this number of states.
MAX_CORNERED = 8

#: Of the starts after the corners, the part that is random; the others lie around the worst so far.
RANDOM_PART = 0.5

#: How far around the worst, in half widths of the box: from the first to the last.
FIRST_AROUND, LAST_AROUND = 0.5, 0.05

#: So many of the worst starts so far have others around them.
PARENTS = 4

#: How near the nearest lost start on a segment is, as a part of it; and how many are bisected.
NEAREST_PART, MAX_SEGMENTS = 1e-3, 4

#: tanh(x/width) is nearly the sign of x; the width over that of the box.
SIGN_PART = 0.01

#: A lost run counts more than any that is not.
SCORE_OF_LOST = math.inf

#: The file's own disturbances, as the name of a pattern; the others are named by their signs.
OWN_PATTERN, OUTWARD = "own", "outward"

#: Runs that may be asked for.
MAX_START_RUNS = 10**7


@dataclass(frozen=True)
class LostStart:
    """A start that the loop does not bring back.

    Attributes
    ----------
    x0 : floats
        The states at the start.
    part : float
        How far it is from the middle of the box, as a part of the way to the box's end.
    pattern : str
        ``"own"`` under the file's own disturbances; ``"+"``, ``"-"`` or ``"outward"`` with every
        uncertain term at its bound, of this sign or of that of its state.
    outcome : str
        How the run ended.
    time : float, s
        When.
    system : System
        Replays it.
    """

    x0: tuple[float, ...]
    part: float
    pattern: str
    outcome: str
    time: float
    system: System


@dataclass(frozen=True)
class LostStarts:
    """What a search of a box of starts gave.

    Attributes
    ----------
    box : pairs of floats
        Ends of every state.
    runs : int
        Runs that were spent.
    lost : int
        How many of them were lost, those of the bisection included.
    nearest : LostStart or None
        The one nearest to the middle; None where every run of the search came back, which proves
        nothing.
    largest : float
        The largest state that a run had that was not lost.
    gone : tuple of pairs
        Pattern and states at the start of every run that was lost.
    """

    box: tuple[tuple[float, float], ...]
    runs: int
    lost: int
    nearest: LostStart | None
    largest: float
    gone: tuple[tuple[str, tuple[float, ...]], ...] = ()


@one_blas_thread
def lost_starts(
    system: System,
    box: Sequence[tuple[float, float]] | None = None,
    *,
    budget: int = 600,
    seed: int = 0,
    progress: Progress = silent,
) -> LostStarts:
    """Search a box of starts for one from which the loop escapes.

    Parameters
    ----------
    system : System
        Run as it is, with its reference, true constants and ``[implementation]``.
    box : pairs of floats, optional
        Ends of every simulated state; default: the box of ``ensemble.x0``.
    budget : int
        About so many runs.
    seed : int
        Of the random starts.
    progress : callable
        Gets the runs so far, the budget and the largest state of those that came back.

    Returns
    -------
    LostStarts

    Raises
    ------
    InputError
        If there is no box, or it does not fit the states.

    Examples
    --------
    >>> import certrack
    >>> found = certrack.lost_starts(certrack.load("dual-motor-lean"), [(-1, 1)] * 4, budget=20)
    >>> found.nearest is None  # a linear loop that is stable brings all back
    True
    """
    require_system(system)
    checks.integer("budget", budget, 1, MAX_START_RUNS)
    checks.integer("seed", seed, 0, 2**63 - 1)
    search = _StartSearch(system, _checked_box(system, box), budget, progress)
    search.spend(np.random.default_rng(seed))
    return search.result()


def _checked_box(
    system: System, box: Sequence[tuple[float, float]] | None
) -> tuple[tuple[float, float], ...]:
    """The box that is searched."""
    names = system.simulated_states
    if box is None:
        drawn = system.varied.x0
        if drawn is None:
            raise InputError(
                "box",
                "there is no box of starts to search",
                remedy="State ensemble.x0, or give a range for each state: --box=-1:1,-2:2",
            )
        box = [(float(entry.low), float(entry.high)) for entry in drawn]
    ends = tuple((float(low), float(high)) for low, high in box)
    if len(ends) != len(names):
        raise InputError(
            "box", f"needs an interval for each of {', '.join(names)}, has {len(ends)}"
        )
    for name, (low, high) in zip(names, ends, strict=True):
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise InputError("box", f"of {name} needs finite ends, the low one first", [low, high])
        if max(-low, high) > system.settings.max_state:
            raise InputError("box", f"of {name} must be within simulation.max_state", [low, high])
    return ends


class _StartSearch:
    """Starts of a box, run one after the other."""

    def __init__(
        self,
        system: System,
        box: tuple[tuple[float, float], ...],
        budget: int,
        progress: Progress,
    ) -> None:
        self.box, self.budget, self.progress = box, budget, progress
        low, high = np.array(box).T
        self.middle, self.half = (low + high) / 2, (high - low) / 2
        self.templates = start_patterns(system, self.half)
        self.simulators = {name: Simulator(v) for name, v in self.templates.items()}
        self.runs, self.lost, self.largest = 0, 0, 0.0
        self.seen: list[tuple[float, str, np.ndarray]] = []  # score, pattern, place in the box

    def spend(self, rng: np.random.Generator) -> None:
        """Use the budget: corners, random starts, starts around the worst."""
        n, names = len(self.half), list(self.templates)
        places = [np.zeros(n)]
        if n <= MAX_CORNERED:
            places += [np.array(corner) for corner in product((-1.0, 1.0), repeat=n)]
        for place in places:
            for name in names:
                if self.runs < self.budget:
                    self._score(name, place)
        count = int((self.budget - self.runs) * RANDOM_PART)
        for i in range(count):
            self._score(names[i % len(names)], rng.uniform(-1, 1, n))
        left = self.budget - self.runs
        for i in range(left):
            width = FIRST_AROUND * (LAST_AROUND / FIRST_AROUND) ** (i / max(1, left - 1))
            best = sorted(self.seen, key=lambda entry: -entry[0])[:PARENTS]
            _, name, place = best[int(rng.integers(len(best)))]
            self._score(name, np.clip(place + width * rng.normal(size=n), -1, 1))

    def _case(self, name: str, place: np.ndarray) -> System:
        x0 = tuple((self.middle + self.half * place).tolist())
        return self.templates[name].with_settings(x0=x0)

    def _score(self, name: str, place: np.ndarray) -> bool:
        """Run a start; whether it is lost."""
        case, simulator = self._case(name, place), self.simulators[name]
        run = simulator.run(case) if simulator.serves(case) else simulate(case)
        self.runs += 1
        gone = is_lost(run)
        if gone:
            self.lost += 1
            score = SCORE_OF_LOST
        else:
            sizes = np.abs(run.x).max(axis=0)
            self.largest = max(self.largest, float(sizes.max()))
            score = float(sizes[run.t >= run.t[-1] / 2].max())
        self.seen.append((score, name, place))
        self.progress(min(self.runs, self.budget), self.budget, self.largest)
        return gone

    def result(self) -> LostStarts:
        """The nearest lost start, run as a system of its own."""
        gone = sorted(self._gone(), key=lambda entry: _part(entry[1]))
        nearer = [self._nearer(name, place) for name, place in gone[:MAX_SEGMENTS]]
        nearer.sort(key=lambda entry: _part(entry[1]))
        replays = (self._replayed(name, place) for name, place in nearer)
        nearest = next((start for start in replays if start is not None), None)
        lost = tuple((name, self._case(name, place).settings.x0) for name, place in self._gone())
        return LostStarts(self.box, self.runs, self.lost, nearest, self.largest, lost)

    def _gone(self) -> list[tuple[str, np.ndarray]]:
        """Pattern and place of every run that was lost so far."""
        return [(name, place) for score, name, place in self.seen if score == SCORE_OF_LOST]

    def _nearer(self, name: str, place: np.ndarray) -> tuple[str, np.ndarray]:
        """The nearest lost start that bisection finds between the middle and a lost one."""
        low, high = 0.0, 1.0
        while high - low > NEAREST_PART:
            part = (low + high) / 2
            low, high = (low, part) if self._score(name, part * place) else (part, high)
        return name, high * place

    def _replayed(self, name: str, place: np.ndarray) -> LostStart | None:
        case = self._case(name, place)
        case = case.replace(title=f"Lost start found for: {case.title}")
        run = simulate(case)
        if not is_lost(run):
            return None
        outcome, end = run.outcome.name, float(run.trajectory.times[-1])
        return LostStart(case.settings.x0, _part(place), name, outcome, end, case)


def _part(place: np.ndarray) -> float:
    """How far a place in the box is from its middle, over its half widths."""
    return float(np.abs(place).max(initial=0.0))


def is_lost(run: Run) -> bool:
    """Whether a run leaves what its states may reach, or what its formulas are defined for."""
    return run.outcome in (Outcome.escaped, Outcome.undefined)


def start_patterns(system: System, half: np.ndarray) -> dict[str, System]:
    """The system under its own disturbances, and under uncertain terms at their bounds."""
    templates, plant = {OWN_PATTERN: system}, system.plant
    u, names = plant.uncertainty, plant.states
    acting = [k for k in range(plant.n) if u.tau[k] > 0 and u.acts(k)]
    if system.truth.states or not acting or any(u.slowness(k) is not None for k in acting):
        return templates  # a bounded rate would not let these act from one moment to the next
    for pattern in ("+", "-", OUTWARD):
        omega = ["0"] * plant.n
        for k in acting:
            width = SIGN_PART * float(half[k]) or SIGN_PART
            sign = f"tanh({names[k]}/{width!r})" if pattern == OUTWARD else f"{pattern}1"
            omega[k] = f"{WITHIN_BOUND!r}*({sign})*({u.bound_formula(k, names, width)})"
        truth = replace(system.truth, omega=tuple(omega), tau=u.tau)  # type: ignore[arg-type]
        templates[pattern] = system.replace(truth=truth)
    return templates
