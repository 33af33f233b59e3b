"""Streaming statistics with bounded memory that merge exactly: counts only, no sums of floats.

A number is counted in a bin of its leading bits. Bins are fixed, so merging adds integers and the
order of the chunks does not matter. A quantile is right within half a bin: for the bands
(|v| + scale/4096)/128 where v is the distance from the nominal run, for the metrics 0.05 %.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from certrack.studies.ensembles.member_table import MemberTable

#: Mantissa bits of a bin of the bands, and of the metrics.
BAND_BITS, METRIC_BITS = 6, 10

#: Bands count y = 1 + |v| / unit, unit = 2^-FINEST_OCTAVE scale: evenly near 0, by octaves beyond.
FINEST_OCTAVE = 12

#: Octaves of y; whatever is beyond is counted in the last bin, and a quantile there is infinite.
BAND_OCTAVES = FINEST_OCTAVE + 24

#: Bins on one side of zero; a last bin of the table takes what is not a number.
BINS_PER_SIDE = BAND_OCTAVES << BAND_BITS
BAND_BINS = 2 * BINS_PER_SIDE + 1

#: Mantissa bits, exponent of 1 and sign bit of IEEE 754 numbers of 32 and 64 bits.
FLOAT_BITS, FLOAT_BIAS, FLOAT_SIGN = 23, 127, 31
DOUBLE_BITS = 52

#: Subtracted before a number of members is rounded up: a level such as 0.05 is no binary number.
LEVEL_ROUNDING = 1e-9

#: Worst members that are remembered by index.
WORST_MEMBERS = 10

LEVELS = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)


@cache
def bin_values() -> np.ndarray:
    """Value that stands for each bin of a band, as a multiple of the scale: the bin's middle."""
    octave, part = np.divmod(np.arange(BINS_PER_SIDE), 1 << BAND_BITS)
    y = np.exp2(octave) * (1 + (part + 0.5) / (1 << BAND_BITS))
    values = (y - 1) * 2.0**-FINEST_OCTAVE
    values[-1] = np.inf
    return np.concatenate([-values[::-1], values])


def counts_shape(signals: int, times: int) -> tuple[int, int, int]:
    """Shape of the table that counts so many signals at so many times."""
    return times, signals, BAND_BINS


class Bands:
    """Counts of several signals at every time of a grid.

    Parameters
    ----------
    centre : (R, T) array
        Subtracted from the signals: the nominal run.
    scale : (R,) array
        Unit of the bins.
    """

    def __init__(self, centre: np.ndarray, scale: np.ndarray) -> None:
        self.centre, self.scale = centre, scale
        # (T, R, bins); written to now, so that memory is had before anything is timed
        self.counts = np.full(counts_shape(*centre.shape), 0, dtype=np.int32)

    @property
    def unit(self) -> np.ndarray:
        """What the bands count in, for each signal."""
        return self.scale * 2.0**-FINEST_OCTAVE

    def __getstate__(self) -> dict[str, Any]:
        """Only the bins in which there is something: most are empty."""
        filled = np.flatnonzero(self.counts)
        bins = {"filled": filled, "counts": self.counts.reshape(-1)[filled]}
        return {"centre": self.centre, "scale": self.scale} | bins

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.centre, self.scale = state["centre"], state["scale"]
        self.counts = np.zeros(counts_shape(*self.centre.shape), dtype=np.int32)
        self.counts.reshape(-1)[state["filled"]] = state["counts"]

    def observe(self, signal: int, k: int, values: np.ndarray) -> None:
        """Count `values` of a signal at grid time k; NaN counts as missing."""
        with np.errstate(over="ignore", invalid="ignore"):
            v = (values - self.centre[signal, k]).astype(np.float32)
            v *= np.float32(2.0**FINEST_OCTAVE / self.scale[signal])
        self.counts[k, signal] += np.bincount(_band_bins(v), minlength=BAND_BINS)

    def merge(self, other: Bands) -> None:
        """Add the counts of other members."""
        self.counts += other.counts

    def clear(self, filled: np.ndarray) -> None:
        """Forget everything; `filled` are the bins, flat, in which there is something."""
        self.counts.reshape(-1)[filled] = 0

    def quantiles(self, levels: tuple[float, ...] = LEVELS) -> np.ndarray:
        """Shape (levels, R, T), among the members that are alive."""
        quantiles = np.full((len(levels), *self.centre.shape), np.nan)
        for signal, k in np.ndindex(self.centre.shape):
            counts = self.counts[k, signal, :-1]
            for i, level in enumerate(levels):
                if (bin_ := _quantile_bin(counts, level)) is not None:
                    value = bin_values()[bin_] * self.scale[signal]
                    quantiles[i, signal, k] = value + self.centre[signal, k]
        return quantiles


