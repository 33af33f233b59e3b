"""Pictures of an ensemble: a fan chart of the signals, histograms of the metrics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.core.errors import InputError
from certrack.plotting.shared import (
    BLUE,
    PAGE_WIDTH,
    few_ticks,
    in_brackets,
    math_name,
    new_figure,
    set_title,
    style,
)
from certrack.studies.ensembles.statistics import LEVELS

if TYPE_CHECKING:
    from certrack.studies.ensembles.ensemble import Ensemble
    from certrack.studies.ensembles.statistics import Tally


#: Members run away where the outer quantiles exceed the inner ones by this factor.
RUNAWAY = 30.0

#: Histograms have a logarithmic axis where the values span more than this factor.
LOGARITHMIC_SPAN = 1e3

#: Parts of the largest value below which a histogram shows nothing apart.
SMALLEST_SHARE = 1e-12

#: Bands of the fan chart: positions of their ends in LEVELS, label, opacity.
BANDS = ((0, -1, "1 to 99 %", 0.14), (1, -2, "5 to 95 %", 0.22), (2, -3, "25 to 75 %", 0.34))


def ensemble_figures(ensemble: Ensemble) -> dict[str, Figure]:
    """Fan chart of error, states and input, and histograms of the metrics.

    Parameters
    ----------
    ensemble : Ensemble

    Returns
    -------
    dict
        Figure by name.

    Examples
    --------
    >>> import certrack
    >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
    >>> sorted(certrack.plotting.ensemble_figures(result))
    ['fan', 'metrics']
    """
    return {"fan": fan_chart(ensemble), "metrics": metric_histograms(ensemble)}


def fan_chart(ensemble: Ensemble) -> Figure:
    """Quantile bands of every signal against time.

    Parameters
    ----------
    ensemble : Ensemble

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
    >>> len(certrack.plotting.fan_chart(result).axes)
    4
    """
    names = ensemble.signals
    with style():
        drawing = new_figure(PAGE_WIDTH, 1.7 * len(names) + 0.4)
        axes = drawing.subplots(len(names), 1, sharex=True)
        for ax, name in zip(axes, names, strict=True):
            plot_fan(ax, ensemble, name)
        drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
        axes[-1].set_xlabel("time [s]")
        drawing.align_ylabels()
        set_title(drawing, _title(ensemble))
    return drawing


def plot_fan(ax: Axes, ensemble: Ensemble, signal: str = "e_1", color: str = BLUE) -> None:
    """Quantile bands of one signal against time, on any axes.

    Parameters
    ----------
    ax : Axes
    ensemble : Ensemble
    signal : str
        One of ``ensemble.signals``.
    color : str
        Another one for another ensemble on the same axes.

    Raises
    ------
    InputError
        If there is no such signal.

    Examples
    --------
    >>> import certrack
    >>> from matplotlib.figure import Figure
    >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
    >>> certrack.plotting.plot_fan(Figure().subplots(), result, "x1")
    """
    names, t = ensemble.signals, ensemble.t
    if signal not in names:
        raise InputError("signal", "must be one of " + ", ".join(names), signal)
    i, bands = names.index(signal), _finite(ensemble.bands)
    units = ensemble.system.plant.units or ("",) * (len(names) - 1)
    for low, high, label, alpha in BANDS:
        shade: dict[str, Any] = {"color": color, "alpha": alpha, "lw": 0}
        ax.fill_between(t, bands[low, i], bands[high, i], label=label, **shade)
    ax.plot(t, bands[len(LEVELS) // 2, i], color=color, lw=1.0, label="median")
    if i == 0 and ensemble.limit is not None:
        tail = (max(ensemble.system.settings.tail_start, t[0]), t[-1])
        for sign, entry in ((-1, None), (1, "limit")):
            ax.plot(tail, [sign * ensemble.limit] * 2, "k--", lw=0.8, label=entry)
    ax.set_ylabel(math_name(signal) + in_brackets([units[0], *units][i]))
    ax.margins(x=0.01)
    _keep_readable(ax, bands[:, i])


def _title(ensemble: Ensemble) -> str:
    return f"{ensemble.system.title}: {ensemble.members} members"


def _finite(bands: np.ndarray) -> np.ndarray:
    """Quantiles with infinite ones at ten times the largest finite one of their signal."""
    size = np.abs(np.where(np.isfinite(bands), bands, 0.0)).max(axis=(0, 2), keepdims=True)
    far = np.broadcast_to(10 * size, bands.shape)
    return np.where(np.isinf(bands), np.copysign(far, bands), bands)


def _keep_readable(ax: Axes, bands: np.ndarray) -> None:
    """Logarithmic beyond the middle half's range where a few members run far away."""
    middle = np.nanmax(np.abs(bands[2:-2]), initial=0.0)
    outer = np.nanmax(np.abs(bands), initial=0.0)
    if not outer > RUNAWAY * middle > 0:
        return
    edge = 10.0 ** math.ceil(math.log10(middle))
    decades = max(1.0, math.log10(outer / edge))
    ax.set_yscale("symlog", linthresh=edge, linscale=decades)
    locator = ticker.SymmetricalLogLocator(base=10, linthresh=edge)
    locator.set_params(numticks=7)
    ax.yaxis.set_major_locator(locator)
    note = f"some run away: logarithmic beyond $\\pm${edge:g}"
    ax.text(0.01, 0.97, note, transform=ax.transAxes, va="top", fontsize=7)


