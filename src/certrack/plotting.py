"""Pictures: output and reference, error, states, estimates, input. One run or several side by side.

Figures are made without pyplot, so nothing global is touched and no window opens.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from certrack.certificates.tube import Tube
from certrack.ensembles.statistics import LEVELS
from certrack.errors import InputError
from certrack.run import Run

if TYPE_CHECKING:
    from certrack.ensembles.ensemble import Ensemble
    from certrack.ensembles.statistics import Tally
    from certrack.margin import Margins

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",
    "svg.hashsalt": "certrack",
    "axes.prop_cycle": cycler(
        color=[
            "#0b61a4",
            "#d1495b",
            "#2e8b57",
            "#edae49",
            "#6a4c93",
            "#00798c",
            "#8c564b",
            "#7f7f7f",
        ]
    ),
}

#: Of a system's name in a legend, and of the legend's type.
MOST_LETTERS, LETTERS_PER_INCH = 32, 14

#: The estimate of the gain has its own axis, of this colour, where the largest values of it and of
#: the other estimates differ by more than this factor.
GAIN_COLOR, MAGNITUDES = "#6a4c93", 10.0

#: Members run away where the outer quantiles exceed the inner ones by this factor.
RUNAWAY = 30.0

#: Runs by the name that the legend shows.
Runs = Mapping[str, Run]


def style() -> AbstractContextManager[None]:
    """Context in which certrack draws."""
    return matplotlib.rc_context(STYLE)


def unit(run: Run, index: int) -> str:
    """Unit of state `index` (the input is last) as a label suffix."""
    units = run.system.plant.units
    return f" [{units[index]}]" if units and units[index] not in ("", "1") else ""


def plot_output(ax: Axes, runs: Runs) -> None:
    """Output and reference against time."""
    first = next(iter(runs.values()))
    line, width = ("--", 1.0) if len(runs) == 1 else ("-", 0.7)  # dashes tell several runs apart
    ax.plot(first.t, first.y_d, color="k", ls=line, lw=width, label="$y_d$")
    for k, run in enumerate(runs.values()):
        _curve(ax, runs, k, run.x[0], "$y$")
    _finish(ax, f"output{unit(first, 0)}", runs)


def plot_error(ax: Axes, runs: Runs) -> None:
    """Tracking error against time, with the settling band."""
    first = next(iter(runs.values()))
    for k, run in enumerate(runs.values()):
        _curve(ax, runs, k, run.e[0], "$e_1$")
    band = first.metrics.band
    ax.axhspan(-band, band, color="#000000", alpha=0.07, lw=0, label=f"band $\\pm${band:.3g}")
    _finish(ax, f"tracking error{unit(first, 0)}", runs)


def plot_states(ax: Axes, runs: Runs) -> None:
    """All plant states against time."""
    for k, run in enumerate(runs.values()):
        for i, state in enumerate(run.system.plant.states):
            _curve(ax, runs, k, run.x[i], _math(state) + unit(run, i))
    _finish(ax, "states", runs)


def plot_estimates(ax: Axes, runs: Runs) -> None:
    """Controller states against time, with the true values they estimate.

    The estimate of the gain has an axis of its own, on the right, where the others are of another
    magnitude.
    """
    truth = next(iter(runs.values())).system.truth
    names = {state.name for run in runs.values() for state in run.system.controller.states}
    true: list[tuple[str, float]] = []
    if "delta_hat" in names and truth.input_gain is not None:
        true.append(("delta_hat", 1 / float(truth.input_gain.expr)))
    if "theta_hat_1" in names:
        true.extend(("theta_hat", float(theta.expr)) for theta in truth.theta)
    apart = _magnitudes_differ(runs)
    gain = ax.twinx() if apart else ax
    for k, run in enumerate(runs.values()):
        for i, state in enumerate(run.system.controller.states):
            own = apart and state.name == "delta_hat"
            label = _math(state.name) + (" (right)" if own else "")
            color = GAIN_COLOR if own else None
            _curve(gain if own else ax, runs, k, run.z[i], label, color)
    for name, value in true[::-1]:
        own = apart and name == "delta_hat"
        named = "true values" if (name, value) == true[-1] else None
        color = GAIN_COLOR if own else "k"
        (gain if own else ax).axhline(value, color=color, lw=0.8, ls=":", label=named)
    _finish(ax, "estimates", runs)
    if apart:
        _share_legend(ax, gain)
        gain.set_ylabel(_math("delta_hat"), color=GAIN_COLOR)


def _magnitudes_differ(runs: Runs) -> bool:
    """Whether the estimate of the gain and the others do not fit one axis."""
    largest = {True: 0.0, False: 0.0}
    for run in runs.values():
        for state, values in zip(run.system.controller.states, run.z, strict=False):
            gain = state.name == "delta_hat"
            largest[gain] = max(largest[gain], float(np.nanmax(np.abs(values), initial=0.0)))
    low, high = sorted(largest.values())
    return low > 0 and high > MAGNITUDES * low


def _share_legend(ax: Axes, right: Axes) -> None:
    """One legend above the curves of two axes that lie on each other."""
    shown: dict[str, Any] = {}
    for one in (ax, right):
        handles, labels = one.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            shown.setdefault(label, handle)
        low, high = one.get_ylim()
        one.set_ylim(low, high + 0.3 * (high - low))
    legend = ax.get_legend()
    if legend is not None:
        legend.remove()
    right.legend(list(shown.values()), list(shown), loc="upper right", ncols=min(5, len(shown)))
    right.spines["right"].set_visible(True)
    right.spines["right"].set_color(GAIN_COLOR)
    right.tick_params(axis="y", colors=GAIN_COLOR)
    right.grid(visible=False)


def plot_input(ax: Axes, runs: Runs) -> None:
    """Control input against time."""
    first = next(iter(runs.values()))
    for k, run in enumerate(runs.values()):
        _curve(ax, runs, k, run.u, "$u$")
    _finish(ax, f"input{unit(first, -1)}", runs)


Panel = Callable[[Axes, Runs], None]

PANELS: dict[str, Panel] = {
    "output": plot_output,
    "error": plot_error,
    "states": plot_states,
    "estimates": plot_estimates,
    "input": plot_input,
}


def panels_for(runs: Runs) -> dict[str, Panel]:
    """The panels that have something to show."""
    estimating = any(run.system.controller.states for run in runs.values())
    return {name: draw for name, draw in PANELS.items() if name != "estimates" or estimating}


def figure(panel: Panel, runs: Runs, title: str = "") -> Figure:
    """One panel as a figure of a paper's column width."""
    with style():
        made = Figure(figsize=(5.0, 3.0), layout="constrained")
        ax = made.add_subplot()
        panel(ax, runs)
        ax.set_title(title, loc="left")
        _name_systems(made, runs)
    return made


