"""Figures of runs: one panel, or all of them below each other."""

from __future__ import annotations

from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.plotting.appearance import PAGE, Appearance
from certrack.plotting.curves import Runs, add_legend, name_systems
from certrack.plotting.limits import Certified
from certrack.plotting.runs import PANELS, Panel, plot_error, plot_states, units_of
from certrack.plotting.shared import new_figure, set_title, style
from certrack.plotting.windows import Window, columns, windows_of

#: Height of a panel that stands alone, in those of one among others.
SINGLE_HEIGHT = 1.3


def panels_for(runs: Runs, certified: Certified | None = None) -> dict[str, Panel]:
    """The panels that have something to show; states of different units have one each.

    Parameters
    ----------
    runs : mapping of names to runs
    certified : mapping of names of runs to Certificates, optional
        Whose bounds and tubes the panel of the error shows.

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
    units = tuple(dict.fromkeys(units_of(runs)[:-1]))
    panels: dict[str, Panel] = {}
    for name, draw in PANELS.items():
        if name == "states" and len(units) > 1:
            for k, unit in enumerate(units):
                panels[f"states-{k + 1}" if k else "states"] = partial(plot_states, unit=unit)
        elif name != "estimates" or estimating:
            panels[name] = draw
    if certified is not None:
        panels["error"] = partial(plot_error, certified=certified)
    return panels


def figure(panel: Panel, runs: Runs, title: str = "", appearance: Appearance = PAGE) -> Figure:
    """One panel as a figure.

    Parameters
    ----------
    panel : callable
        Of :func:`panels_for`.
    runs : mapping of names to runs
    title : str
    appearance : Appearance

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> drawing = certrack.plotting.figure(certrack.plotting.plot_error, {"": run})
    """
    with style(appearance):
        width, height = appearance.extent(1.0)
        drawing = new_figure(width, height if appearance.size else SINGLE_HEIGHT * height)
        windows = windows_of(runs.values(), appearance.window)
        (row,) = columns(drawing, 1, windows)
        _draw_row(row, panel, runs, windows)
        set_title(drawing, appearance.titled(title))
        name_systems(drawing, runs)
    return drawing


def overview(
    runs: Runs, title: str = "", appearance: Appearance = PAGE, certified: Certified | None = None
) -> Figure:
    """All panels below each other.

    Parameters
    ----------
    runs : mapping of names to runs
    title : str
    appearance : Appearance
    certified : mapping of names of runs to Certificates, optional
        Whose bounds and tubes the panel of the error shows.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> drawing = certrack.plotting.overview({"example1": run})
    """
    panels = panels_for(runs, certified)
    with style(appearance):
        drawing = new_figure(*appearance.extent(len(panels)))
        windows = windows_of(runs.values(), appearance.window)
        rows = columns(drawing, len(panels), windows)
        for row, panel in zip(rows, panels.values(), strict=True):
            _draw_row(row, panel, runs, windows)
        for row in rows[:-1]:
            for ax in row:
                ax.set_xlabel("")
        drawing.align_ylabels([row[0] for row in rows])
        set_title(drawing, appearance.titled(title))
        name_systems(drawing, runs)
    return drawing


def _draw_row(
    row: list[Axes], panel: Panel, runs: Runs, windows: tuple[Window | None, ...]
) -> None:
    """A panel in its columns; the label stands before the first, the legend above the last."""
    for ax, window in zip(row, windows, strict=True):
        panel(ax, runs, named=False, window=window)
    if len(row) > 1:
        add_legend(row[-1], row)
        for ax in row[:-1]:
            if (legend := ax.get_legend()) is not None:
                legend.remove()
    for ax in row[1:]:
        _, bracket, unit = ax.get_ylabel().partition("[")
        ax.set_ylabel(f"[{unit}" if bracket else "")
