"""Pictures of one run or of several: output, error, states, estimates, input, the tube."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.certificates.certificate import Certificate
from certrack.certificates.tube import Tube
from certrack.core.rounding import rounded_up
from certrack.plotting.curves import Runs, draw_curve, label_axes, label_once, name_systems
from certrack.plotting.shared import (
    BLUE,
    GREEN,
    PAGE_WIDTH,
    PURPLE,
    in_brackets,
    math_name,
    new_figure,
    plain,
    set_title,
    style,
)
from certrack.simulation.run import Run

#: The estimate of the gain has its own axis, of this colour, where the largest values of it and of
#: the other estimates differ by more than this factor.
GAIN_COLOR, SAME_AXIS_RATIO = PURPLE, 10.0


#: Bounds that differ by less are one line of the picture of the tube.
SAME_BOUND = 1e-3

#: Part of the height of two axes that is left free above for their legend.
LEGEND_ROOM = 0.3


def unit(run: Run, index: int) -> str:
    """Unit of state `index` (the input is last) as a label suffix."""
    units = run.system.plant.units
    return in_brackets(units[index] if units else "")


def plot_output(ax: Axes, runs: Runs, *, named: bool = True) -> None:
    """Output and reference against time.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_output(certrack.plot(run).axes[0], {"": run})
    """
    first = next(iter(runs.values()))
    line, width = ("--", 1.0) if len(runs) == 1 else ("-", 0.7)  # dashes tell several runs apart
    ax.plot(first.t, first.y_d, color="k", ls=line, lw=width, label=label_once(ax, "$y_d$"))
    for k, run in enumerate(runs.values()):
        draw_curve(ax, runs, k, run.x[0], "$y$", named=named)
    label_axes(ax, f"output{unit(first, 0)}", runs, named)


def plot_error(ax: Axes, runs: Runs, *, named: bool = True) -> None:
    """Tracking error against time, with the settling band.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_error(certrack.plot(run).axes[0], {"": run})
    """
    first = next(iter(runs.values()))
    for k, run in enumerate(runs.values()):
        draw_curve(ax, runs, k, run.e[0], "$e_1$", named=named)
    band = first.metrics.band
    if label := label_once(ax, f"band $\\pm${band:.3g}"):
        ax.axhspan(-band, band, color="#000000", alpha=0.07, lw=0, label=label)
    label_axes(ax, f"tracking error{unit(first, 0)}", runs, named)


def plot_states(ax: Axes, runs: Runs, *, named: bool = True) -> None:
    """All plant states against time.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_states(certrack.plot(run).axes[0], {"": run})
    """
    for k, run in enumerate(runs.values()):
        for i, state in enumerate(run.system.plant.states):
            draw_curve(ax, runs, k, run.x[i], math_name(state) + unit(run, i), named=named)
    label_axes(ax, "states", runs, named)


def plot_estimates(ax: Axes, runs: Runs, *, named: bool = True) -> None:
    """Controller states against time, with the true values they estimate.

    The estimate of the gain has an axis of its own, on the right, where the others are of another
    magnitude.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_estimates(certrack.plot(run).axes[0], {"": run})
    """
    truth = next(iter(runs.values())).system.truth
    names = {state.name for run in runs.values() for state in run.system.controller.states}
    true: list[tuple[str, float]] = []
    if "delta_hat" in names and truth.input_gain is not None:
        true.append(("delta_hat", 1 / float(truth.input_gain.expr)))
    if "theta_hat_1" in names:
        true.extend(("theta_hat", float(theta.expr)) for theta in truth.theta)
    apart = _magnitudes_differ(runs)
    gain_ax = ax.twinx() if apart else ax
    for k, run in enumerate(runs.values()):
        for i, state in enumerate(run.system.controller.states):
            right = apart and state.name == "delta_hat"
            label = math_name(state.name) + (" (right)" if right else "")
            color = GAIN_COLOR if right else None
            draw_curve(gain_ax if right else ax, runs, k, run.z[i], label, color, named=named)
    for name, value in true[::-1]:
        right = apart and name == "delta_hat"
        entry = label_once(ax, "true values") if (name, value) == true[-1] else None
        color = GAIN_COLOR if right else "k"
        (gain_ax if right else ax).axhline(value, color=color, lw=0.8, ls=":", label=entry)
    label_axes(ax, "estimates", runs, named)
    if apart:
        _share_legend(ax, gain_ax)
        gain_ax.set_ylabel(math_name("delta_hat"), color=GAIN_COLOR)


def _magnitudes_differ(runs: Runs) -> bool:
    """Whether the estimate of the gain and the others do not fit one axis."""
    largest = {True: 0.0, False: 0.0}
    for run in runs.values():
        for state, values in zip(run.system.controller.states, run.z, strict=False):
            gain = state.name == "delta_hat"
            largest[gain] = max(largest[gain], float(np.nanmax(np.abs(values), initial=0.0)))
    low, high = sorted(largest.values())
    return low > 0 and high > SAME_AXIS_RATIO * low


def _share_legend(ax: Axes, right: Axes) -> None:
    """One legend above the curves of two axes that lie on each other."""
    shown: dict[str, Any] = {}
    for side in (ax, right):
        handles, labels = side.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            shown.setdefault(label, handle)
        low, high = side.get_ylim()
        side.set_ylim(low, high + LEGEND_ROOM * (high - low))
    legend = ax.get_legend()
    if legend is not None:
        legend.remove()
    right.legend(list(shown.values()), list(shown), loc="upper right", ncols=min(5, len(shown)))
    right.spines["right"].set_visible(True)
    right.spines["right"].set_color(GAIN_COLOR)
    right.tick_params(axis="y", colors=GAIN_COLOR)
    right.grid(visible=False)


def plot_input(ax: Axes, runs: Runs, *, named: bool = True) -> None:
    """Control input against time.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_input(certrack.plot(run).axes[0], {"": run})
    """
    first = next(iter(runs.values()))
    for k, run in enumerate(runs.values()):
        draw_curve(ax, runs, k, run.u, "$u$", named=named)
    label_axes(ax, f"input{unit(first, -1)}", runs, named)


Panel = Callable[..., None]


PANELS: dict[str, Panel] = {
    "output": plot_output,
    "error": plot_error,
    "states": plot_states,
    "estimates": plot_estimates,
    "input": plot_input,
}


def panels_for(runs: Runs) -> dict[str, Panel]:
    """The panels that have something to show.

    Parameters
    ----------
    runs : mapping of names to runs

    Returns
    -------
    dict

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> list(certrack.plotting.panels_for({"": run}))
    ['output', 'error', 'states', 'estimates', 'input']
    """
    estimating = any(run.system.controller.states for run in runs.values())
    return {name: draw for name, draw in PANELS.items() if name != "estimates" or estimating}


def figure(panel: Panel, runs: Runs, title: str = "") -> Figure:
    """One panel as a figure of a paper's column width.

    Parameters
    ----------
    panel : callable
        One of :data:`PANELS`.
    runs : mapping of names to runs
    title : str

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> drawing = certrack.plotting.figure(certrack.plotting.plot_error, {"": run})
    """
    with style():
        drawing = new_figure(5.0, 3.0)
        ax = drawing.add_subplot()
        panel(ax, runs, named=False)
        ax.set_title(plain(title), loc="left")
        name_systems(drawing, runs)
    return drawing


def plot_tube(ax: Axes, runs: Runs, tube: Tube, *, named: bool = True) -> None:
    """Tracking errors and the certified tube, which is of the continuous law.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    tube : Tube
    named : bool
        Whether the legend names the runs.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> run, tube = certrack.simulate(system), certrack.certify(system).tube
    >>> certrack.plotting.plot_tube(certrack.plot(run).axes[0], {"": run}, tube)
    """
    first = next(iter(runs.values()))
    t = np.unique(np.concatenate([run.t for run in runs.values()]))
    bound = tube(t)
    sampled = any(run.system.implementation is not None for run in runs.values())
    label = "certified tube" + (" (continuous law)" if sampled else "")
    ax.fill_between(t, -bound, bound, color=BLUE, alpha=0.10, lw=0, label=label)
    for k, run in enumerate(runs.values()):
        label = "$e_1$" if run.system.implementation is None else "$e_1$ (sampled run)"
        draw_curve(ax, runs, k, run.e[0], label, named=named)
    floor = math.sqrt(tube.floor)
    for sign, entry in ((-1, None), (1, f"limsup $|e_1| \\leq$ {rounded_up(floor, 4)}")):
        ax.axhline(sign * floor, color=BLUE, lw=0.9, ls="--", label=entry)
    label_axes(ax, f"tracking error{unit(first, 0)}", runs, named)


def tube_figure(run: Run, tube: Tube, title: str = "", best: Certificate | None = None) -> Figure:
    """The response in its tube: the whole run, and the end of it magnified.

    Parameters
    ----------
    run : Run
    tube : Tube
    title : str
    best : Certificate, optional
        The certificate to rely on, which is drawn where its bound is another than the tube's.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> run, tube = certrack.simulate(system), certrack.certify(system).tube
    >>> drawing = certrack.plotting.tube_figure(run, tube)
    """
    with style():
        drawing = new_figure(PAGE_WIDTH, 4.2)
        axes = drawing.subplots(2, 1, sharex=True)
        for ax in axes:
            plot_tube(ax, {"": run}, tube, named=False)
            ax.label_outer()
        floor = math.sqrt(tube.floor)
        axes[1].set_ylim(-2 * floor, 2 * floor)
        axes[1].get_legend().remove()
        if best is not None and best.exists:
            _add_bound(axes[1], best, floor)
        axes[1].set_title("magnified", loc="left")
        if run.system.implementation is not None:
            title = f"{title}\ntube of the continuous law; the run shown is sampled".strip()
        axes[0].set_title(plain(title), loc="left")
        drawing.align_ylabels()
    return drawing


def _add_bound(ax: Axes, best: Certificate, floor: float) -> None:
    """Lines at a bound that is another than the tube's."""
    if math.isclose(best.bound, floor, rel_tol=SAME_BOUND):
        return
    name = f"{best.kind}: limsup $|e_1| \\leq$ {rounded_up(best.bound, 4)}"
    for sign in (-1, 1):
        line = ax.axhline(sign * best.bound, color=GREEN, lw=0.9, ls="-.")
    height = max(2 * floor, 1.3 * best.bound)
    ax.set_ylim(-height, height)
    ax.legend([line], [name], loc="lower right")


def overview(runs: Runs, title: str = "") -> Figure:
    """All panels below each other.

    Parameters
    ----------
    runs : mapping of names to runs
    title : str

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> drawing = certrack.plotting.overview({"example1": run})
    """
    panels = panels_for(runs)
    with style():
        drawing = new_figure(PAGE_WIDTH, 1.9 * len(panels) + 0.4)
        axes = drawing.subplots(len(panels), 1, sharex=True)
        for ax, panel in zip(np.atleast_1d(axes), panels.values(), strict=True):
            panel(ax, runs, named=False)
            ax.label_outer()
        drawing.align_ylabels()
        set_title(drawing, title)
        name_systems(drawing, runs)
    return drawing
