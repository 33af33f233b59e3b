"""Run an ensemble: cut the members into chunks, have them computed, merge, report."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from certrack.certificates.implemented.certify import ImplementedCertificate
from certrack.core import checks
from certrack.core.errors import InputError, shorten
from certrack.core.notebook import ShownInNotebooks
from certrack.core.progress import Progress, silent
from certrack.integrators.base import MethodUnavailable, Outcome
from certrack.model.sampling import MAX_MEMBERS
from certrack.simulation.run import Run
from certrack.studies.ensembles import workers
from certrack.studies.ensembles.checkpoints import Checkpoints
from certrack.studies.ensembles.completion import complete, complete_corners
from certrack.studies.ensembles.corners import Corners
from certrack.studies.ensembles.engine import Engine, fastest
from certrack.studies.ensembles.error_limit import limit_and_starts, started_inside
from certrack.studies.ensembles.member_table import KEPT_MEMBERS
from certrack.studies.ensembles.members import Members, members_of
from certrack.studies.ensembles.plan import METHODS, METRICS, Plan, band_times, make_plan
from certrack.studies.ensembles.statistics import LEVELS, Statistics, binomial_interval
from certrack.systems.system import System, require_system

if TYPE_CHECKING:
    import pandas
    import xarray

#: More members at a time than this would fill the memory.
MAX_CHUNK_MEMBERS = 2**24

#: More threads than this are a slip.
MAX_THREADS = 1024

#: Integrators cannot be more accurate than this; with less accuracy metrics mean nothing.
MIN_TOLERANCE, MAX_TOLERANCE = 1e-13, 1e-2


@dataclass(frozen=True)
class Ensemble(ShownInNotebooks):
    """Statistics of many members.

    Attributes
    ----------
    system : System
    seed : int
    statistics : Statistics
    limit : float, optional
        A member whose tail error exceeds it, or that does not finish, is a violation.
    limit_origin : str
        Where the limit comes from, or why there is none.
    computed : int
        Members computed by this call; the others were on disk.
    seconds : float
        Integration and statistics of the computed ones, without start-up and compilation.
    corners : Corners or None
        The corners of plant.ranges, which run besides the members and are counted in nothing
        else; None where nothing has a range, or more than six have.
    proven : ImplementedCertificate, optional
        Of a drive with limits of its input: whose starts the limit is proven for. Members that
        start elsewhere are counted apart.
    """

    system: System
    seed: int
    statistics: Statistics
    limit: float | None
    limit_origin: str
    computed: int
    seconds: float
    corners: Corners | None = None
    proven: ImplementedCertificate | None = None

    def __repr__(self) -> str:
        tail = self.statistics.metrics["tail_error"]
        median, largest = (
            "-" if value is None else f"{value:.5g}"
            for value in (tail.quantile(0.5), tail.summary()["max"])
        )
        figures = f"tail error: median {median}, largest {largest}"
        if self.limit is not None:
            figures += f"; {self._violations['count']} beyond {self.limit:.5g}"
        title = shorten(self.system.title)
        return f"Ensemble({title!r}: {self.members} members, seed {self.seed}; {figures})"

    @cached_property
    def _members(self) -> Members:
        return members_of(self.system, self.seed)

    @property
    def members(self) -> int:
        """Number of members."""
        return self.statistics.members

    @property
    def t(self) -> np.ndarray:
        """Times of the bands, s."""
        return band_times(self.system)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals of the bands."""
        return ("e_1", *self.system.plant.states, "u")

    def member(self, index: int) -> System:
        """Member `index` as a system of its own.

        Parameters
        ----------
        index : int

        Returns
        -------
        System

        Examples
        --------
        >>> import certrack
        >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
        >>> result.member(3).truth == result.member(4).truth
        False
        """
        return self._members.member(index)

    def run(self, index: int) -> Run:
        """The full run of member `index`; all members share one compiled simulator.

        Parameters
        ----------
        index : int

        Returns
        -------
        Run

        Examples
        --------
        >>> import certrack
        >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
        >>> result.run(3).outcome.name
        'finished'
        """
        return self._members.run(index)

    def per_member(self) -> tuple[np.ndarray, np.ndarray]:
        """Metrics of every member (M, N), in the order of METRICS, and their outcomes (N,).

        NaN for a member that did not finish; the outcomes are positions in
        :class:`certrack.Outcome`.

        Raises
        ------
        InputError
            If they were not kept.
        """
        table = self.statistics.table
        arrays = None if table is None else table.arrays(self.members)
        if arrays is None:
            remedy = "Call ensemble(..., per_member=True)"
            raise InputError(
                "per_member", "the metrics of single members were not kept", None, remedy
            )
        return arrays

    def frame(self, *, draws: bool = False) -> pandas.DataFrame:
        """Metrics of every member as a tidy table: one row per member.

        Parameters
        ----------
        draws : bool
            Add the numbers that were drawn for each member, by their names.

        Returns
        -------
        pandas.DataFrame
            Index ``member``; a column per metric, NaN where it does not exist; ``outcome``.

        Raises
        ------
        InputError
            If the metrics of single members were not kept.

        Examples
        --------
        >>> import certrack
        >>> found = certrack.ensemble(certrack.load("example1"), 8, method="lockstep")
        >>> found.frame().shape
        (8, 9)
        """
        import pandas

        metrics, outcomes = self.per_member()
        columns: dict[str, Any] = dict(zip(METRICS, metrics, strict=True))
        columns["outcome"] = np.array([outcome.name for outcome in Outcome])[outcomes]
        if draws:
            columns |= self._members.draws(0, self.members)
        return pandas.DataFrame(columns, index=pandas.RangeIndex(self.members, name="member"))

    @property
    def independent(self) -> bool:
        """Whether the members are independent, which the binomial interval rests on."""
        return self.system.varied.sampling == "plain"

    @cached_property
    def bands(self) -> np.ndarray:
        """Quantiles of every signal, shape (levels, signals, times)."""
        return self.statistics.bands.quantiles(LEVELS)

    def violations(self) -> dict[str, Any] | None:
        """Violations of the limit with their probability and its 95 % interval.

        Where the limit is proven for some starts only, `count`, `probability` and `interval` are
        of the `started_inside` members, and `others` of the rest are beyond it, which is no
        violation. Without the metrics of single members all are counted.
        """
        return None if self.limit is None else dict(self._violations)

    @cached_property
    def _violations(self) -> dict[str, Any]:
        assert self.limit is not None
        count, total, apart = self.statistics.violations, self.members, {}
        table = self.statistics.table
        arrays = None if table is None else table.arrays(self.members)
        if self.proven is not None and arrays is not None:
            beyond = ~(arrays[0][METRICS.index("tail_error")] <= self.limit)
            inside = started_inside(self.system, self.proven, self._members.draws(0, self.members))
            count, total = int((beyond & inside).sum()), int(inside.sum())
            apart = {"started_inside": total, "others": int((beyond & ~inside).sum())}
        interval = binomial_interval(count, total) if self.independent and total else None
        return {
            "limit": self.limit,
            "origin": self.limit_origin,
            "count": count,
            "probability": count / total if total else None,
            "interval": None if interval is None else list(interval),
        } | apart

    def summary(self) -> dict[str, Any]:
        """Ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> import certrack
        >>> system = certrack.load("example1")
        >>> certrack.ensemble(system, members=64, method="lockstep").summary()["outcomes"]
        {'finished': 64}
        """
        statistics = self.statistics
        metrics = {name: tally.summary() for name, tally in statistics.metrics.items()}
        worst = [{"member": index, "tail_error": value} for value, index in statistics.worst]
        tail = metrics.pop("tail_error") | {"worst_member": worst[0]["member"]}
        return {
            "members": self.members,
            "seed": self.seed,
            "sampling": self.system.varied.sampling,
            "disturbance": self.system.varied.disturbance,
            "tail_error": tail,
            "violations": self.violations(),
            "outcomes": {name: statistics.outcomes[name] for name in sorted(statistics.outcomes)},
            "corners": None if self.corners is None else self.corners.summary(),
            "metrics": metrics,
            "worst": worst,
            "computed": self.computed,
            "microseconds_per_member": 1e6 * self.seconds / self.computed
            if self.computed
            else None,
        }

    def dataset(self) -> xarray.Dataset:
        """Quantile bands with labels and units.

        Returns
        -------
        xarray.Dataset

        Examples
        --------
        >>> import certrack
        >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
        >>> result.dataset().quantiles.dims
        ('level', 'signal', 'time')
        """
        import xarray

        units = self.system.plant.units or ("1",) * (self.system.plant.n + 1)
        return xarray.Dataset(
            {"quantiles": (("level", "signal", "time"), self.bands)},
            {
                "level": list(LEVELS),
                "signal": list(self.signals),
                "signal_units": ("signal", [units[0], *units]),
                "time": ("time", self.t, {"units": "s"}),
            },
            {"title": self.system.title, "members": self.members, "seed": self.seed},
        )