def plot_tube(ax: Axes, runs: Runs, tube: Tube) -> None:
    """Tracking errors and the certified tube, which is of the continuous law."""
    first = next(iter(runs.values()))
    t = np.unique(np.concatenate([run.t for run in runs.values()]))
    bound = tube(t)
    sampled = any(run.system.implementation is not None for run in runs.values())
    of = "certified tube" + (" (continuous law)" if sampled else "")
    ax.fill_between(t, -bound, bound, color="#0b61a4", alpha=0.10, lw=0, label=of)
    for k, run in enumerate(runs.values()):
        real = run.system.implementation is not None
        _curve(ax, runs, k, run.e[0], "$e_1$ (sampled run)" if real else "$e_1$")
    floor = math.sqrt(tube.floor)
    for sense in (-1, 1):
        label = f"limsup $|e_1| \\leq$ {floor:.4g}" if sense > 0 else None
        ax.axhline(sense * floor, color="#0b61a4", lw=0.9, ls="--", label=label)
    _finish(ax, f"tracking error{unit(first, 0)}", runs)


def tube_figure(run: Run, tube: Tube, title: str = "") -> Figure:
    """The response in its tube: the whole run, and the end of it magnified."""
    with style():
        made = Figure(figsize=(6.5, 4.2), layout="constrained")
        axes = made.subplots(2, 1, sharex=True)
        for ax in axes:
            plot_tube(ax, {"": run}, tube)
            ax.label_outer()
        floor = math.sqrt(tube.floor)
        axes[1].set_ylim(-2 * floor, 2 * floor)
        axes[1].get_legend().remove()
        axes[1].set_title("magnified", loc="left")
        if run.system.implementation is not None:
            title = f"{title}\ntube of the continuous law; the run shown is sampled".strip()
        axes[0].set_title(title, loc="left")
        made.align_ylabels()
    return made


