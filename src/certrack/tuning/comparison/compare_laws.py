"""Laws side by side on one system: tuned by one search, in one set of limits, measured alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import CertrackError, InputError
from certrack.core.keys import keys_of
from certrack.core.progress import Progress, silent
from certrack.laws.base import Law
from certrack.model.implementation import USUAL_PERIOD
from certrack.simulation.metrics import Metrics
from certrack.studies.ensembles.ensemble import Ensemble, ensemble
from certrack.systems.system import System, require_system
from certrack.tuning.certified import certified_or_why
from certrack.tuning.comparison.entrants import entrant_of, with_input_limit
from certrack.tuning.comparison.gain_search import FoundGains, search_gains
from certrack.tuning.comparison.known_gains import KnownGains
from certrack.tuning.comparison.trials import (
    PEAK,
    SharedLimits,
    Trials,
    resting_error,
    sampled,
    score,
)
from certrack.tuning.runs import WORSE

#: At so many times the period a law must still work.
PERIODS_HELD = 3.0

#: The input's variation may be so many times that of the file's own law.
VARIATION_FACTOR = 10.0

#: A search aims at this part of the peak's limit: it looks at some starts of the box only.
AIMED_PEAK = 0.95

#: The true input gain is so many times as large in two runs of each law.
GAIN_FACTORS = (0.7, 1.3)

#: Longest periods are looked for up to so many times the file's, by so many halvings.
LONGEST_FACTOR, PERIOD_HALVINGS = 4096, 5

#: Name of the file's own law, with its own gains, in the table.
AS_STATED = "as stated"

#: What a law without working gains is said to have.
NOTHING_FOUND = "no stabilising gains found"

#: What is said instead of a law whose gains are the file's.
DOES_NOT_FOLLOW = "follows no better than an output at rest"

#: Kind of the certificate of the loop as it is sampled; all others are of the continuous one.
OF_THE_SAMPLED_LOOP = "implemented"


@dataclass(frozen=True)
class LawFigures:
    """One law of a comparison.

    Attributes
    ----------
    name : str
    system : System
        With the law, sampled, and with what the law knows of the plant.
    searched : FoundGains or None
        None of the file's own gains.
    works : bool
        Whether all runs finish, with an error below that of an output that stays.
    exceeded : tuple of str
        Limits that are not kept.
    metrics : Metrics or None
        Of the file's run.
    peak_input : float
        The largest found over the box of starts.
    longest_period : float
        Up to which the error is at most :data:`WORSE` times as large, by simulation.
    at_gains : tuple of float
        Tail errors at :data:`GAIN_FACTORS`; inf where the run is lost, NaN where there is none.
    members : Ensemble or None
    bound : float
        The best verified bound of limsup \\|e_1\\|; inf if there is none.
    bound_note : str
        Its kind, or why there is none.
    bound_starts : str
        From which starts it holds, in words; empty for all.
    """

    name: str
    system: System
    searched: FoundGains | None
    works: bool
    exceeded: tuple[str, ...] = ()
    metrics: Metrics | None = None
    peak_input: float = math.nan
    longest_period: float = math.nan
    at_gains: tuple[float, ...] = ()
    members: Ensemble | None = None
    bound: float = math.inf
    bound_note: str = ""
    bound_starts: str = ""

    @property
    def worst_member(self) -> float | None:
        """The largest tail error of the members; None if one does not finish."""
        if self.members is None:
            return None
        tail = self.members.statistics.metrics["tail_error"].summary()
        return None if tail["missing"] else tail["max"]

    @property
    def why_not(self) -> str:
        """What is said where it does not work."""
        return DOES_NOT_FOLLOW if self.searched is None else NOTHING_FOUND

    @property
    def bound_is_continuous(self) -> bool:
        """Whether the bound is of the loop in continuous time, not of the sampled one."""
        return math.isfinite(self.bound) and self.bound_note != OF_THE_SAMPLED_LOOP

    def gains(self) -> dict[str, Any]:
        """The law's numbers, by key."""
        return {
            name: getattr(self.system.law, name)
            for name, key in keys_of(self.system.law).items()
            if getattr(self.system.law, name) not in (None, ()) and key.kind != "flag"
        }

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        if not self.works or self.metrics is None:
            tried = None if self.searched is None else self.searched.evaluations
            return {"note": self.why_not, "gains": self._plain_gains(), "evaluations": tried}
        members = self.members
        statistics = {} if members is None else members.statistics.metrics["tail_error"].summary()
        return {
            "tail_error": self.metrics.tail_error,
            "worst_member": self.worst_member,
            "members": statistics,
            "settling_time": self.metrics.settling_time,
            "peak_input": self.peak_input,
            "energy": self.metrics.input_energy,
            "input_variation": self.metrics.input_variation,
            "longest_period": self.longest_period,
            "at_gains": dict(zip(map(str, GAIN_FACTORS), self.at_gains, strict=True)),
            "bound": self.bound,
            "bound_note": self.bound_note,
            "bound_starts": self.bound_starts,
            "bound_of_continuous_loop": self.bound_is_continuous,
            "exceeded": list(self.exceeded),
            "gains": self._plain_gains(),
            "evaluations": None if self.searched is None else self.searched.evaluations,
        }

    def _plain_gains(self) -> dict[str, Any]:
        gains = self.gains()
        return {
            name: asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
            for name, value in gains.items()
        }


