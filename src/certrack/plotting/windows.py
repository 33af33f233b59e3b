"""Times that are shown: a transient that is short in a long run gets axes of its own.

In a run of twenty seconds all that happens may be over after one, and what remains is a line at
zero. Then a figure has two columns: the first times on the left, the rest on the right, each with
the scale of what is in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.simulation.run import Run

#: From when to when axes show, s.
Window = tuple[float, float]

#: The transient of a signal ends where it last exceeds its largest value of the second half by this
#: factor; transients are worth axes of their own if one is so many times as large and all end
#: within this part of the run.
DECAYED, DOMINANT, SHORT_PART = 3.0, 6.0, 0.15

#: The axes of the transient end this much later, rounded up to one of these numbers.
BEYOND, ROUND_TIMES = 1.25, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)

#: Space between curves and frame, as a part of their height.
FRAME = 0.08

#: Widths of the two columns, and intervals between the ticks of the first.
COLUMN_WIDTHS, TRANSIENT_TICKS = (0.36, 0.64), 3


def windows_of(runs: Iterable[Run], asked: Window | None = None) -> tuple[Window | None, ...]:
    """What the columns of a figure show: one window (None: all of the run), or two."""
    if asked is not None:
        return (asked,)
    runs = list(runs)
    end = max(float(run.t[-1]) for run in runs)
    split = split_time(end, [(run.t, signal) for run in runs for signal in (run.e[0], run.u)])
    return (None,) if split is None else ((0.0, split), (split, end))


def split_time(end: float, signals: Iterable[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """Where the transients of all signals have ended; None if none is large, or one is long."""
    ends: list[float] = []
    dominant = False
    for t, values in signals:
        sizes = np.abs(np.nan_to_num(values))
        later = sizes[t >= end / 2]
        settled = float(later.max(initial=0.0))
        above = np.flatnonzero(sizes > DECAYED * settled)
        if not len(later) or not len(above) or not settled:
            continue
        ends.append(float(t[above[-1]]))
        dominant = dominant or bool(sizes.max() > DOMINANT * settled)
    if not dominant or not 0 < max(ends) <= SHORT_PART * end:
        return None
    wanted = BEYOND * max(ends)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(power * v for v in ROUND_TIMES if power * v >= wanted)


def columns(drawing: Figure, rows: int, windows: tuple[Window | None, ...]) -> list[list[Axes]]:
    """Axes of a figure, row by row; those of a column share their times."""
    widths = COLUMN_WIDTHS if len(windows) == 2 else (1.0,)
    grid = drawing.subplots(
        rows, len(widths), sharex="col", squeeze=False, gridspec_kw={"width_ratios": widths}
    )
    if len(widths) == 2:
        for ax in grid[:, 0]:
            ax.xaxis.set_major_locator(ticker.MaxNLocator(TRANSIENT_TICKS))
    return [list(row) for row in grid]


def show_window(ax: Axes, window: Window | None, at_least: Iterable[float] = ()) -> None:
    """Limits of both axes for what is within the window; the ordinate holds `at_least`, too."""
    if window is None:
        return
    low, high = window
    ax.set_xlim(low - (0.01 * high if low == 0 else 0.0), high)  # a jump at t = 0 stays visible
    within = [*at_least, *_ends(ax, lambda x: (x >= low) & (x <= high))]
    if not within:
        return
    bottom, top = min(within), max(within)
    room = FRAME * (top - bottom) or FRAME * abs(top) or 1.0
    ax.set_ylim(bottom - room, top + room)


def largest_within(ax: Axes, window: Window | None) -> float:
    """Largest magnitude of the curves on the axes within a window."""
    low, high = window or (-math.inf, math.inf)
    ends = _ends(ax, lambda x: (x >= low) & (x <= high))
    return max(map(abs, ends), default=0.0)


def _ends(ax: Axes, where: Callable[[np.ndarray], np.ndarray]) -> list[float]:
    """Least and largest finite value of each curve there; lines of the whole width are none."""
    ends = []
    for line in ax.lines:
        if line.get_transform() != ax.transData:
            continue
        x, y = (np.asarray(v, dtype=float) for v in (line.get_xdata(), line.get_ydata()))
        seen = y[where(x)]
        seen = seen[np.isfinite(seen)]
        if len(seen):
            ends += [float(seen.min()), float(seen.max())]
    return ends
