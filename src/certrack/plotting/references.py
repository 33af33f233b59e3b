"""The picture of a reference: y_d and its derivatives, each with its bound."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.plotting.shared import GRAY, PAGE_WIDTH, in_brackets, new_figure, style
from certrack.references import Reference

#: What the derivatives are called, and the most that are drawn.
NAMES = ("position", "speed", "acceleration", "jerk", "snap")

#: Points of a stretch between two breaks, just inside its ends and between.
POINTS_BETWEEN = np.concatenate([[1e-9], np.linspace(0, 1, 120)[1:-1], [1 - 1e-9]])

#: Height of a panel, inches.
HEIGHT = 1.45

#: A bound is drawn on the sides on which a curve reaches this share of it.
NEAR = 0.7

#: What stands after the s of a unit.
POWERS = ("", "", "²", "³", "⁴")


def reference_figure(
    references: Mapping[str, Reference],
    duration: float,
    order: int | None = None,
    unit: str = "",
    *,
    bounds: bool = True,
) -> Figure:
    """y_d and its derivatives over time, one panel each, with their bounds as dashed lines.

    Parameters
    ----------
    references : mapping
        By the names that the legend shows; an empty name has no entry.
    duration : float, s
    order : int, optional
        The highest derivative, at most 4; the lowest of their orders if left out.
    unit : str
        Of the output.
    bounds : bool
        Whether the bounds of the first one are drawn.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If there is no reference, or one has no derivative of this order.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("point-to-point")
    >>> figure = certrack.plotting.reference_figure({"": system.reference}, 2.0, unit="m")
    >>> [axes.get_ylabel() for axes in figure.axes][:2]
    ['position [m]', 'speed [m/s]']
    """
    if not references:
        raise InputError("references", "must name at least one")
    duration = checks.real("duration", duration, above=0)
    most = int(min(len(NAMES) - 1, *(r.order for r in references.values())))
    order = most if order is None else checks.integer("order", order, 0, most)
    with style():
        drawing = new_figure(PAGE_WIDTH, 0.5 + HEIGHT * (order + 1))
        panels = drawing.subplots(order + 1, 1, sharex=True, squeeze=False)[:, 0]
        for name, reference in references.items():
            edges = np.concatenate([[0.0], reference.breaks(0.0, duration), [duration]])
            t = (edges[:-1, None] + np.diff(edges)[:, None] * POINTS_BETWEEN).ravel()
            for ax, row in zip(panels, reference.values(t, order), strict=True):
                ax.plot(t, row, lw=1.1, label=name)
        first = next(iter(references.values()))
        for i, ax in enumerate(panels):
            if bounds:
                limit = first.bounds(i).values[i]
                low, high = ax.dataLim.intervaly
                reached = {-limit: low < -NEAR * limit, limit: high > NEAR * limit}
                for side in (side for side, near in reached.items() if near):
                    ax.axhline(side, color=GRAY, lw=0.7, ls="--", zorder=0)
            per = f"{unit}/s{POWERS[i]}" if unit and i else unit
            ax.set_ylabel(NAMES[i] + in_brackets(per))
            ax.margins(x=0.01, y=0.12)
        panels[-1].set_xlabel("time [s]")
        if any(references):
            panels[0].legend(loc="best", frameon=False)
        drawing.align_ylabels(panels)
    return drawing
