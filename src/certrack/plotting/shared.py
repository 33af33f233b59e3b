"""What all pictures share: style, colours, figures and titles, labels, few ticks, writing."""

from __future__ import annotations

import io
import math
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.core.files import write_folder
from certrack.plotting.appearance import PAGE, Appearance

#: Colours of curves, in the order in which they are used.
BLUE, RED, GREEN, GOLD, PURPLE = "#0b61a4", "#d1495b", "#2e8b57", "#edae49", "#6a4c93"
TEAL, BROWN, GRAY = "#00798c", "#8c564b", "#7f7f7f"

#: Width of a figure in inches: the text of a page, with room for legends.
PAGE_WIDTH = 6.5

#: Dots per inch of PNG pictures: fine enough for print.
DPI = 170

#: What the formats write of the time and the program.
STAMPS = {"png": ("Software",), "svg": ("Date",), "pdf": ("CreationDate", "Creator", "Producer")}

#: Times shorter than this, in seconds, are shown in milliseconds.
MILLISECONDS_BELOW = 0.1

#: Decades of a logarithmic axis: with fewer than the first, ticks lie as on a linear axis; with
#: fewer than the second, at 1, 2 and 5; with more than the third, labels are powers of ten.
LINEAR_DECADES, DENSE_DECADES, POWER_DECADES = 0.7, 2, 5

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
    "pdf.fonttype": 42,
    "svg.hashsalt": "certrack",
    "axes.prop_cycle": cycler(color=[BLUE, RED, GREEN, GOLD, PURPLE, TEAL, BROWN, GRAY]),
}


def style(appearance: Appearance = PAGE) -> AbstractContextManager[None]:
    """Context in which certrack draws.

    Parameters
    ----------
    appearance : Appearance

    Returns
    -------
    context manager

    Examples
    --------
    >>> import certrack
    >>> from matplotlib.figure import Figure
    >>> with certrack.plotting.style():
    ...     ax = Figure().subplots()
    """
    return matplotlib.rc_context(STYLE | appearance.changes)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that size in inches, whose parts do not overlap."""
    return Figure(figsize=(width, height), layout="constrained")


def plain(text: str) -> str:
    """A user's text as it is: no dollar of it begins a formula."""
    return text.replace("$", r"\$")


def set_title(drawing: Figure, title: str) -> None:
    """The title above all panels of a figure."""
    size = 1 + float(matplotlib.rcParams["axes.titlesize"])
    drawing.suptitle(plain(title), fontsize=size, fontweight="bold")


def in_brackets(unit: str) -> str:
    """A unit as the end of a label; nothing where there is none."""
    return f" [{plain(unit)}]" if unit not in ("", "1") else ""


def time_unit(*times: float) -> tuple[float, str]:
    """Factor and unit in which these times in seconds are short numbers."""
    typical = np.exp(np.mean(np.log(times)))
    return (1e3, "ms") if typical < MILLISECONDS_BELOW else (1.0, "s")


def few_ticks(ax: Axes) -> None:
    """Labels that do not touch on a logarithmic axis of any span."""
    low, high = ax.get_xlim()
    decades = math.log10(high) - math.log10(low)
    if decades < LINEAR_DECADES:
        locator: ticker.Locator = ticker.MaxNLocator(4, steps=[1, 2, 5, 10])
    elif decades < DENSE_DECADES:
        locator = ticker.LogLocator(subs=(1.0, 2.0, 5.0))
    else:
        locator = ticker.LogLocator(numticks=6)
    formatter: ticker.Formatter = ticker.StrMethodFormatter("{x:g}")
    if decades > POWER_DECADES:
        formatter = ticker.LogFormatterSciNotation()
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(formatter)
    ax.xaxis.set_minor_formatter(ticker.NullFormatter())


def as_svg(drawing: Figure) -> str:
    """A figure as SVG: the same figure gives the same text."""
    return _written(drawing, "svg").decode()


def save_figure(drawing: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG, SVG and PDF; returns the paths.

    Parameters
    ----------
    drawing : Figure
    folder : path
        Made if it does not exist.
    name : str
        Of the files, without extension.

    Returns
    -------
    list of Path

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> from pathlib import Path
    >>> drawing = certrack.plotting.overview({"": run})
    >>> [path.name for path in certrack.plotting.save_figure(drawing, Path("pictures"), "run")]
    ['run.png', 'run.svg', 'run.pdf']
    """
    engine = drawing.get_layout_engine()
    pictures = {}
    try:
        for kind in STAMPS:
            pictures[f"{name}.{kind}"] = _written(drawing, kind)
            drawing.set_layout_engine(None)  # laid out by the first, which takes as long as a file
    finally:
        drawing.set_layout_engine(engine)
    return list(write_folder(folder, pictures))


def _written(drawing: Figure, kind: str) -> bytes:
    buffer = io.BytesIO()
    with style():  # no stamp: the same figure gives the same bytes
        drawing.savefig(buffer, format=kind, dpi=DPI, metadata=dict.fromkeys(STAMPS[kind]))
    return buffer.getvalue()
