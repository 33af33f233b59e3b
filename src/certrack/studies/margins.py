"""What a real drive may take away: period, delay, saturation, and the constants it was made for.

A period (delay, saturation) *holds* where all members that are tried track within the stated error.
From the harmless end on, values are tried in geometric steps until one does not hold, and the edge
is bisected: what is reported held, and so did everything tried before it. For the robust law on a
linear plant the edge of stability is exact besides (see :mod:`certrack.loops.stability`); beyond it
nothing holds, though a run may end before it shows. How far constants with a range may drift is
proven (:mod:`certrack.studies.drift`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.certificates.scope import has_ranges
from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import InputError
from certrack.core.notebook import ShownInNotebooks
from certrack.core.progress import Progress, silent
from certrack.laws.leakage import longest_euler_period
from certrack.loops.stability import linear_loop
from certrack.model.implementation import MAX_DELAY, MAX_RUN_SAMPLES, Implementation
from certrack.simulation.metrics import REFERENCE_POINTS
from certrack.studies.drift import Drift, drift
from certrack.studies.edge_search import VALUE_RATIO, Sweep, last_before_failure, stability_edge
from certrack.studies.ensembles import workers
from certrack.studies.ensembles.error_limit import tail_error_limit
from certrack.studies.ensembles.methods.choice import fastest_adjustable
from certrack.studies.ensembles.problem import EnsembleProblem
from certrack.systems.system import System, require_system

#: The first period tried is at most this part of the fastest error pole's time constant ...
PERIOD_PER_TIME_CONSTANT = 0.05

#: ... and a run has at least so many samples; the longest period tried still gives it 20.
MIN_RUN_SAMPLES, LAST_RUN_SAMPLES = 100, 20

#: Adaptation can make a loop faster than its error poles: that often the period is halved until all
#: members finish. 2^-10 of it serves a loop some thousand times as fast as its fastest pole.
MAX_PERIOD_HALVINGS = 10

#: A loop counts as bounded while its error stays below the largest |y_d|: an output at rest would
#: do as well. Where y_d is no larger than the admitted error, so many times that instead.
BOUNDED_FACTOR = 10.0

#: A first period leaves Euler's step of the leakage this part of the period at which it diverges.
LEAK_PERIOD_SHARE = 0.25

#: Tolerance of the integrator.
MARGIN_TOLERANCE = 1e-6

#: Stands for no saturation.
UNLIMITED_INPUT = (-1e12, 1e12)

#: The lowest saturation tried, over the input that is needed.
LOWEST_SATURATION = 1e-4


@dataclass(frozen=True)
class Margin:
    """One margin.

    Attributes
    ----------
    within : float, optional
        Extreme value at which every member keeps the stated error; None if not even the mildest.
    bounded : float, optional
        The same for an error below :attr:`Margins.bounded_error`: the loop still tracks somehow.
    exact : float, optional
        Edge of stability of the nominal loop, where it can be computed.
    unlimited : bool
        Whether the range searched ended before the stated error was left.
    values, errors : tuples
        What was tried, and the worst member's tail error (inf where a member does not finish).
    """

    within: float | None
    bounded: float | None
    exact: float | None
    unlimited: bool
    values: tuple[float, ...]
    errors: tuple[float, ...]

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "within": self.within,
            "bounded": self.bounded,
            "exact": self.exact,
            "unlimited": self.unlimited,
            "values": list(self.values),
            "errors": list(self.errors),
        }

    def __repr__(self) -> str:
        values = {"within": self.within, "bounded": self.bounded, "exact": self.exact}
        shown = ", ".join(f"{name} {v:.4g}" for name, v in values.items() if v is not None)
        return f"Margin({shown or 'none'}; {len(self.values)} values tried)"


@dataclass(frozen=True)
class Margins(ShownInNotebooks):
    """Margins of a sampled loop.

    Attributes
    ----------
    error : float
        The admitted tail error.
    origin : str
        Where it comes from.
    members : int
    at : float, s
        The period at which delay and saturation were searched.
    as_given : float, optional
        Worst tail error under the implementation as it stands in the file; inf where a member does
        not finish.
    period : Margin, s
    delay : Margin, s
    saturation : Margin, unit of the input
        The lowest symmetric limits +-u.
    bounded_error : float
        What counts as bounded: the largest |y_d|, for an output at rest would do as well; ten
        times the admitted error where y_d is no larger than that.
    drift : Drift or None
        How far each constant with a range may drift, proven for the continuous loop, with an
        admitted error of its own where none was given; None where nothing has a range.
    """

    error: float
    origin: str
    members: int
    at: float
    as_given: float | None
    period: Margin
    delay: Margin
    saturation: Margin
    bounded_error: float = math.inf
    drift: Drift | None = None

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "error": self.error,
            "origin": self.origin,
            "bounded_error": self.bounded_error,
            "members": self.members,
            "at_period": self.at,
            "as_given": self.as_given,
            **{name: getattr(self, name).summary() for name in ("period", "delay", "saturation")},
            "drift": None if self.drift is None else self.drift.summary(),
        }

    def __repr__(self) -> str:
        def shown(value: float | None, unit: str) -> str:
            return "none" if value is None else f"{value:.4g}{unit}"

        period, delay = shown(self.period.within, " s"), shown(self.delay.within, " s")
        lowest = shown(self.saturation.within, "")
        figures = f"period {period}, delay {delay}, saturation {lowest}"
        return f"Margins(error {self.error:.5g} on {self.members} members: {figures})"


@one_blas_thread
def margins(
    system: System,
    *,
    error: float | None = None,
    members: int = 64,
    seed: int = 0,
    progress: Progress = silent,
) -> Margins:
    """Search the margins of a system's controller on a real drive.

    Parameters
    ----------
    system : System
        Period, delay and saturation are varied one by one; all else is as in its implementation,
        if it has one.
    error : float, optional
        Admitted tail error; by default the population's limit, the certified bound where it covers
        the population, else twice the worst tail error of the finest sampling. For the drift of
        constants, which is proven, it is the population's limit or 1.5 times the certified bound.
    members : int
        Members of the population, tried at every value.
    seed : int
    progress : callable
        Gets how many values were tried, None and None; then how many ranges.

    Returns
    -------
    Margins

    Raises
    ------
    InputError
        If an argument does not fit.

    Examples
    --------
    >>> import certrack
    >>> found = certrack.margins(certrack.load("dual-motor-lean"), members=8)
    >>> found.period.within < found.period.exact
    True
    """
    require_system(system)
    checks.integer("members", members, 1, 100_000)
    checks.integer("seed", seed, 0, 2**63)
    stated = system
    implementation, duration = system.implementation, system.settings.duration
    first = _first_period(system)
    base = implementation or Implementation(first)
    saturation = base.saturation
    base = replace(base, offset=0.0, saturation=saturation or UNLIMITED_INPUT)
    base = replace(base, counted_delay=base.design_delay)  # which the controller is made for
    coarse = replace(base, period=min(first, base.period))
    system = system.replace(implementation=coarse)
    trials = _Trials(system, members, seed, progress)
    finest, finest_error = _finest_sampling(coarse, duration, trials)
    admitted, origin = _admitted(stated, error, finest, finest_error)
    limits = admitted, _bounded_error(system, admitted)
    linear = linear_loop(system)
    sweep = Sweep(finest, VALUE_RATIO, duration / LAST_RUN_SAMPLES)
    period = trials.search(
        lambda T: replace(base, period=T),
        sweep,
        limits,
        stability_edge(linear, lambda T: (T, base.run_delay), sweep),
        _leak_period(system),
    )
    at = (period.within or first) / 10 if implementation is None else implementation.period
    base = replace(base, period=at)
    sweep = Sweep(at / 5, VALUE_RATIO, MAX_DELAY * at)
    delay = trials.search(
        lambda D: replace(base, delay=D / at),
        sweep,
        limits,
        stability_edge(linear, lambda D: (at, D / at), sweep),
    )
    unlimited = trials.worst(replace(base, saturation=UNLIMITED_INPUT))
    peak = trials.peak
    if saturation is not None and not unlimited <= admitted:  # begin where it is known to serve
        peak = max(map(abs, saturation)) / 2
    lowest = trials.search(
        lambda u: replace(base, saturation=(-u, u)),
        Sweep(2 * peak, 1 / VALUE_RATIO, LOWEST_SATURATION * peak),
        limits,
    )
    as_given = None if implementation is None else trials.worst(base)
    drifts = drift(stated, error=error, progress=progress) if has_ranges(stated) else None
    searched = period, delay, lowest
    return Margins(admitted, origin, members, at, as_given, *searched, limits[1], drifts)


def _first_period(system: System) -> float:
    """A period that is short for the error poles, s; the loop of an adaptive law may be faster."""
    duration = system.settings.duration
    pole = system.controller.fastest_pole
    first = min(PERIOD_PER_TIME_CONSTANT / pole, duration / MIN_RUN_SAMPLES)
    first = min(first, LEAK_PERIOD_SHARE * _leak_period(system))
    if duration / first > MAX_RUN_SAMPLES:
        raise InputError(
            "margin",
            f"a run sampled finely for the fastest error pole, {pole:.3g} /s, has more than "
            f"{MAX_RUN_SAMPLES} samples",
            remedy="Lower c, or shorten simulation.duration",
        )
    return first


def _leak_period(system: System) -> float:
    """Period from which the estimates' leak diverges by its own step, s; inf if it never does."""
    implementation = system.implementation
    exact = implementation is not None and implementation.update == "exact_leak"
    return math.inf if exact else longest_euler_period(system.controller)


