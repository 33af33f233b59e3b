"""Laws compared on the same members: what differs is the law, not the luck of the draw."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from certrack.core.errors import InputError, shorten
from certrack.core.heyoka import has_heyoka
from certrack.core.latex import latex_table
from certrack.studies.ensembles.ensemble import Ensemble, ensemble
from certrack.studies.ensembles.members import Members
from certrack.studies.ensembles.plan import METRICS
from certrack.studies.ensembles.statistics import binomial_interval
from certrack.systems.system import System, require_system

if TYPE_CHECKING:
    import pandas

#: Up to so many members compiling takes longer than computing.
QUICK_MEMBERS = 5000

#: Letters of the laws' names in one line.
MAX_LAW_NAMES = 300

#: Confidence of the intervals.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class PairedComparison:
    """Ensembles of the same members under different laws.

    Attributes
    ----------
    ensembles : pairs (name, Ensemble)
        The first one is what the others are compared with.
    """

    ensembles: tuple[tuple[str, Ensemble], ...]

    def __repr__(self) -> str:
        names = shorten(", ".join(name for name, _ in self.ensembles), MAX_LAW_NAMES)
        return f"PairedComparison({names} on {self.ensembles[0][1].members} members)"

    def frame(self) -> pandas.DataFrame:
        """All metrics as a tidy table: one row per member and law.

        Returns
        -------
        pandas.DataFrame
            Columns ``member``, ``law``, the metrics (NaN where one does not exist), ``outcome``.
        """
        import pandas

        parts = [each.frame().reset_index().assign(law=name) for name, each in self.ensembles]
        frame = pandas.concat(parts, ignore_index=True)
        return frame[["member", "law", *METRICS, "outcome"]]

    def pairs(self, metric: str = "tail_error") -> pandas.DataFrame:
        """One metric of every member under each law, and the differences from the first.

        Parameters
        ----------
        metric : str

        Returns
        -------
        pandas.DataFrame
            Index ``member``; a column per law, and ``NAME - FIRST`` for each law but the first.

        Raises
        ------
        InputError
            If there is no such metric.
        """
        import pandas

        if metric not in METRICS:
            raise InputError("metric", "must be one of " + ", ".join(METRICS), metric)
        row = METRICS.index(metric)
        values = {name: each.per_member()[0][row] for name, each in self.ensembles}
        (first, base), *others = values.items()
        table = values | {f"{name} - {first}": value - base for name, value in others}
        return pandas.DataFrame(table, index=pandas.RangeIndex(len(base), name="member"))

    def summary(self) -> pandas.DataFrame:
        """How each law but the first differs from the first, over the members that both finish.

        Returns
        -------
        pandas.DataFrame
            Index (metric, law). Columns: ``pairs`` of members; the medians ``first`` and ``law``;
            ``difference``, the median of the differences, and ``low`` and ``high``, its 95 %
            interval; ``smaller``, the share of pairs in which the law has the smaller value, and
            ``smaller_low`` and ``smaller_high``, its 95 % interval. The intervals need no
            assumption on the distribution but independent members; they are NaN without those.
        """
        import pandas

        (_, first), *others = self.ensembles
        base, rows, index = first.per_member()[0], [], []
        for row, metric in enumerate(METRICS):
            for name, each in others:
                values = np.array([base[row], each.per_member()[0][row]])
                values = values[:, np.isfinite(values).all(axis=0)]
                rows.append(_paired_statistics(*values, independent=each.independent))
                index.append((metric, name))
        names = pandas.MultiIndex.from_tuples(index, names=["metric", "law"])
        return pandas.DataFrame(rows, index=names)

    def latex(self, caption: str = "", label: str = "") -> str:
        """The summary as a LaTeX table."""
        frame = self.summary().drop(columns=["smaller_low", "smaller_high"])
        return latex_table(frame, caption=caption, label=label)


def paired(
    laws: Mapping[str, System | Ensemble], members: int = 1000, *, seed: int = 0, **options: Any
) -> PairedComparison:
    """Compare laws on the same members.

    Parameters
    ----------
    laws : mapping
        Two or more systems by the names of their laws, or ensembles of them that were computed
        before, with one seed and number of members. The population must be the same, so that
        member i has the same plant, start, disturbance and reference under every law.
    members, seed
        Of the ensembles of systems. They are computed without a limit, and up to 5000 members by
        the method that compiles fastest.
    **options
        Of :func:`certrack.ensemble`, for systems: tolerance, threads, method.

    Returns
    -------
    PairedComparison

    Raises
    ------
    InputError
        If the members are not the same, or their metrics were not kept.

    Examples
    --------
    >>> import certrack, dataclasses
    >>> system = certrack.load("example1")
    >>> faster = system.replace(law=dataclasses.replace(system.law, c=(2, 1)))
    >>> comparison = certrack.paired({"c = (1, 0.5)": system, "c = (2, 1)": faster}, 16)
    >>> comparison.frame().shape
    (32, 11)
    >>> bool(comparison.summary().loc[("tail_error", "c = (2, 1)"), "difference"] < 0)
    True
    """
    if not isinstance(laws, Mapping):
        remedy = 'Write {"mine": system, "other": another}'
        raise InputError("laws", "must be a mapping of names to systems", laws, remedy)
    for name, entry in laws.items():
        if not isinstance(entry, Ensemble):
            require_system(entry, f"laws[{name!r}]")
    if len(laws) < 2:
        raise InputError("laws", "must be at least two, by name")
    if members <= QUICK_MEMBERS and has_heyoka():
        options = {"method": "lockstep"} | options
    pairs = tuple(
        (
            name,
            ensemble(entry, members, seed=seed, limit=math.inf, per_member=True, **options)
            if isinstance(entry, System)
            else entry,
        )
        for name, entry in laws.items()
    )
    (first_name, first), *others = pairs
    for name, each in others:
        if reason := _why_not_same_members(first, each):
            raise InputError("laws", f"{first_name} and {name} have different {reason}")
    for _, each in pairs:
        each.per_member()
    return PairedComparison(pairs)


def _why_not_same_members(a: Ensemble, b: Ensemble) -> str:
    """What two ensembles do not share; empty if their members are the same."""
    if (a.seed, a.members) != (b.seed, b.members):
        return "seeds or numbers of members"
    if a.system.plant != b.system.plant or a.system.truth != b.system.truth:
        return "plants or truths"
    if a.system.settings.x0 != b.system.settings.x0:
        return "initial states (simulation.x0)"
    settings = [(s.duration, s.tail_start, s.band) for s in (a.system.settings, b.system.settings)]
    if settings[0] != settings[1]:
        return "durations, tails or bands (simulation)"
    if a.system.reference != b.system.reference:
        return "references"
    if a.system.varied.sampling != b.system.varied.sampling:
        return "samplings (ensemble.sampling)"
    columns = [Members(each.system, each.seed).columns for each in (a, b)]
    return "" if list(columns[0].items()) == list(columns[1].items()) else "populations"


def _paired_statistics(
    first: np.ndarray, law: np.ndarray, *, independent: bool
) -> dict[str, float]:
    """The columns of :meth:`PairedComparison.summary`."""
    count, differences = len(first), np.sort(law - first)
    nothing = (np.nan, np.nan)
    smaller = int((differences < 0).sum())
    share = binomial_interval(smaller, count, CONFIDENCE) if independent and count else nothing
    low, high = _median_interval(differences) if independent else nothing
    medians = [float(np.median(v)) if count else np.nan for v in (first, law, differences)]
    return {
        "pairs": count,
        "first": medians[0],
        "law": medians[1],
        "difference": medians[2],
        "low": low,
        "high": high,
        "smaller": smaller / count if count else np.nan,
        "smaller_low": share[0],
        "smaller_high": share[1],
    }


def _median_interval(ordered: np.ndarray) -> tuple[float, float]:
    """Order statistics that hold the median with the confidence, whatever the distribution."""
    from scipy.stats import binom

    count = len(ordered)
    below = int(binom.ppf((1 - CONFIDENCE) / 2, count, 0.5)) if count else 0
    if count == 0 or below < 1:  # too few pairs
        return np.nan, np.nan
    return float(ordered[below - 1]), float(ordered[count - below])
