"""The metrics of a run: settling time, errors, effort of the input.

Integrals come from the integrator's own states. Extremes and crossings are found on every
integration step cut into equal parts, and refined on the dense output of the run
(:mod:`certrack.simulation.refine`), so that their error is that of the run. Without it, a parabola
or a cubic through the samples has to do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from certrack.core.memo import remembered
from certrack.integrators.base import PARTS, Trajectory
from certrack.integrators.single.extremes import SeriesSignals
from certrack.integrators.single.taylor import TaylorSeries
from certrack.loops.continuous import INTEGRAL_SCALE
from certrack.references import Reference
from certrack.simulation.refine import (
    MAX_REFINED,
    Candidates,
    Crossings,
    Dense,
    candidates,
    refine,
)
from certrack.systems.system import Settings

#: Half-width of the settling band over the reference's largest magnitude, as usual in step
#: responses; the half-width itself where the reference is zero.
SETTLING_SHARE = 0.05

#: Points of the grid over the run on which the reference's largest magnitude is looked for.
REFERENCE_POINTS = 20_001

#: More extremes of one signal are not refined: those that would gain least keep their samples.
MAX_EXTREMES = 2_000

#: Metrics that tables show, and what they are called there.
METRIC_LABELS = {
    "settling_time": "settling time [s]",
    "tail_error": "tail error",
    "rms_error": "RMS error",
    "integral_abs_error": "integral of |e_1|",
    "peak_input": "peak input",
    "input_energy": "input energy",
    "input_variation": "variation of input",
}


@dataclass(frozen=True)
class Metrics:
    """Performance of one run.

    Attributes
    ----------
    settling_time : float, s
        Last time |e_1| exceeds the band; NaN if it still does at the end.
    tail_error : float
        Largest |e_1| from `tail_start` on, unit of the output.
    rms_error : float
        Root mean square of e_1 over the run, unit of the output.
    integral_abs_error, integral_squared_error : float
        Integrals of |e_1| and e_1^2.
    peak_input : float
        Largest |u|.
    input_energy : float
        Integral of u^2.
    input_variation : float
        Total variation of u.
    band, tail_start : float
        What settling and tail refer to.
    """

    settling_time: float
    tail_error: float
    rms_error: float
    integral_abs_error: float
    integral_squared_error: float
    peak_input: float
    input_energy: float
    input_variation: float
    band: float
    tail_start: float

    def as_dict(self) -> dict[str, float | None]:
        """For JSON: a number that does not exist is None."""
        return {k: v if math.isfinite(v) else None for k, v in vars(self).items()}


def settling_band(settings: Settings, reference: Reference) -> float:
    """Half-width of the settling band: the stated one, else a share of the largest reference.

    The reference is looked at over the whole duration, so an early end of a run does not matter.

    Parameters
    ----------
    settings : Settings
    reference : Reference
    """
    if settings.band is not None:
        return settings.band
    return _band_of(reference, settings.duration)


@remembered
def _band_of(reference: Reference, duration: float) -> float:
    """The share of the largest reference: the same for all runs of a sweep."""
    times = np.linspace(0.0, duration, REFERENCE_POINTS)
    largest = float(np.abs(reference.values(times, 0)[0]).max())
    return SETTLING_SHARE * largest or SETTLING_SHARE


def measure(
    t: np.ndarray,
    e: np.ndarray,
    u: np.ndarray,
    integrals: np.ndarray,
    band: float,
    tail_start: float,
    per_step: int | None = None,
    dense: Dense | None = None,
    smooth: bool = True,
) -> Metrics:
    """Metrics from samples that resolve the solution.

    Parameters
    ----------
    t, e, u : (N,) arrays
        Times, tracking error e_1, input.
    integrals : (3, N) array
        Running integrals of u^2, e_1^2 and e_1.
    band, tail_start : float
        See :class:`Metrics`.
    per_step : int, optional
        Samples per integration step; signals may jump between steps.
    dense : callable, optional
        e_1, u and the integral of e_1 at any times of the run, a row each.
    smooth : bool
        Whether no kink lies inside a step.

    Returns
    -------
    Metrics
    """
    span = float(t[-1])
    if dense is None or per_step is None:
        five = _from_samples(t, e, u, integrals, band, tail_start, per_step)
    else:
        five = _from_dense(t, e, u, integrals, band, tail_start, per_step, dense, smooth)
    settling_time, tail_error, integral_abs_error, peak_input, input_variation = five
    return Metrics(
        settling_time=settling_time if span > 0 else math.nan,
        tail_error=tail_error,
        rms_error=math.sqrt(integrals[1, -1] / span) if span > 0 else math.nan,
        integral_abs_error=integral_abs_error,
        integral_squared_error=float(integrals[1, -1]),
        peak_input=peak_input,
        input_energy=float(integrals[0, -1]),
        input_variation=input_variation,
        band=band,
        tail_start=tail_start,
    )


def measure_series(
    trajectory: Trajectory,
    series: TaylorSeries,
    signals: SeriesSignals,
    band: float,
    tail_start: float,
    smooth: bool,
) -> Metrics | None:
    """The same from the Taylor series of a run, in compiled C; None where it cannot be done there.

    Parameters
    ----------
    trajectory : Trajectory
    series : TaylorSeries
        Its dense output.
    signals : SeriesSignals
    band, tail_start : float
        See :class:`Metrics`.
    smooth : bool
        Whether no kink lies inside a step.

    Returns
    -------
    Metrics or None
    """
    span = trajectory.end
    if trajectory.parts != PARTS:
        return None
    numbers = signals.measure(
        series, span, INTEGRAL_SCALE, band, tail_start, smooth=smooth, most=MAX_EXTREMES
    )
    if numbers is None:
        return None
    settling, tail, magnitude, peak, variation, u2, e2 = numbers
    u2, e2 = max(u2, 0.0), max(e2, 0.0)  # of an error that is rounding alone the sum may be below
    return Metrics(
        *(settling, tail, math.sqrt(e2 / span), magnitude, e2, peak, u2, variation),
        *(band, tail_start),
    )


def _from_samples(
    t: np.ndarray,
    e: np.ndarray,
    u: np.ndarray,
    integrals: np.ndarray,
    band: float,
    tail_start: float,
    per_step: int | None,
) -> tuple[float, float, float, float, float]:
    """Settling time, tail error, integral of |e|, peak and variation of the input."""
    return (
        last_outside(t, np.abs(e), band),
        _tail_supremum(t, e, tail_start, per_step),
        _integral_of_magnitude(t, e, integrals[2]),
        supremum(t, u, per_step),
        float(np.abs(np.diff(u)).sum()),
    )


def _from_dense(
    t: np.ndarray,
    e: np.ndarray,
    u: np.ndarray,
    integrals: np.ndarray,
    band: float,
    tail_start: float,
    per_step: int,
    dense: Dense,
    smooth: bool,
) -> tuple[float, float, float, float, float]:
    """The same from dense output."""
    peaks = candidates(t, u, per_step)
    peaks = _most_promising(peaks, peaks.estimates - peaks.sampled, MAX_EXTREMES)
    tail, late = _tail_candidates(t, e, tail_start, per_step)
    outside = np.flatnonzero(np.abs(e) > band)
    settles = outside[-1:] if outside.size and outside[-1] < len(t) - 1 else outside[:0]
    change = np.flatnonzero((e[1:] < 0) != (e[:-1] < 0))
    signs = np.where(e < 0, -1.0, 1.0)
    (tops, errors), (zeros, settled) = refine(
        dense,
        [(1, peaks), (0, late)],
        [
            (0, Crossings(t[change], t[change + 1], signs[change])),
            (0, Crossings(t[settles], t[settles + 1], signs[settles], band)),
        ],
        smooth=smooth,
    )
    begins_inside = t[0] < tail_start <= t[-1]
    marked = dense(np.append(zeros, tail_start if begins_inside else t[0]))
    if begins_inside:
        tail = max(tail, abs(float(marked[0, -1])))
    running = integrals[2]
    marks = np.concatenate([running[:1], marked[2, :-1], running[-1:]])
    gains = np.maximum(tops - peaks.sampled, 0.0)
    return (
        float(settled[0]) if settles.size else math.nan if outside.size else 0.0,
        max(tail, float(errors.max(initial=0.0))),
        float(np.abs(np.diff(marks)).sum()),
        max(float(np.abs(u).max(initial=0.0)), float(np.abs(tops).max(initial=0.0))),
        float(np.abs(np.diff(u)).sum() + 2 * gains.sum()),
    )


def _most_promising(where: Candidates, merit: np.ndarray, count: int) -> Candidates:
    """At most `count` of the candidates, those of the largest merit."""
    if len(merit) <= count:
        return where
    return where.only(np.argsort(-merit)[:count])


def _tail_candidates(
    t: np.ndarray, e: np.ndarray, start: float, per_step: int
) -> tuple[float, Candidates]:
    """Largest sample of |e| from `start` on, and where |e| may be larger."""
    first, peaks = int(np.searchsorted(t, start)), candidates(t, e, per_step)
    if first == len(t):
        return math.nan, peaks.only(np.zeros(len(peaks.begins), dtype=bool))
    best = float(np.abs(e[first:]).max())
    reach = 2 * peaks.estimates - peaks.sampled  # twice the gain that a parabola promises
    late = peaks.only((peaks.ends > start) & (reach > best))
    late = _most_promising(late, late.estimates, MAX_EXTREMES)
    return best, replace(late, begins=np.maximum(late.begins, start))


def supremum(
    t: np.ndarray, values: np.ndarray, per_step: int | None = None, offset: int = 0
) -> float:
    """Largest |value|, refined by a parabola through three neighbouring samples of one step.

    Parameters
    ----------
    t, values : (N,) arrays
        Samples, `per_step` of them on every step. A signal may jump or have a kink where one step
        ends and the next begins, so no parabola reaches across.
    offset : int
        Position of the first sample in its step.
    """
    size = np.abs(values)
    if not len(size):
        return math.nan
    count = len(size) + offset if per_step is None else per_step
    i = int(np.argmax(size))
    best = float(size[i])
    for near in (i - 1, i, i + 1):  # the peak may lie on the other side of a step's end
        begin = near - (near + offset) % count
        first, last = max(begin, 0), min(begin + count, len(size)) - 1
        if 0 <= near < len(size) and last - first >= 2:
            middle = min(max(near, first + 1), last - 1)
            best = max(best, _vertex(t, size, middle))
    return best


def _vertex(t: np.ndarray, f: np.ndarray, i: int) -> float:
    """Top of the parabola through samples i-1, i, i+1, if it lies between them; else -inf."""
    f0, f1, f2 = map(float, f[i - 1 : i + 2])
    h0, h1 = float(t[i] - t[i - 1]), float(t[i + 1] - t[i])
    if not (h0 > 0 and h1 > 0 and f0 + f1 + f2 < MAX_REFINED):
        return -math.inf
    left, right = (f1 - f0) / h0, (f2 - f1) / h1
    bend = (right - left) / (h0 + h1)
    if bend >= 0:
        return -math.inf
    slope = (left * h1 + right * h0) / (h0 + h1)  # at sample i
    shift = -slope / (2 * bend)
    return f1 + slope * shift / 2 if -h0 <= shift <= h1 else -math.inf


def _tail_supremum(t: np.ndarray, e: np.ndarray, start: float, per_step: int | None) -> float:
    """Largest |e| from `start` on, which may lie between two samples."""
    first = int(np.searchsorted(t, start))
    if first == len(t):
        return math.nan
    offset = first % per_step if per_step else 0
    return max(
        supremum(t[first:], e[first:], per_step, offset), abs(_interpolate(t, e, start, first))
    )


def _interpolate(t: np.ndarray, f: np.ndarray, at: float, i: int) -> float:
    """f at a time just before sample i, by the cubic through four neighbours."""
    lo = max(0, min(i - 2, len(t) - 4))
    ts, fs = t[lo : lo + 4].tolist(), f[lo : lo + 4].tolist()
    if len(set(ts)) < 4:
        return float(np.interp(at, t, f))
    weights = (
        math.prod((at - ts[m]) / (ts[j] - ts[m]) for m in range(4) if m != j) for j in range(4)
    )
    return math.fsum(w * v for w, v in zip(weights, fs, strict=True))


def last_outside(t: np.ndarray, size: np.ndarray, band: float) -> float:
    """Last time at which the size exceeds the band; 0 if never, NaN if it does at the end."""
    outside = np.flatnonzero(size > band)
    if not outside.size:
        return 0.0
    i = int(outside[-1])
    if i == len(t) - 1:
        return math.nan
    return _crossing(t, size - band, i)


def _crossing(t: np.ndarray, f: np.ndarray, i: int) -> float:
    """Zero of f in [t_i, t_{i+1}] by inverse interpolation through four neighbours."""
    lo = max(0, min(i - 1, len(t) - 4))
    ts, fs = t[lo : lo + 4].tolist(), f[lo : lo + 4].tolist()
    if len(ts) == 4 and fs[0] > fs[1] > fs[2] > fs[3]:  # monotone: the inverse is a function
        guess = 0.0
        for j in range(4):
            weights = [fs[m] / (fs[m] - fs[j]) for m in range(4) if m != j]
            guess += ts[j] * math.prod(weights)
        if t[i] <= guess <= t[i + 1]:
            return guess
    return float(t[i] + (t[i + 1] - t[i]) * f[i] / (f[i] - f[i + 1]))


def _integral_of_magnitude(t: np.ndarray, e: np.ndarray, running: np.ndarray) -> float:
    """Integral of |e| from the running integral of e, split where e changes sign.

    The running integral has an extremum there, so a small error of the crossing time only counts
    squared; a cubic Hermite polynomial of it, whose slope is e, is enough.
    """
    negative = e < 0
    change = np.flatnonzero(negative[1:] != negative[:-1])
    if not change.size:
        return abs(float(running[-1] - running[0]))
    h, e0, e1 = t[change + 1] - t[change], e[change], e[change + 1]
    s = e0 / (e0 - e1)
    hermite = (
        running[change] * (1 + 2 * s) * (1 - s) ** 2
        + running[change + 1] * s**2 * (3 - 2 * s)
        + h * s * (1 - s) * (e0 * (1 - s) - e1 * s)
    )
    marks = np.concatenate([running[:1], hermite, running[-1:]])
    return float(np.abs(np.diff(marks)).sum())
