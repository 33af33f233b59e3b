"""What is to be computed of an ensemble: what every worker needs to know."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from certrack.core.memo import remembered
from certrack.loops.plant import measured
from certrack.model.distribution import Distribution
from certrack.model.disturbance import family_of
from certrack.simulation.metrics import Metrics
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.ensembles.member_table import MemberTable
from certrack.studies.ensembles.statistics import Bands, Statistics, Tally
from certrack.systems.system import System
from certrack.systems.writer import to_text

#: The metrics of a member, as those of a single run.
METRICS = tuple(entry.name for entry in fields(Metrics) if entry.name not in ("band", "tail_start"))

METHODS = ("native", "implicit", "lockstep", "alone")

#: Raised by every change after which a member has other numbers or is counted otherwise. Folders of
#: finished chunks record it, so that none is filled by two revisions.
REVISION = 4

Range = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Plan:
    """What workers need to know.

    Attributes
    ----------
    system : System
    seed : int
    tolerance : float
    limit : float, optional
        Limit of the tail error.
    centre : (R, T) array
        e_1, the states of the design and u of the nominal run on the time grid.
    scale : (R,) array
        Their magnitudes, powers of two.
    method : {"native", "implicit", "lockstep", "alone"}
        Compiled C, with explicit or with linearly implicit steps; heyoka's compiled maps; or each
        member by itself, by the ordinary simulation.
    per_member : bool
        Whether the metrics of every member are kept.
    """

    system: System
    seed: int
    tolerance: float
    limit: float | None
    centre: np.ndarray
    scale: np.ndarray
    method: str
    per_member: bool = False

    @cached_property
    def key(self) -> bytes:
        """Equal for equal plans."""
        text = f"{to_text(self.system)} {self.seed} {self.tolerance!r} {self.limit!r} {self.method}"
        text += f" {self.per_member}"
        return text.encode() + self.centre.tobytes() + self.scale.tobytes()

    @property
    def registered(self) -> tuple[object, ...]:
        """What the names of law, reference and disturbances stand for: they can be taken anew."""
        system = self.system
        return type(system.law), system.reference, type(family_of(system.varied))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Plan) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def empty(self, bands: Bands | None = None) -> Statistics:
        """Statistics of no members; `bands` in which nothing is counted may be given."""
        metrics = {name: Tally() for name in METRICS}
        table = MemberTable() if self.per_member else None
        return Statistics(bands or Bands(self.centre, self.scale), metrics, table=table)


def make_plan(
    system: System,
    seed: int,
    tolerance: float,
    limit: float | None,
    method: str,
    *,
    per_member: bool = False,
) -> Plan:
    """A plan around the nominal run, the one of the system itself."""
    return Plan(system, seed, tolerance, limit, *_centre_and_scale(system), method, per_member)


@remembered
def _centre_and_scale(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Signals of the nominal run on the time grid, and their magnitudes, powers of two."""
    run = simulate(system)
    centre = signals_of(run, band_times(system))
    centre[0] = 0.0  # the error has a natural zero
    with np.errstate(invalid="ignore"):
        largest = np.nanmax(np.abs(signals_of(run, run.t)), axis=1)
        if system.varied.x0:
            reach = np.abs(measured(system, _extreme_points(system.varied.x0))).max(axis=1)
            largest[1:-1] = np.fmax(largest[1:-1], reach)
    largest[0] = np.fmax(largest[0], largest[1])
    largest[~(largest > 0)] = 1.0
    scale = np.exp2(np.rint(np.log2(largest)))
    centre = np.nan_to_num(centre)
    for values in (centre, scale):
        values.setflags(write=False)  # they are handed out again
    return centre, scale


def _extreme_points(entries: tuple[Distribution, ...]) -> np.ndarray:
    """Points at the ends of the distributions, one column each: all but one at the same end."""
    low, high = ([getattr(entry, end) for entry in entries] for end in ("low", "high"))
    one = np.eye(len(entries), dtype=bool)
    return np.concatenate([np.where(one, low, high), np.where(one, high, low)]).T


def band_times(system: System) -> np.ndarray:
    """Times of the bands, s."""
    return np.linspace(0.0, system.settings.duration, system.varied.points + 1)


def signals_of(run: Run, t: np.ndarray) -> np.ndarray:
    """e_1, the states of the design and u of a run; NaN after its end."""
    n = run.system.plant.n
    inside = t <= run.trajectory.end
    signals = np.full((n + 2, len(t)), np.nan)
    states = run.trajectory.interpolate(t[inside])
    signals[1 : n + 1, inside] = measured(run.system, states)
    signals[0, inside] = signals[1, inside] - run.system.reference.values(t[inside], 0)[0]
    signals[n + 1, inside] = run.input_of(t[inside], states)
    return signals