@dataclass(frozen=True)
class LawComparison:
    """Result of :func:`compare_laws`.

    Attributes
    ----------
    system : System
        As sampled.
    limits : SharedLimits
    laws : tuple of LawFigures
        That of the file as it stands first.
    budget, seed, member_count : int
    """

    system: System
    limits: SharedLimits
    laws: tuple[LawFigures, ...]
    budget: int
    seed: int
    member_count: int

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        limits = self.limits
        return {
            "limits": {
                "peak_input": limits.peak_input,
                "input_variation": limits.input_variation,
                "period": limits.period,
            },
            "laws": {figures.name: figures.summary() for figures in self.laws},
            "evaluations": self.budget,
            "seed": self.seed,
            "members": self.member_count,
        }


@one_blas_thread
def compare_laws(
    system: System,
    laws: Sequence[str],
    *,
    peak_input: float | None = None,
    variation: float | None = None,
    period: float | None = None,
    budget: int = 150,
    members: int = 1000,
    seed: int = 0,
    known: KnownGains | None = None,
    progress: Progress = silent,
) -> LawComparison:
    """Tune laws for one system by one search within one set of limits, and measure them alike.

    The tail error of the file's run is made as small as the limits allow. Every law is sampled as
    the file says, knows what the file's law knows (or guesses), and gets as many evaluations.

    Parameters
    ----------
    system : System
    laws : names of :data:`certrack.tuning.comparison.entrants.ENTRANTS`
    peak_input : float, optional
        Limit of \\|u\\| over the box of starts; what the file's own law needs if left out.
    variation : float, optional
        Limit of the variation of the input; ten times that of the file's own law if left out.
    period : float, optional, s
        Held so long a law must still work; three times the file's period if left out.
    budget : int
        Evaluations for each law.
    members : int
        Of the ensemble that measures each.
    seed : int
        Of search and ensemble.
    known : KnownGains, optional
        Gains of an earlier comparison, to be measured anew and not searched. Then its limits,
        budget and seed hold, and none are given.
    progress : callable

    Returns
    -------
    LawComparison

    Raises
    ------
    InputError
        If a law is unknown or cannot be made for this plant, or has no known gains.
    MissingExtra
        If nothing solves the plans of ``mpc``.
    """
    require_system(system)
    checks.integer("evaluations", budget, 10, 100_000)
    checks.integer("members", members, 2, 100_000)
    for name, value in (("peak_input", peak_input), ("variation", variation), ("period", period)):
        if value is not None:
            checks.real(name, value, above=0)
    if known is not None:
        limits = known.limits
        peak_input, variation, period = limits.peak_input, limits.input_variation, limits.period
        budget, seed = known.budget, known.seed
    entrants = {name: entrant_of(sampled(system, USUAL_PERIOD), name) for name in laws}
    base = sampled(system, USUAL_PERIOD)
    measure = _Measure(base, members, seed)
    stated = measure.trials_of(base)
    stated.order_starts(base.law)
    run = stated.metrics(base.law)
    if run is None:
        raise InputError("laws", "the file's own law does not reach the end of its run")
    assert base.implementation is not None
    limits = SharedLimits(
        peak_input=max(run.peak_input, stated.peak(base.law)) if peak_input is None else peak_input,
        input_variation=VARIATION_FACTOR * run.input_variation if variation is None else variation,
        period=PERIODS_HELD * base.implementation.period if period is None else period,
    )
    aimed = replace(limits, peak_input=AIMED_PEAK * limits.peak_input)
    entrants = {
        name: with_input_limit(entrant, family, aimed.peak_input)
        for name, (entrant, family) in entrants.items()
    }
    laws_known = {} if known is None else {n: known.law(n, e.law) for n, (e, _) in entrants.items()}
    total = len(entrants) + 1
    progress(0, total, None)
    rows = [measure.figures(AS_STATED, stated, base.law, limits, None)]
    for i, (name, (entrant, family)) in enumerate(entrants.items()):
        progress(i + 1, total, None)
        trials = measure.trials_of(entrant)
        trials.starts = list(stated.starts)
        if known is None:
            searched = search_gains(trials, family, aimed, measure.resting, budget, seed)
        else:
            again = score(trials, laws_known[name], aimed, measure.resting)
            searched = FoundGains(laws_known[name], again, known.evaluations[name])
        rows.append(measure.figures(name, trials, searched.law, limits, searched))
    progress(total, total, None)
    return LawComparison(base, limits, tuple(rows), budget, seed, members)