def _finest_sampling(
    coarse: Implementation, duration: float, trials: _Trials
) -> tuple[float, float]:
    """The period to begin with, s, and the members' worst tail error; inf if none lets all finish.

    It is halved until all members finish, and then once more, to get away from that edge. If they
    never do, the shortest period tried is returned.
    """
    period = coarse.period
    error = trials.worst(coarse)
    if math.isfinite(error):
        return period, error
    for _ in range(MAX_PERIOD_HALVINGS):
        if 2 * duration / period > MAX_RUN_SAMPLES:
            break
        finishes, period = math.isfinite(error), period / 2
        error = trials.worst(replace(coarse, period=period))
        if finishes:
            break
    return period, error


class _Trials:
    """Members under other implementations, compiled once."""

    def __init__(self, system: System, members: int, seed: int, progress: Progress) -> None:
        self._members, self._progress, self._done, self.peak = members, progress, 0, 0.0
        problem = EnsembleProblem(system, seed, MARGIN_TOLERANCE)
        self._method = fastest_adjustable(problem, workers.cores())

    def worst(self, implementation: Implementation) -> float:
        """Worst tail error of the members."""
        error, self.peak = self._method.extremes(self._members, implementation)
        self._done += 1
        self._progress(self._done, None, None)
        return error

    def search(
        self,
        implementation: Callable[[float], Implementation],
        sweep: Sweep,
        limits: tuple[float, float],
        exact: float | None = None,
        leak: float = math.inf,
    ) -> Margin:
        """Try the values of a sweep until one fails, and bisect the edges of both errors.

        From the exact edge of stability, and from the period at which the leak diverges, nothing
        holds.
        """
        tried: dict[float, float] = {}

        def error_at(value: float) -> float:
            if value not in tried:
                unstable = value >= min(math.inf if exact is None else exact, leak)
                tried[value] = math.inf if unstable else self.worst(implementation(value))
            return tried[value]

        bounded, _ = last_before_failure(error_at, sweep, limits[1])
        within, unlimited = last_before_failure(error_at, sweep, limits[0])
        order = tuple(sorted(tried))
        errors = tuple(tried[value] for value in order)
        return Margin(within, bounded, exact, unlimited, order, errors)