#: Metrics with a histogram, their labels, and which of the plant's units they have.
HISTOGRAMS = {
    "tail_error": ("tail error", 0),
    "settling_time": ("settling time [s]", None),
    "rms_error": ("RMS error", 0),
    "peak_input": ("peak input", -1),
}

#: Bars of a histogram: as many as can be told apart at this size.
HISTOGRAM_BARS = 60


def metric_histograms(ensemble: Ensemble) -> Figure:
    """Distribution of four metrics; the limit of the tail error is marked.

    Parameters
    ----------
    ensemble : Ensemble

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> result = certrack.ensemble(certrack.load("example1"), members=8, method="lockstep")
    >>> len(certrack.plotting.metric_histograms(result).axes)
    4
    """
    units = ensemble.system.plant.units or ("",)
    with style():
        drawing = new_figure(PAGE_WIDTH, 4.2)
        axes = drawing.subplots(2, 2).ravel()
        for ax, (name, (label, index)) in zip(axes, HISTOGRAMS.items(), strict=True):
            tally = ensemble.statistics.metrics[name]
            if tally.counts.size:
                _histogram(ax, tally)
            if name == "tail_error" and ensemble.limit is not None:
                ax.axvline(ensemble.limit, color="k", ls="--", lw=0.8, label="limit")
                ax.legend()
            ax.set_xlabel(label + in_brackets("" if index is None else units[index]))
            ax.set_ylabel("members")
            if tally.missing:
                lack = "not settled" if name == "settling_time" else "not finished"
                ax.set_title(f"{tally.missing} {lack}", loc="right", fontweight="normal")
        set_title(drawing, _title(ensemble))
    return drawing


def _first_of_size(tally: Tally) -> float:
    """The lowest quantile that is no zero beside the largest value: zeros stand at the left end."""
    levels = [q for q in map(tally.quantile, LEVELS) if q is not None]
    return next((q for q in levels if q > SMALLEST_SHARE * tally.most), 0.0)


def _histogram(ax: Axes, tally: Tally) -> None:
    """Bars of equal width, on a logarithmic axis where the values span decades."""
    values, bars = tally.values, HISTOGRAM_BARS
    low, high = _first_of_size(tally), tally.quantile(LEVELS[-1])
    assert high is not None
    if low > 0 and (tally.most > LOGARITHMIC_SPAN * low or tally.most > RUNAWAY * high):
        # a few tiny values must not stretch the axis
        first = max(tally.least, low / 10, SMALLEST_SHARE * tally.most)
        edges = np.geomspace(first, tally.most, bars + 1).tolist()
        ax.hist(np.clip(values, edges[0], edges[-1]), edges, weights=tally.counts, color=BLUE)
        ax.set_xscale("log")
        few_ticks(ax)
    else:
        ax.hist(values, bars, weights=tally.counts, color=BLUE)
        ax.xaxis.set_major_locator(ticker.MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        ax.ticklabel_format(axis="x", scilimits=(-3, 5))