def overview(runs: Runs, title: str = "") -> Figure:
    """All panels below each other."""
    panels = panels_for(runs)
    with style():
        made = Figure(figsize=(6.5, 1.9 * len(panels) + 0.4), layout="constrained")
        axes = made.subplots(len(panels), 1, sharex=True)
        for ax, panel in zip(np.atleast_1d(axes), panels.values(), strict=True):
            panel(ax, runs)
            ax.label_outer()
        made.align_ylabels()
        made.suptitle(title, fontsize=10, fontweight="bold")
        _name_systems(made, runs)
    return made


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
            ax.set_ylabel(_math(name) + (f" [{unit_}]" if unit_ not in ("", "1") else ""))
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
        least = max(tally.least, low / 10)  # a lone tiny value does not stretch the axis
        edges = np.geomspace(least, tally.most, bars + 1).tolist()
        ax.hist(np.clip(values, edges[0], edges[-1]), edges, weights=tally.counts, color="#0b61a4")
        ax.set_xscale("log")
        _few_ticks(ax)
    else:
        ax.hist(values, bars, weights=tally.counts, color="#0b61a4")
        ax.xaxis.set_major_locator(ticker.MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        ax.ticklabel_format(axis="x", scilimits=(-3, 5))


def margin_figure(found: Margins, title: str, units: Sequence[str] | None) -> Figure:
    """Worst tail error against period, delay and saturation."""
    names = [f" [{unit}]" if unit not in ("", "1") else "" for unit in units or ("", "")]
    at, unit_ = _seconds(found.at)
    panels = {
        "sampling period": found.period,
        f"delay at a period of {found.at * at:.3g} {unit_}": found.delay,
        f"saturation $\\pm u${names[-1]}": found.saturation,
    }
    top = 1e3 * found.error
    with style():
        made = Figure(figsize=(9.0, 3.2), layout="constrained")
        axes, lost = made.subplots(1, 3, sharey=True), False
        for ax, (label, one) in zip(axes, panels.items(), strict=True):
            factor, unit_ = (1.0, "") if ax is axes[-1] else _seconds(*one.values)
            values, errors = factor * np.array(one.values), np.array(one.errors)
            shown = np.isfinite(errors) & (errors < top)
            ax.loglog(values[shown], errors[shown], ".-", label="worst member")
            lost = lost or not shown.all()
            label_ = "lost, or off the scale"
            ax.plot(values[~shown], [top] * (~shown).sum(), "x", color="#d1495b", label=label_)
            ax.axhline(found.error, color="k", ls="--", lw=0.8, label="admitted")
            edge = factor * one.exact if one.exact else math.nan
            ax.axvline(edge, color="#2e8b57", ls=":", lw=1.2, label="exact edge of stability")
            ax.set_xlabel(f"{label} [{unit_}]" if unit_ else label)
            _few_ticks(ax)
        handles, labels = axes[0].get_legend_handles_labels()
        some = {
            "lost, or off the scale": lost,
            "exact edge of stability": any(one.exact for one in panels.values()),
        }
        kept = [k for k, label in enumerate(labels) if some.get(label, True)]
        made.legend(
            [handles[k] for k in kept],
            [labels[k] for k in kept],
            loc="outside lower center",
            ncols=len(kept),
        )
        axes[0].set_ylabel(f"tail error{names[0]}")
        made.suptitle(title, fontsize=10, fontweight="bold")
    return made


def _seconds(*times: float) -> tuple[float, str]:
    """Factor and unit in which these times in seconds are short numbers."""
    return (1e3, "ms") if np.exp(np.mean(np.log(times))) < 0.1 else (1.0, "s")


def _few_ticks(ax: Axes) -> None:
    """Labels that do not touch on a logarithmic axis of any span."""
    low, high = ax.get_xlim()
    decades = math.log10(high / low)
    if decades < 0.7:
        locator: ticker.Locator = ticker.MaxNLocator(4, steps=[1, 2, 5, 10])
    elif decades < 2:
        locator = ticker.LogLocator(subs=(1.0, 2.0, 5.0))
    else:
        locator = ticker.LogLocator(numticks=6)
    formatter: ticker.Formatter = ticker.StrMethodFormatter("{x:g}")
    if decades > 5:
        formatter = ticker.LogFormatterSciNotation()
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(formatter)
    ax.xaxis.set_minor_formatter(ticker.NullFormatter())


def save_figure(made: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG; returns the paths."""
    paths = [folder / f"{name}.{kind}" for kind in ("png", "svg")]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with style():
            for path in paths:
                part = path.with_name(f"{path.name}.part")
                kind = path.suffix[1:]
                stamp = {"Date": None} if kind == "svg" else {"Software": None}
                made.savefig(part, format=kind, dpi=200, metadata=stamp)
                part.replace(path)
    except OSError as problem:
        raise InputError(str(folder), f"cannot be written ({problem.strerror})") from None
    return paths


#: How system after system is drawn over the others: line, width, and the lightness of the colour:
#: the share of white (black where negative) that is mixed in.
LOOKS = (("-", 2.4, 0.55), ("--", 1.2, 0.0), (":", 1.2, -0.45), ("-.", 0.8, -0.2))


def _look(color: str, k: int) -> dict[str, Any]:
    """How the k-th of several systems draws what has this colour."""
    line, width, light = LOOKS[k % len(LOOKS)]
    end = 1.0 if light > 0 else 0.0
    mixed = (1 - abs(light)) * np.array(to_rgb(color)) + abs(light) * end
    return {"color": tuple(mixed.tolist()), "ls": line, "lw": width}


def _curve(
    ax: Axes, runs: Runs, k: int, values: np.ndarray, label: str, color: str | None = None
) -> None:
    """Signal of the k-th run: the signal sets the colour, the run the line."""
    t = list(runs.values())[k].t
    if len(runs) == 1:
        ax.plot(t, values, color=color, label=label)
        return
    named = {line.get_label(): line for line in ax.lines}
    if label not in named:
        (named[label],) = ax.plot(
            [], [], color=color, label=label
        )  # the legend shows the plain colour
    ax.plot(t, values, **_look(str(named[label].get_color()), k))


def _name_systems(made: Figure, runs: Runs) -> None:
    """One legend of the figure for the systems, where there are several."""
    if len(runs) == 1:
        return
    names = [name if len(name) <= MOST_LETTERS else f"...{name[-MOST_LETTERS:]}" for name in runs]
    lines = [Line2D([], [], **_look("#404040", k)) for k in range(len(runs))]
    letters = made.get_figwidth() * LETTERS_PER_INCH
    columns = max(1, min(len(names), int(letters / (max(map(len, names)) + 8))))
    made.legend(lines, names, loc="outside upper center", ncols=columns, handlelength=3)


def _math(name: str) -> str:
    """A state or estimate name in mathematical type where it has an index."""
    if name in ("e_1", "u"):
        return f"${name}$"
    if name == "delta_hat":
        return r"$\hat\delta$"
    if name.startswith("theta_hat_"):
        return rf"$\hat\theta_{{{name[10:]}}}$"
    head = name.rstrip("0123456789")
    index = name[len(head) :]
    return f"${head}_{{{index}}}$" if index and len(head) == 1 else name


def _finish(ax: Axes, label: str, runs: Runs) -> None:
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    ax.margins(x=0.01)  # a jump at t = 0 stays visible beside the axis
    if len(runs) == 1:
        ax.legend(ncols=3, loc="best")
    else:
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