def _bounded_error(system: System, admitted: float) -> float:
    """The tail error up to which a loop counts as bounded."""
    times = np.linspace(0.0, system.settings.duration, REFERENCE_POINTS)
    largest = float(np.abs(system.reference.values(times, 0)[0]).max())
    return largest if largest > admitted else BOUNDED_FACTOR * admitted


def _admitted(
    system: System, error: float | None, finest: float, finest_error: float
) -> tuple[float, str]:
    """The admitted tail error and where it comes from."""
    if error is not None:
        return checks.real("error", error, above=0), "given"
    limit, origin = tail_error_limit(system, None)
    if limit is None and system.implementation is not None:
        limit, origin = tail_error_limit(system.replace(implementation=None), None)
        if origin == "certificate":  # it does not speak of the loop that is tried here
            origin = "certificate of the continuous loop"
    if not math.isfinite(finest_error):
        raise InputError(
            "margin",
            f"not every member of the population finishes, down to a period of {finest:.3g} s",
            remedy="Narrow [ensemble] or plant.ranges, or choose another law or smaller adaptation "
            "gains; certrack ensemble without [implementation] tells whether they finish in "
            "continuous time",
        )
    if limit is not None and finest_error <= limit:
        return limit, origin
    return 2 * finest_error, "twice the error of the finest sampling"
