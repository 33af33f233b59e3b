"""Pictures of the tube: the response in it, and the end of it magnified."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.certificates.certificate import Certificate
from certrack.certificates.tube import Tube
from certrack.core.rounding import rounded_up
from certrack.plotting.appearance import PAGE, Appearance
from certrack.plotting.curves import Runs, add_legend, draw_curve, label_axes
from certrack.plotting.runs import units_of
from certrack.plotting.shared import BLUE, GREEN, new_figure, plain, set_title, style
from certrack.plotting.units import label_with_unit
from certrack.simulation.run import Run

#: Times at most at which the tube is drawn, whose edges no renderer thins out.
MAX_TIMES = 1000

#: Bounds that differ by less are one line of the picture of the tube.
SAME_BOUND = 1e-3


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
    t = np.unique(np.concatenate([run.t for run in runs.values()]))
    t = np.append(t[:: 1 + len(t) // MAX_TIMES], t[-1])
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
    ax.margins(x=0.01)
    label_axes(ax, "tracking error", units_of(runs)[0], runs, named=named)


def tube_figure(
    run: Run,
    tube: Tube,
    title: str = "",
    best: Certificate | None = None,
    appearance: Appearance = PAGE,
) -> Figure:
    """The response in its tube: the whole run, and the end of it magnified.

    Parameters
    ----------
    run : Run
    tube : Tube
    title : str
    best : Certificate, optional
        The certificate to rely on, which is drawn where its bound is another than the tube's.
    appearance : Appearance

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
    with style(appearance):
        drawing = new_figure(*appearance.extent(2.1))
        axes = drawing.subplots(2, 1, sharex=True)
        floor, unit = math.sqrt(tube.floor), units_of({"": run})[0]
        for ax in axes:
            plot_tube(ax, {"": run}, tube, named=False)
            ax.label_outer()
        axes[1].get_legend().remove()
        axes[1].set_ylim(-2 * floor, 2 * floor)
        if best is not None and best.exists:
            _add_bound(axes[1], best, floor, unit)
        label_with_unit(axes[1], "magnified", unit)
        if appearance.window is not None:
            axes[1].set_xlim(*appearance.window)
        title = appearance.titled(title)
        if run.system.implementation is not None:
            title = f"{title}\ntube of the continuous law; the run shown is sampled".strip()
        set_title(drawing, title)
        drawing.align_ylabels()
    return drawing


def _add_bound(ax: Axes, best: Certificate, floor: float, unit: str) -> None:
    """Lines at a bound that is another than the tube's."""
    if math.isclose(best.bound, floor, rel_tol=SAME_BOUND):
        return
    name = f"{best.kind}: limsup $|e_1| \\leq$ {rounded_up(best.bound, 4)}"
    for sign in (-1, 1):
        line = ax.axhline(sign * best.bound, color=GREEN, lw=0.9, ls="-.")
    height = max(2 * floor, 1.3 * best.bound)
    ax.set_ylim(-height, height)
    for artist in (*ax.lines, *ax.collections):
        artist.set_label("_hidden")  # the legend of the whole run has them
    line.set_label(f"{name} {plain(unit)}".strip())
    add_legend(ax)
