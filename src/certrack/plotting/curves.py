"""Curves of one run or of several on one pair of axes: colours, lines, labels, legends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from certrack.plotting.shared import BLUE, plain
from certrack.simulation.run import Run

#: Longer names of systems are cut in a legend, which has so many letters to an inch.
MAX_NAME, LETTERS_PER_INCH = 32, 14

#: Letters that the line and the space beside a name take in a legend.
LINE_LETTERS = 8

#: Runs by the name that the legend shows.
Runs = Mapping[str, Run]

#: Marks the curves of runs among the lines of axes, so that no style is drawn twice.
CURVE_MARK = "certrack-curve"

#: How system after system is drawn over the others: line, width, and the share of white (of black
#: where negative) that is mixed into the colour.
LINE_STYLES = (("-", 2.4, 0.55), ("--", 1.2, 0.0), (":", 1.2, -0.45), ("-.", 0.8, -0.2))


def dashes(k: int) -> Any:
    """The k-th line of an endless row: solid, dashed, ..., then a dash and more and more dots."""
    plain = [line for line, *_ in LINE_STYLES]
    return plain[k] if k < len(plain) else (0, (6, 1.5, *(1, 1.5) * (k - len(plain) + 2)))


def line_style(color: Any, k: int) -> dict[str, Any]:
    """How a signal of this colour is drawn for the k-th of several systems."""
    _, width, light = LINE_STYLES[k % len(LINE_STYLES)]
    end = 1.0 if light > 0 else 0.0
    mixed = (1 - abs(light)) * np.array(to_rgb(color)) + abs(light) * end
    return {"color": tuple(mixed.tolist()), "ls": dashes(k), "lw": width}


def next_style(ax: Axes) -> dict[str, Any]:
    """Colour and line of the next curve on the axes: those of no curve that is there."""
    colors = matplotlib.rcParams["axes.prop_cycle"].by_key().get("color", [BLUE])
    count = sum(line.get_gid() == CURVE_MARK for line in ax.lines)
    return {"color": colors[count % len(colors)], "ls": dashes(count // len(colors))}


def label_once(ax: Axes, label: str) -> str | None:
    """The label, unless the legend of the axes has it already."""
    return None if label in ax.get_legend_handles_labels()[1] else label


def draw_curve(
    ax: Axes,
    runs: Runs,
    k: int,
    values: np.ndarray,
    label: str,
    color: str | None = None,
    *,
    named: bool,
) -> None:
    """Signal of the k-th run: the signal sets the colour, the run the line."""
    name, run = list(runs.items())[k]
    if len(runs) == 1:
        style_of = next_style(ax) if color is None else {"color": color}
        shown = f"{short_name(name)}: {label}" if named and name else label
        mark = CURVE_MARK if color is None else None
        ax.plot(run.t, values, label=shown, gid=mark, **style_of)
        return
    lines = {line.get_label(): line for line in ax.lines}
    if label not in lines:  # the legend shows the plain colour
        plain = {"color": color, "gid": None} if color else next_style(ax) | {"gid": CURVE_MARK}
        (lines[label],) = ax.plot([], [], label=label, **plain)
    ax.plot(run.t, values, **line_style(lines[label].get_color(), k))


def short_name(name: str) -> str:
    """A name of a system as a legend has room for."""
    return plain(name if len(name) <= MAX_NAME else f"...{name[-MAX_NAME:]}")


def run_lines(runs: Runs) -> tuple[list[Line2D], list[str]]:
    """What a legend shows of several runs: their lines and names."""
    lines = [Line2D([], [], **line_style("#404040", k)) for k in range(len(runs))]
    return lines, [short_name(name) for name in runs]


def name_systems(drawing: Figure, runs: Runs) -> None:
    """One legend of the figure for the systems, where there are several."""
    if len(runs) == 1:
        return
    lines, names = run_lines(runs)
    letters = drawing.get_figwidth() * LETTERS_PER_INCH
    columns = max(1, min(len(names), int(letters / (max(map(len, names)) + LINE_LETTERS))))
    drawing.legend(lines, names, loc="outside upper center", ncols=columns, handlelength=3)


def label_axes(ax: Axes, label: str, runs: Runs, named: bool) -> None:
    """Labels, margin and legend; the legend is beside the axes where there are several runs."""
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    ax.margins(x=0.01)  # a jump at t = 0 stays visible beside the axis
    if len(runs) == 1:
        ax.legend(ncols=1 if named and any(runs) else 3, loc="best")
        return
    handles, labels = ax.get_legend_handles_labels()
    if named:
        lines, names = run_lines(runs)
        handles, labels = [*handles, *lines], [*labels, *names]
    ax.legend(handles, labels, loc="center left", bbox_to_anchor=(1.0, 0.5))