def _band_bins(v: np.ndarray) -> np.ndarray:
    """Bins of distances v from the centre, in units; float32.

    The bits of a positive float, read as an integer, grow with it: exponent and leading bits of the
    mantissa number the bins without a logarithm of every value.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        y = np.abs(v)
        y += np.float32(1)
    bins = y.view(np.int32)
    bins -= FLOAT_BIAS << FLOAT_BITS
    bins >>= FLOAT_BITS - BAND_BITS
    np.minimum(bins, BINS_PER_SIDE - 1, out=bins)
    bins ^= v.view(np.int32) >> FLOAT_SIGN  # -1 where v is negative: bin k becomes -k - 1
    bins += BINS_PER_SIDE
    bins[np.isnan(v)] = BAND_BINS - 1
    return bins


def _quantile_bin(counts: np.ndarray, level: float) -> int | None:
    """Index of the bin that holds the level's order statistic (the smallest with F >= level)."""
    total = np.cumsum(counts)
    if not total.size or not total[-1]:
        return None
    return int(np.searchsorted(total, max(1, math.ceil(level * int(total[-1]) - LEVEL_ROUNDING))))


def _distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different keys in order, and how often each occurs; a table where they lie close together."""
    first = keys.min() if len(keys) else 0
    if len(keys) and keys.max() - first < 16 * len(keys) + 4096:  # then faster than a sort
        table = np.bincount(keys - first)
        present = np.flatnonzero(table)
        return present + first, table[present]
    return np.unique(keys, return_counts=True)


@dataclass
class Tally:
    """Counts of one metric by its leading bits; exact extremes.

    The bits of a positive float, read as an integer, grow with it: without the last ones, they are
    the number of a bin whose width is a fixed share of the value.
    """

    keys: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    counts: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    missing: int = 0
    least: float = math.inf
    most: float = -math.inf

    def observe(self, values: np.ndarray) -> None:
        """Count non-negative numbers; NaN counts as missing."""
        real = np.ascontiguousarray(values[np.isfinite(values)])
        keys, counts = _distinct(real.view(np.int64) >> (DOUBLE_BITS - METRIC_BITS))
        least = float(real.min(initial=math.inf))
        most = float(real.max(initial=-math.inf))
        self.merge(Tally(keys, counts, len(values) - len(real), least, most))

    def merge(self, other: Tally) -> None:
        """Add the counts of other members."""
        place = np.searchsorted(self.keys, other.keys)
        covered = self.keys.size and np.array_equal(self.keys.take(place, mode="clip"), other.keys)
        if not covered:
            keys = np.union1d(self.keys, other.keys)
            counts = np.zeros(len(keys), dtype=np.int64)
            counts[np.searchsorted(keys, self.keys)] = self.counts
            self.keys, self.counts = keys, counts
            place = np.searchsorted(keys, other.keys)
        self.counts[place] += other.counts
        self.missing += other.missing
        self.least, self.most = min(self.least, other.least), max(self.most, other.most)

    @property
    def values(self) -> np.ndarray:
        """Values that stand for the bins, in order."""
        dropped = DOUBLE_BITS - METRIC_BITS  # bits; the middle of a bin has half of them set
        middle = ((self.keys << dropped) + (1 << (dropped - 1))).view(np.float64)
        values: np.ndarray = np.clip(middle, self.least, self.most)
        return values

    def quantile(self, level: float) -> float | None:
        """Value below which the share `level` of the members lies."""
        bin_ = _quantile_bin(self.counts, level)
        return None if bin_ is None else float(self.values[bin_])

    def summary(self) -> dict[str, float | int | None]:
        """Quantiles and extremes, ready for JSON."""
        empty = self.counts.size == 0
        summary: dict[str, float | int | None] = {"min": None if empty else self.least}
        summary |= {f"{100 * level:g}%": self.quantile(level) for level in LEVELS}
        return summary | {"max": None if empty else self.most, "missing": self.missing}


@dataclass
class Statistics:
    """Everything that is kept of some members."""

    bands: Bands
    metrics: dict[str, Tally]
    members: int = 0
    violations: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    worst: list[tuple[float, int]] = field(default_factory=list)
    table: MemberTable | None = None

    def observe_worst(self, values: np.ndarray, first: int) -> None:
        """Remember the members with the largest values; infinite for one that did not finish."""
        count = min(WORST_MEMBERS, len(values))
        large = np.flatnonzero(values >= np.partition(values, -count)[-count])
        order = large[np.argsort(-values[large], kind="stable")][:WORST_MEMBERS]
        self._remember([(float(values[i]), first + int(i)) for i in order])

    def _remember(self, worst: list[tuple[float, int]]) -> None:
        pairs = {*self.worst, *worst}
        self.worst = sorted(pairs, key=lambda pair: (-pair[0], pair[1]))[:WORST_MEMBERS]

    def merge(self, other: Statistics) -> None:
        """Add other members."""
        self.bands.merge(other.bands)
        for name, metric in self.metrics.items():
            metric.merge(other.metrics[name])
        self.members += other.members
        self.violations += other.violations
        self.outcomes.update(other.outcomes)
        self._remember(other.worst)
        if self.table is not None and other.table is not None:
            self.table.merge(other.table)

    def packed(self) -> dict[str, np.ndarray]:
        """Arrays for a file or a network: only bins that are not empty."""
        flat = self.bands.counts.ravel()
        filled = np.flatnonzero(flat)
        arrays: dict[str, np.ndarray] = {
            "bins": np.diff(filled, prepend=0).astype(np.uint32),
            "counts": flat[filled].astype(np.uint32),
            "totals": np.array([self.members, self.violations], dtype=np.int64),
            "outcomes": np.array(list(self.outcomes), dtype=str),
            "outcome_counts": np.array(list(self.outcomes.values()), dtype=np.int64),
            "worst": np.array([value for value, _ in self.worst]),
            "worst_members": np.array([index for _, index in self.worst], dtype=np.int64),
        }
        for name, metric in self.metrics.items():
            arrays[f"{name}_keys"], arrays[f"{name}_counts"] = metric.keys, metric.counts
            arrays[f"{name}_extremes"] = np.array([metric.least, metric.most, metric.missing])
        return arrays | ({} if self.table is None else self.table.packed())

    def add_packed(self, arrays: Mapping[str, Any]) -> None:
        """Merge what :meth:`packed` gave."""
        if self.table is not None:
            self.table.add_packed(arrays)
        flat = self.bands.counts.reshape(-1)
        flat[np.cumsum(arrays["bins"].astype(np.int64))] += arrays["counts"].astype(np.int32)
        members, violations = arrays["totals"].tolist()
        self.members += members
        self.violations += violations
        names, numbers = arrays["outcomes"].tolist(), arrays["outcome_counts"].tolist()
        self.outcomes.update(dict(zip(names, numbers, strict=True)))
        pairs = zip(arrays["worst"].tolist(), arrays["worst_members"].tolist(), strict=True)
        self._remember(list(pairs))
        for name, metric in self.metrics.items():
            keys, counts = arrays[f"{name}_keys"], arrays[f"{name}_counts"]
            least, most, missing = arrays[f"{name}_extremes"].tolist()
            metric.merge(Tally(keys, counts, int(missing), least, most))


def binomial_interval(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson interval of a probability: exact for independent members."""
    from scipy.stats import binomtest

    interval = binomtest(count, total).proportion_ci(level, method="exact")
    return float(interval.low), float(interval.high)