class _Measure:
    """The figures of any law, all measured in the same way."""

    def __init__(self, system: System, members: int, seed: int) -> None:
        self._system, self._members, self._seed = system, members, seed
        population = system.population
        self._box: np.ndarray | None = None
        if population is not None and population.x0 is not None:
            self._box = np.array([(entry.low, entry.high) for entry in population.x0], dtype=float)
        self.resting = resting_error(system)

    def trials_of(self, system: System) -> Trials:
        """The runs of one law."""
        return Trials(system, self._box)

    def figures(
        self, name: str, trials: Trials, law: Law, limits: SharedLimits, searched: FoundGains | None
    ) -> LawFigures:
        """All of one law."""
        system = trials.system.replace(law=law)
        metrics = trials.metrics(law)
        works = metrics is not None and metrics.tail_error < self.resting
        if not works or metrics is None or (searched is not None and not searched.score.works):
            return LawFigures(name, system, searched, works=False)
        group = ensemble(system, self._members, seed=self._seed, limit=self.resting)
        of_members = group.statistics.metrics["peak_input"].summary()
        member_peak = math.inf if of_members["missing"] else float(of_members["max"] or math.inf)
        peak = max(metrics.peak_input, trials.peak(law), member_peak)
        exceeded = () if searched is None else searched.score.exceeded
        exceeded = tuple(name for name in exceeded if name != PEAK)  # of what was aimed at
        if peak > limits.peak_input and searched is not None:
            exceeded = (PEAK, *exceeded)
        bound, note, starts = self._bound(system)
        return LawFigures(
            name,
            system,
            searched,
            works=True,
            exceeded=exceeded,
            metrics=metrics,
            peak_input=peak,
            longest_period=_longest_period(trials, law, metrics.tail_error),
            at_gains=tuple(_tail(trials.with_gain(law, factor)) for factor in GAIN_FACTORS),
            members=group,
            bound=bound,
            bound_note=note,
            bound_starts=starts,
        )

    def _bound(self, system: System) -> tuple[float, str, str]:
        """The best verified bound, its kind or why there is none, and from which starts."""
        if system.plant != self._system.plant:
            return math.inf, "rests on guesses of g_n and theta", ""
        try:
            proven = certified_or_why(system)
        except CertrackError as refusal:
            return math.inf, str(refusal), ""
        best = proven.best
        if best.verified and math.isfinite(best.bound):
            return best.bound, best.kind, proven.starts
        return math.inf, best.reason, ""


def _tail(metrics: Metrics | None) -> float:
    return math.inf if metrics is None else metrics.tail_error


def _longest_period(trials: Trials, law: Law, tail: float) -> float:
    """The longest period at which the tail error is at most :data:`WORSE` times as large."""
    drive = trials.system.implementation
    assert drive is not None

    def works(period: float) -> bool:
        return _tail(trials.metrics(law, period)) <= WORSE * tail

    factor = 1.0
    while factor < LONGEST_FACTOR and works(2 * factor * drive.period):
        factor *= 2
    return _halved(works, factor * drive.period)


def _halved(works: Callable[[float], bool], period: float) -> float:
    """The last period that works between one that does and its double, on a logarithmic scale."""
    low, high = 0.0, 1.0
    for _ in range(PERIOD_HALVINGS):
        middle = (low + high) / 2
        if works(period * 2**middle):
            low = middle
        else:
            high = middle
    return period * 2**low