def ensemble(
    system: System,
    members: int = 10_000,
    *,
    seed: int = 0,
    tolerance: float = 1e-6,
    limit: float | None = None,
    threads: int | None = None,
    method: str | None = None,
    chunk: int | None = None,
    out: Path | str | None = None,
    client: Any = None,
    per_member: bool | None = None,
    progress: Progress = silent,
) -> Ensemble:
    """Simulate many members of a system's population and keep their statistics.

    The result depends on the system, the number of members, the seed and the tolerance alone, not
    on threads, chunks or interruptions.

    Parameters
    ----------
    system : System
        Its population says what varies; by default the plant's ranges and, within the bounds of
        its uncertainty, the disturbances.
    members : int
    seed : int
    tolerance : float
        Of the integrator; statistics seldom need more than the default.
    limit : float, optional
        Of the tail error; by default the population's, else the certified bound where the
        population is within the certificate's assumptions; inf for none, which saves the time of
        the certificate.
    threads : int, optional
        By default one per core.
    method : {"native", "implicit", "lockstep", "alone"}, optional
        Compiled C, with explicit or with linearly implicit steps; heyoka's compiled maps; or each
        member by itself as in :func:`simulate`. By default the first that this machine has, with
        implicit steps where the loop is so stiff that they are fewer than half as many. All agree
        within the tolerance.
    chunk : int, optional
        Members computed at a time; by default 16,384, on a cluster up to four times as many, where
        every worker still gets several chunks.
    out : path, optional
        Folder where finished chunks are kept. The same call goes on where a stopped one was.
    client : distributed.Client, optional
        Compute on its Dask cluster.
    per_member : bool, optional
        Keep the metrics of every member, for :meth:`Ensemble.frame` and :func:`certrack.paired`; by
        default where there are at most 100,000.
    progress : callable
        Gets the members done, their number in all and the largest tail error. Where it raises,
        finished chunks stay in `out`.

    Returns
    -------
    Ensemble

    Raises
    ------
    InputError
        If an argument does not fit or the folder cannot be written.
    AllMembersLost
        If none of the first 256 members finishes, and more were asked for.

    Examples
    --------
    >>> import certrack
    >>> result = certrack.ensemble(certrack.load("example1"), members=64)
    >>> result.members, result.violations()["count"]
    (64, 0)
    """
    require_system(system)
    checks.integer("members", members, 1, MAX_MEMBERS)
    checks.integer("seed", seed, 0, 2**63)
    if chunk is not None:
        checks.integer("chunk", chunk, 1, MAX_CHUNK_MEMBERS)
    if threads is not None:
        checks.integer("threads", threads, 1, MAX_THREADS)
    if method is not None:
        checks.choice("method", method, METHODS)
    checks.real("tolerance", tolerance, least=MIN_TOLERANCE)
    if tolerance > MAX_TOLERANCE:
        raise InputError("tolerance", f"must be at most {MAX_TOLERANCE:g}", tolerance)
    limit, origin, proven = limit_and_starts(system, limit)
    per_member = members <= KEPT_MEMBERS if per_member is None else per_member
    plan = make_plan(system, seed, tolerance, limit, method or METHODS[0], per_member=per_member)
    plan, engine = _prepared(plan, method, threads, client)
    chunk = chunk or workers.chunk_members(plan, members, client)
    total = plan.empty()
    with ExitStack() as stack:
        checkpoints = None if out is None else stack.enter_context(Checkpoints(Path(out), plan))
        wanted, seconds = complete(
            plan, engine, client, total, checkpoints, members, chunk, progress
        )
        at_corners = complete_corners(plan, engine, client, checkpoints)
    corners = None if at_corners is None else Corners.of(system, at_corners, limit)
    return Ensemble(system, seed, total, limit, origin, wanted, seconds, corners, proven)


def _prepared(
    plan: Plan, method: str | None, threads: int | None, client: Any
) -> tuple[Plan, Engine | None]:
    """The plan, and its engine unless a cluster computes; the first method that works."""
    cores = threads or workers.cores()
    try:
        engine = Engine(plan, cores) if method else fastest(plan, cores)
    except MethodUnavailable as reason:
        raise InputError("method", str(reason), method, "Leave it out") from None
    return engine.plan, None if client is not None else engine
