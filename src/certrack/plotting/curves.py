"""Curves of one run or of several on one pair of axes: colours, lines, labels, legends."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from certrack.plotting.shared import BLUE, plain
from certrack.plotting.units import label_with_unit
from certrack.simulation.run import Run

#: Longer names of systems are cut in a legend, which has so many letters to an inch.
MAX_NAME, LETTERS_PER_INCH = 32, 14

#: Letters that the line and the space beside a name take in a legend.
LINE_LETTERS = 8

#: Runs by the name that the legend shows.
Runs = Mapping[str, Run]

#: The same of the shorter lines above axes.
SHORT_LINE = 6

#: Part of a figure's width that a row of axes takes, and the size of the letters counted above.
SHARE_OF_ROW, LETTER_SIZE = 0.88, 8.0

#: Marks the curves of runs among the lines of axes, so that no style is drawn twice.
CURVE_MARK = "certrack-curve"

#: Marks what the legend shows of a signal of several runs.
SIGNAL_MARK = "certrack-signal"

#: Widths of the lines of design after design: the later ones lie above and are thinner, so that
#: both are seen where they agree.
WIDTHS = (2.0, 1.3, 0.9)

#: Lines that tell the signals of several runs apart in a legend.
NEUTRAL = "#404040"

#: Lines, in the order in which they are used.
LINES = ("-", "--", ":", "-.")


def dashes(k: int) -> Any:
    """The k-th line of an endless row: solid, dashed, ..., then a dash and more and more dots."""
    return LINES[k] if k < len(LINES) else (0, (6, 1.5, *(1, 1.5) * (k - len(LINES) + 2)))


def design_style(k: int, signal: int = 0) -> dict[str, Any]:
    """Of the k-th of several runs: the run sets the colour, the signal the line."""
    colors = _colors()
    line = dashes(signal + k // len(colors))
    return {"color": colors[k % len(colors)], "ls": line, "lw": WIDTHS[min(k, len(WIDTHS) - 1)]}


def _colors() -> list[str]:
    return list(matplotlib.rcParams["axes.prop_cycle"].by_key().get("color", [BLUE]))


def next_style(ax: Axes) -> dict[str, Any]:
    """Colour and line of the next curve on the axes: those of no curve that is there."""
    colors = _colors()
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
    """Signal of the k-th run; of one run, the signal sets the colour."""
    name, run = list(runs.items())[k]
    if len(runs) == 1:
        style_of = next_style(ax) if color is None else {"color": color}
        shown = f"{short_name(name)}: {label}" if named and name else label
        mark = CURVE_MARK if color is None else None
        ax.plot(run.t, values, label=shown, gid=mark, **style_of)
        return
    signals = [line.get_label() for line in ax.lines if line.get_gid() == SIGNAL_MARK]
    if label not in signals:  # the legend shows the line without a colour
        signals.append(label)
        ax.plot([], [], label=label, color=NEUTRAL, ls=dashes(len(signals) - 1), gid=SIGNAL_MARK)
    ax.plot(run.t, values, **design_style(k, signals.index(label)))


def short_name(name: str) -> str:
    """A name of a system as a legend has room for."""
    return plain(name if len(name) <= MAX_NAME else f"...{name[-MAX_NAME:]}")


def run_lines(runs: Runs) -> tuple[list[Line2D], list[str]]:
    """What a legend shows of several runs: their lines and names."""
    lines = [Line2D([], [], **design_style(k)) for k in range(len(runs))]
    return lines, [short_name(name) for name in runs]


def name_systems(drawing: Figure, runs: Runs) -> None:
    """One legend of the figure for the systems, where there are several."""
    if len(runs) == 1:
        return
    lines, names = run_lines(runs)
    letters = drawing.get_figwidth() * LETTERS_PER_INCH
    columns = max(1, min(len(names), int(letters / (max(map(len, names)) + LINE_LETTERS))))
    drawing.legend(lines, names, loc="outside upper center", ncols=columns, handlelength=3)


def label_axes(ax: Axes, label: str, unit: str, runs: Runs, *, named: bool) -> None:
    """Labels, margin and legend."""
    ax.set_xlabel("time [s]")
    label_with_unit(ax, label, unit)
    if not named:
        add_legend(ax)
        return
    handles, labels = ax.get_legend_handles_labels()
    if len(runs) > 1:
        lines, names = run_lines(runs)
        handles, labels = [*handles, *lines], [*labels, *names]
        ax.legend(handles, labels, loc="center left", bbox_to_anchor=(1.0, 0.5))
        return
    ax.legend(handles, labels, ncols=1 if any(runs) else 3, loc="best")


def add_legend(ax: Axes, row: Sequence[Axes] = ()) -> None:
    """The legend above the axes, at their right end: off the curves.

    Parameters
    ----------
    ax : Axes
    row : sequence of Axes, optional
        Whose entries it has, each once; those of `ax` if left out.
    """
    shown: dict[str, Any] = {}
    for side in row or (ax,):
        for handle, label in zip(*side.get_legend_handles_labels(), strict=True):
            shown.setdefault(str(label), handle)
    if not shown:
        return
    entries = [*map(_letters, shown)]
    drawing = ax.get_figure()
    assert drawing is not None
    inches = float(drawing.get_figwidth()) * SHARE_OF_ROW  # type: ignore[union-attr]
    columns = _columns_that_fit(entries, inches * LETTERS_PER_INCH * LETTER_SIZE / _legend_size())
    ax.legend(
        list(shown.values()),
        list(shown),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        handlelength=1.6,
        columnspacing=1.2,
    ).set_in_layout(False)  # it may be wider than the last of two columns
    lines = -(-len(entries) // columns)
    ax.set_title("\n".join([" "] * lines), fontsize=_legend_size())  # room for it


def _letters(label: str) -> int:
    """Letters that an entry of a legend takes, with its line."""
    return len(re.sub(r"[${}_^]", "", re.sub(r"\\[a-z]+", "x", label))) + SHORT_LINE


def _columns_that_fit(letters: Sequence[int], room: float) -> int:
    """The most columns, filled one after the other, within so many letters."""
    for columns in range(len(letters), 1, -1):
        rows = -(-len(letters) // columns)
        widths = [max(letters[k : k + rows]) for k in range(0, len(letters), rows)]
        if sum(widths) <= room:
            return columns
    return 1


def _legend_size() -> float:
    return float(matplotlib.rcParams["legend.fontsize"])
