"""Metrics of a run whose steps know e_1 and its rate at both ends: one of a sampled loop.

The input is constant on a step. Between its ends e_1 is the cubic with these values and rates,
whose extremes, zeros and entries into the band are found exactly; it follows e_1 as closely as the
dense output follows the states, for e_1 is no rougher than they are. The integral of e_1 is the
cubic with its values at both ends and e_1 as its rate.
"""

from __future__ import annotations

import math

import numpy as np

from certrack.core.arrays import Array
from certrack.integrators.sampled.solution import SampledSolution
from certrack.loops.continuous import INTEGRAL_SCALE
from certrack.simulation.metrics import Metrics

#: Halvings of an interval that holds a root; Newton's steps need a few of them.
MAX_ROOT_STEPS = 60

#: A root is known to this part of a step.
ROOT_ACCURACY = 1e-15


def measure_steps(solution: SampledSolution, band: float, tail_start: float) -> Metrics:
    """Metrics of a sampled run.

    Parameters
    ----------
    solution : SampledSolution
    band, tail_start : float
        See :class:`~certrack.simulation.metrics.Metrics`.

    Returns
    -------
    Metrics
    """
    record = solution.record
    inputs, span = record.inputs, float(record.ends[-1])
    integrals = record.columns[solution.n :]
    energy, square = (integrals[:2, -1] * INTEGRAL_SCALE).tolist()
    with np.errstate(all="ignore"):
        error = _Error(record.ends, solution.sides)
        return Metrics(
            settling_time=error.last_outside(band) if span > 0 else math.nan,
            tail_error=error.supremum_from(tail_start),
            rms_error=math.sqrt(square / span) if span > 0 else math.nan,
            integral_abs_error=error.integral_of_magnitude(integrals[2] * INTEGRAL_SCALE),
            integral_squared_error=square,
            peak_input=float(np.abs(inputs).max()),
            input_energy=energy,
            input_variation=float(np.abs(np.diff(inputs)).sum()),
            band=band,
            tail_start=tail_start,
        )


class _Error:
    """e_1 along a run, cut where a step ends and where it turns: monotone from cut to cut.

    Parameters
    ----------
    ends : (K+1,) array, s
    sides : (4, K) array
        e_1 at the begin and at the end of each step, and its rate there.
    """

    def __init__(self, ends: Array, sides: Array) -> None:
        self._ends, self._h = ends, np.diff(ends)
        e0, e1 = sides[:2]
        d0, d1 = self._h * sides[2], self._h * sides[3]
        rise = e1 - e0
        #: Coefficients of the powers of s, which goes from 0 to 1 on a step.
        self._cubic = np.array([e0, d0, 3 * rise - 2 * d0 - d1, d0 + d1 - 2 * rise])
        steps, places = _turns(*self._cubic[1:])
        count = len(e0)
        cut = 2 * steps + 1
        self.step = np.insert(np.repeat(np.arange(count), 2), cut, steps)
        self.s = np.insert(np.tile([0.0, 1.0], count), cut, places)
        self.values = np.insert(np.stack([e0, e1], axis=1).ravel(), cut, self._at(steps, places))

    def _at(self, steps: Array, s: Array, level: float = 0.0) -> Array:
        """e_1 above a level."""
        c0, c1, c2, c3 = self._cubic[:, steps]
        values: Array = c0 - level + s * (c1 + s * (c2 + s * c3))
        return values

    def _times(self, at: Array | slice) -> Array:
        steps = self.step[at]
        times: Array = self._ends[steps] + self.s[at] * self._h[steps]
        return times

    def _roots(self, at: Array, level: float) -> Array:
        """Where in the step e_1 passes a level between the cuts `at` and those behind them.

        Newton's steps, halving where one leaves the interval.
        """
        steps, low, high = self.step[at], self.s[at], self.s[at + 1]
        c1, c2, c3 = self._cubic[1:, steps]
        falls = self.values[at] > level
        s = low + (high - low) * 0.5
        for _ in range(MAX_ROOT_STEPS):
            value = self._at(steps, s, level)
            before = (value > 0) == falls
            low, high = np.where(before, s, low), np.where(before, high, s)
            new = s - value / (c1 + s * (2 * c2 + 3 * s * c3))
            new = np.where((new >= low) & (new <= high), new, low + (high - low) * 0.5)
            moved, s = np.abs(new - s), new
            if not (moved > ROOT_ACCURACY).any():
                break
        return s

    def last_outside(self, band: float) -> float:
        """Last time at which |e_1| exceeds the band; 0 if never, NaN if it does at the end."""
        outside = np.flatnonzero(np.abs(self.values) > band)
        if not outside.size:
            return 0.0
        at = outside[-1:]
        if at[0] == len(self.values) - 1:
            return math.nan
        step = self.step[at]
        if self.step[at + 1] != step:  # e_1 jumps
            return float(self._ends[step + 1][0])
        s = self._roots(at, math.copysign(band, self.values[at][0]))
        return float((self._ends[step] + s * self._h[step])[0])

    def supremum_from(self, start: float) -> float:
        """Largest |e_1| from a time on; NaN if the run ends before."""
        ends = self._ends
        if not start <= ends[-1]:
            return math.nan
        # the step that the time lies in
        k = min(max(int(np.searchsorted(ends, start, side="right")) - 1, 0), len(ends) - 2)
        first = int(np.searchsorted(self.step, k))
        late = first + int(np.searchsorted(self._times(slice(first, None)), start))
        largest = float(np.abs(self.values[late:]).max(initial=0.0))
        if not ends[k] < start:
            return largest
        inside = (start - ends[k]) / self._h[k] if self._h[k] > 0 else 0.0
        return max(largest, abs(float(self._at(np.array(k), np.array(inside)))))

    def integral_of_magnitude(self, running: Array) -> float:
        """Integral of |e_1| from its running integral at the ends, split where e_1 changes sign."""
        negative = self.values < 0
        at = np.flatnonzero(negative[1:] != negative[:-1])
        inside = self.step[at] == self.step[at + 1]
        steps = self.step[at]
        marks = running[steps + 1]  # where e_1 jumps
        crossed = at[inside]
        if crossed.size:
            k, s = steps[inside], self._roots(crossed, 0.0)
            c0, c1 = self._cubic[0, k], self._cubic.sum(axis=0)[k]
            q0, d0, d1 = running[k], self._h[k] * c0, self._h[k] * c1
            rise = running[k + 1] - q0
            marks[inside] = q0 + s * (d0 + s * (3 * rise - 2 * d0 - d1 + s * (d0 + d1 - 2 * rise)))
        marks = np.concatenate([running[:1], marks, running[-1:]])
        return float(np.abs(np.diff(marks)).sum())


def _turns(c1: Array, c2: Array, c3: Array) -> tuple[Array, Array]:
    """Steps inside which a cubic has an extreme, and where; two of one step in their order."""
    end = c1 + 2 * c2 + 3 * c3  # the slope
    bends_back = (c2 * c3 < 0) & (np.abs(c2) < 3 * np.abs(c3))
    steps = np.flatnonzero((c1 * end <= 0) | bends_back)
    c1, c2, c3 = c1[steps], c2[steps], c3[steps]
    root = -(c2 + np.copysign(np.sqrt(c2 * c2 - 3 * c1 * c3), c2))
    places = np.sort([root / (3 * c3), c1 / root], axis=0)
    row, which = np.nonzero(((places > 0) & (places < 1)).T)
    return steps[row], places[which, row]
