"""Panels of one run or of several: output, error, states, estimates, input.

A panel draws on any axes, and scales them to what is within the window of times that it is given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from certrack.plotting.curves import Runs, draw_curve, label_axes, label_once
from certrack.plotting.limits import Certified, draw_guarantees, draw_input_limits
from certrack.plotting.names import math_name
from certrack.plotting.shared import PURPLE, in_brackets, plain
from certrack.plotting.windows import Window, largest_within, show_window

#: The estimate of the gain has its own axis, of this colour, where the largest values of it and of
#: the other estimates differ by more than this factor.
GAIN_COLOR, SAME_AXIS_RATIO = PURPLE, 10.0

#: The settling band is drawn where it is at most so many times the largest error that is seen.
BAND_FITS = 2.0

#: Part of the height of two axes that is left free above for their legend.
LEGEND_ROOM = 0.3


def units_of(runs: Runs) -> tuple[str, ...]:
    """Units of the states and of the input of the first run; empty where there is none."""
    plant = next(iter(runs.values())).system.plant
    return tuple("" if u == "1" else u for u in plant.units or ("",) * (plant.n + 1))


def plot_output(ax: Axes, runs: Runs, *, named: bool = True, window: Window | None = None) -> None:
    """Output and reference against time.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.
    window : (from, to), optional
        Times that are shown, s; all of the runs if left out.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_output(certrack.plot(run).axes[0], {"": run})
    """
    for k, run in enumerate(runs.values()):
        draw_curve(ax, runs, k, run.x[0], "$y$", named=named)
    first = next(iter(runs.values()))
    line, width = ("--", 1.0) if len(runs) == 1 else ("-", 0.7)  # dashes tell signals apart
    shown: Any = {"color": "k", "ls": line, "lw": width, "zorder": 3}  # above y, where it is seen
    ax.plot(first.t, first.y_d, label=label_once(ax, "$y_d$"), **shown)
    _finish(ax, "output", units_of(runs)[0], runs, window, named=named)


def plot_error(
    ax: Axes,
    runs: Runs,
    *,
    named: bool = True,
    window: Window | None = None,
    certified: Certified | None = None,
) -> None:
    """Tracking error against time, with the settling band where it fits.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.
    window : (from, to), optional
        Times that are shown, s; all of the runs if left out.
    certified : mapping of names of runs to Certificates, optional
        Whose bound and tube are drawn.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_error(certrack.plot(run).axes[0], {"": run})
    """
    first = next(iter(runs.values()))
    for k, run in enumerate(runs.values()):
        draw_curve(ax, runs, k, run.e[0], "$e_1$", named=named)
    largest = largest_within(ax, window)
    bounds = draw_guarantees(ax, runs, certified or {}, window, largest)
    show_window(ax, window, bounds)
    band = first.metrics.band
    unit = units_of(runs)[0]
    label = label_once(ax, rf"band $\pm${band:.3g} {plain(unit)}".strip())
    if label and band <= BAND_FITS * largest:
        if window is not None:
            show_window(ax, window, (*bounds, band, -band))
        ax.axhspan(-band, band, color="#000000", alpha=0.07, lw=0, label=label)
    _finish(ax, "tracking error", unit, runs, None, named=named)


def plot_states(
    ax: Axes,
    runs: Runs,
    *,
    named: bool = True,
    window: Window | None = None,
    unit: str | None = None,
) -> None:
    """Plant states against time.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.
    window : (from, to), optional
        Times that are shown, s; all of the runs if left out.
    unit : str, optional
        Only the states of this unit; all of them if left out.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_states(certrack.plot(run).axes[0], {"": run})
    """
    units = units_of(runs)
    for k, run in enumerate(runs.values()):
        for i, state in enumerate(run.system.plant.states):
            if unit in (None, units[i]):
                label = math_name(state) + (in_brackets(units[i]) if unit is None else "")
                draw_curve(ax, runs, k, run.x[i], label, named=named)
    _finish(ax, "states", unit or "", runs, window, named=named)


def plot_estimates(
    ax: Axes, runs: Runs, *, named: bool = True, window: Window | None = None
) -> None:
    """Controller states against time, with the true values they estimate.

    The estimate of the gain has an axis of its own, on the right, where the others are of another
    magnitude.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.
    window : (from, to), optional
        Times that are shown, s; all of the runs if left out.

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
    _finish(ax, "estimates", "", runs, window, named=named)
    if apart:
        show_window(gain_ax, window)
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


def plot_input(ax: Axes, runs: Runs, *, named: bool = True, window: Window | None = None) -> None:
    """Control input against time.

    Parameters
    ----------
    ax : Axes
    runs : mapping of names to runs
    named : bool
        Whether the legend names the runs.
    window : (from, to), optional
        Times that are shown, s; all of the runs if left out.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.plot_input(certrack.plot(run).axes[0], {"": run})
    """
    for k, run in enumerate(runs.values()):
        draw_curve(ax, runs, k, run.u, "$u$", named=named)
    limits = draw_input_limits(ax, runs, window, largest_within(ax, window))
    show_window(ax, window, limits)
    _finish(ax, "input", units_of(runs)[-1], runs, None, named=named)


def _finish(
    ax: Axes, label: str, unit: str, runs: Runs, window: Window | None, *, named: bool
) -> None:
    """The scale of what is seen, labels and legend."""
    ax.margins(x=0.01)  # a jump at t = 0 stays visible beside the axis
    show_window(ax, window)
    label_axes(ax, label, unit, runs, named=named)


Panel = Callable[..., None]


PANELS: dict[str, Panel] = {
    "output": plot_output,
    "error": plot_error,
    "states": plot_states,
    "estimates": plot_estimates,
    "input": plot_input,
}
