"""Pictures of an ensemble: a fan chart of the signals, histograms of the metrics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.plotting.shared import few_ticks, math_name, style
from certrack.studies.ensembles.statistics import LEVELS

if TYPE_CHECKING:
    from certrack.studies.ensembles.ensemble import Ensemble
    from certrack.studies.ensembles.statistics import Tally


#: Members run away where the outer quantiles exceed the inner ones by this factor.
RUNAWAY = 30.0


def ensemble_figures(found: Ensemble) -> dict[str, Figure]:
    """Fan chart of error, states and input, and histograms of the metrics."""
    return {"fan": fan_chart(found), "metrics": metric_histograms(found)}


def fan_chart(found: Ensemble) -> Figure:
    """Quantile bands of every signal against time."""
    names, bands, t = found.signals, _finite(found.bands), found.t
    units = found.system.plant.units or ("",) * (len(names) - 1)
    shown = ((0, -1, "1 to 99 %", 0.14), (1, -2, "5 to 95 %", 0.22), (2, -3, "25 to 75 %", 0.34))
    with style():
        made = Figure(figsize=(6.5, 1.7 * len(names) + 0.4), layout="constrained")
        axes = made.subplots(len(names), 1, sharex=True)
        for i, (ax, name, unit_) in enumerate(zip(axes, names, [units[0], *units], strict=True)):
            for low, high, label, alpha in shown:
                ax.fill_between(
                    t,
                    bands[low, i],
                    bands[high, i],
                    color="#0b61a4",
                    alpha=alpha,
                    lw=0,
                    label=label,
                )
            ax.plot(t, bands[len(LEVELS) // 2, i], color="#0b61a4", lw=1.0, label="median")
            if i == 0 and found.limit is not None:
                start = max(found.system.settings.tail_start, t[0])
                for sense in (-1, 1):
                    limit, named = [sense * found.limit] * 2, "limit" if sense > 0 else None
                    ax.plot([start, t[-1]], limit, "k--", lw=0.8, label=named)
            ax.set_ylabel(math_name(name) + (f" [{unit_}]" if unit_ not in ("", "1") else ""))
            ax.margins(x=0.01)
            _keep_readable(ax, bands[:, i])
        made.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
        axes[-1].set_xlabel("time [s]")
        made.align_ylabels()
        title = f"{found.system.title}: {found.members} members"
        made.suptitle(title, fontsize=10, fontweight="bold")
    return made


def _finite(bands: np.ndarray) -> np.ndarray:
    """Quantiles with infinite ones at ten times the largest finite one of their signal."""
    size = np.abs(np.where(np.isfinite(bands), bands, 0.0)).max(axis=(0, 2), keepdims=True)
    least = np.broadcast_to(10 * size, bands.shape)
    return np.where(np.isinf(bands), np.copysign(least, bands), bands)


def _keep_readable(ax: Axes, bands: np.ndarray) -> None:
    """Logarithmic beyond the middle half's range where a few members run far away."""
    middle = np.nanmax(np.abs(bands[2:-2]), initial=0.0)
    outer = np.nanmax(np.abs(bands), initial=0.0)
    if not outer > RUNAWAY * middle > 0:
        return
    edge = 10.0 ** math.ceil(math.log10(middle))
    decades = max(1.0, math.log10(outer / edge))
    ax.set_yscale("symlog", linthresh=edge, linscale=decades)
    place = ticker.SymmetricalLogLocator(base=10, linthresh=edge)
    place.set_params(numticks=7)
    ax.yaxis.set_major_locator(place)
    note = f"some run away: logarithmic beyond $\\pm${edge:g}"
    ax.text(0.01, 0.97, note, transform=ax.transAxes, va="top", fontsize=7)


#: Metrics with a histogram, their labels, and which of the plant's units they have.
HISTOGRAMS = {
    "tail_error": ("tail error", 0),
    "settling_time": ("settling time [s]", None),
    "rms_error": ("RMS error", 0),
    "peak_input": ("peak input", -1),
}


HISTOGRAM_BARS = 60


def metric_histograms(found: Ensemble) -> Figure:
    """Distribution of four metrics; the limit of the tail error is marked."""
    units = found.system.plant.units or ("",)
    with style():
        made = Figure(figsize=(6.5, 4.2), layout="constrained")
        axes = made.subplots(2, 2).ravel()
        for ax, (name, (label, index)) in zip(axes, HISTOGRAMS.items(), strict=True):
            tally = found.statistics.metrics[name]
            if tally.counts.size:
                _histogram(ax, tally)
            if name == "tail_error" and found.limit is not None:
                ax.axvline(found.limit, color="k", ls="--", lw=0.8, label="limit")
                ax.legend()
            unit_ = "" if index is None else units[index]
            ax.set_xlabel(label + (f" [{unit_}]" if unit_ not in ("", "1") else ""))
            ax.set_ylabel("members")
            if tally.missing:
                lack = "not settled" if name == "settling_time" else "not finished"
                ax.set_title(f"{tally.missing} {lack}", loc="right", fontweight="normal")
        title = f"{found.system.title}: {found.members} members"
        made.suptitle(title, fontsize=10, fontweight="bold")
    return made


def _histogram(ax: Axes, tally: Tally) -> None:
    """Bars of equal width, on a logarithmic axis where the values span decades."""
    values, bars = tally.values, HISTOGRAM_BARS
    low, high = tally.quantile(LEVELS[0]), tally.quantile(LEVELS[-1])
    assert low is not None and high is not None
    if low > 0 and (tally.most > 1e3 * low or tally.most > RUNAWAY * high):
        least = max(tally.least, low / 10, 1e-12 * tally.most)  # tiny ones do not stretch the axis
        edges = np.geomspace(least, tally.most, bars + 1).tolist()
        ax.hist(np.clip(values, edges[0], edges[-1]), edges, weights=tally.counts, color="#0b61a4")
        ax.set_xscale("log")
        few_ticks(ax)
    else:
        ax.hist(values, bars, weights=tally.counts, color="#0b61a4")
        ax.xaxis.set_major_locator(ticker.MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        ax.ticklabel_format(axis="x", scilimits=(-3, 5))
