"""Pictures of an ensemble: a fan chart of the signals, histograms of the metrics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.core.errors import InputError
from certrack.plotting.appearance import PAGE, Appearance
from certrack.plotting.names import math_name
from certrack.plotting.shared import (
    BLUE,
    few_ticks,
    in_brackets,
    new_figure,
    set_title,
    style,
)
from certrack.plotting.units import label_with_unit, prefix, short
from certrack.plotting.windows import Window, columns, show_window, split_time
from certrack.studies.ensembles.statistics import LEVELS

if TYPE_CHECKING:
    from certrack.studies.ensembles.ensemble import Ensemble
    from certrack.studies.ensembles.statistics import Tally


#: A limit farther from what varies than so many times its width is told, not drawn.
LIMIT_NEAR = 1.0

#: Entries beside each other in the legend below a fan chart.
LEGEND_COLUMNS = {"page": 5, "paper": 3, "slides": 5}

#: Members run away where the outer quantiles exceed the inner ones by this factor.
RUNAWAY = 30.0

#: Histograms have a logarithmic axis where the values span more than this factor.
LOGARITHMIC_SPAN = 1e3

#: Parts of the largest value below which a histogram shows nothing apart.
SMALLEST_SHARE = 1e-12

#: Bands of the fan chart: positions of their ends in LEVELS, label, opacity.
BANDS = ((0, -1, "1 to 99 %", 0.14), (1, -2, "5 to 95 %", 0.22), (2, -3, "25 to 75 %", 0.34))


def ensemble_figures(ensemble: Ensemble, appearance: Appearance = PAGE) -> dict[str, Figure]:
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
    return {
        "fan": fan_chart(ensemble, appearance),
        "metrics": metric_histograms(ensemble, appearance),
    }


def fan_chart(ensemble: Ensemble, appearance: Appearance = PAGE) -> Figure:
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
    >>> len(certrack.plotting.fan_chart(result).axes)  # four signals; the start by itself
    8
    """
    names = ensemble.signals
    with style(appearance):
        drawing = new_figure(*appearance.extent(0.95 * len(names)))
        windows = _windows(ensemble, appearance)
        rows = columns(drawing, len(names), windows)
        for row, name in zip(rows, names, strict=True):
            for ax, window in zip(row, windows, strict=True):
                plot_fan(ax, ensemble, name, window=window)
            for ax in row[1:]:
                ax.set_ylabel(ax.get_ylabel().removeprefix(math_name(name)).strip())
        shown = {
            label: handle
            for ax in rows[0]
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
        }
        entries = LEGEND_COLUMNS[appearance.kind]
        drawing.legend(shown.values(), shown, loc="outside lower center", ncols=entries)
        for ax in rows[-1]:
            ax.set_xlabel("time [s]")
        drawing.align_ylabels([row[0] for row in rows])
        set_title(drawing, appearance.titled(_title(ensemble)))
    return drawing


def _windows(ensemble: Ensemble, appearance: Appearance) -> tuple[Window | None, ...]:
    """What the columns show: the transient apart where that of the outer quantiles is short."""
    if appearance.window is not None:
        return (appearance.window,)
    t, bands = ensemble.t, _finite(ensemble.bands)
    outer = np.abs(bands).max(axis=0)
    split = split_time(float(t[-1]), [(t, outer[0]), (t, outer[-1])])
    return (None,) if split is None else ((0.0, split), (split, float(t[-1])))


def plot_fan(
    ax: Axes,
    ensemble: Ensemble,
    signal: str = "e_1",
    color: str = BLUE,
    *,
    window: Window | None = None,
) -> None:
    """Quantile bands of one signal against time, on any axes.

    Parameters
    ----------
    ax : Axes
    ensemble : Ensemble
    signal : str
        One of ``ensemble.signals``.
    color : str
        Another one for another ensemble on the same axes.
    window : (from, to), optional
        Times that are shown, s; all of them if left out.

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
        for sign, entry in ((-1, None), (1, _limit_name(ensemble))):
            ax.plot(tail, [sign * ensemble.limit] * 2, "k--", lw=0.8, label=entry)
    ax.margins(x=0.01)
    within = slice(None) if window is None else (t >= window[0]) & (t <= window[1])
    show_window(ax, window, (float(bands[:, i, within].min()), float(bands[:, i, within].max())))
    _keep_readable(ax, bands[:, i, within])
    label_with_unit(ax, math_name(signal), [units[0], *units][i])


def _limit_name(ensemble: Ensemble) -> str:
    """What the legend calls the limit: certified where it is a certificate's."""
    return "certified limit" if "certif" in ensemble.limit_origin else "limit"


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
    "settling_time": ("settling time", None),
    "rms_error": ("RMS error", 0),
    "peak_input": ("peak input", -1),
}

#: Bars of a histogram: as many as can be told apart at this size.
HISTOGRAM_BARS = 60


def metric_histograms(ensemble: Ensemble, appearance: Appearance = PAGE) -> Figure:
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
    with style(appearance):
        drawing = new_figure(*appearance.extent(2.1))
        axes = drawing.subplots(2, 2).ravel()
        for ax, (name, (label, index)) in zip(axes, HISTOGRAMS.items(), strict=True):
            tally = ensemble.statistics.metrics[name]
            if tally.counts.size:
                _histogram(ax, tally)
            if name == "tail_error" and ensemble.limit is not None:
                _mark_limit(ax, ensemble)
            _label_values(ax, label, "s" if index is None else units[index])
            ax.set_ylabel("members")
            if tally.missing:
                lack = "not settled" if name == "settling_time" else "not finished"
                ax.set_title(f"{tally.missing} {lack}", loc="right", fontweight="normal")
        set_title(drawing, appearance.titled(_title(ensemble)))
    return drawing


def _mark_limit(ax: Axes, ensemble: Ensemble) -> None:
    """A line at the limit where it is near what varies, else a word and an arrow at the edge."""
    limit, name = ensemble.limit, _limit_name(ensemble)
    assert limit is not None
    low, high = ax.get_xlim()
    if ax.get_xscale() == "log" or limit <= high + LIMIT_NEAR * (high - low):
        ax.axvline(limit, color="k", ls="--", lw=0.8, label=name)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
        return
    where: dict[str, Any] = {"transform": ax.transAxes, "ha": "right", "va": "bottom"}
    ax.text(1.0, 1.01, f"{name} {limit:.4g} $\\rightarrow$", fontsize="small", **where)


def _label_values(ax: Axes, label: str, unit: str) -> None:
    """The abscissa of a histogram, in a unit that fits."""
    factor, shown = prefix(unit, max(map(abs, ax.get_xlim())))
    ax.set_xlabel(label + in_brackets(shown))
    if factor != 1 and ax.get_xscale() == "linear":
        ax.xaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: short(factor * v)))
    elif factor != 1:
        ax.set_xlabel(label + in_brackets(unit))


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
