"""The picture of a front: the best objective against one limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from certrack.plotting.shared import (
    RED,
    few_ticks,
    in_brackets,
    new_figure,
    set_title,
    style,
    time_unit,
)

if TYPE_CHECKING:
    from certrack.tuning.result import Front

#: The objective's axis is logarithmic where it changes by more than this factor.
LOGARITHMIC_FROM = 10.0

#: Quantities of a front that are times.
TIMES = ("period", "delay margin")


def front_figure(front: Front, title: str, units: Sequence[str] | None = None) -> Figure:
    """The best objective for each value of the swept limit.

    Parameters
    ----------
    front : Front
    title : str
    units : texts, optional
        Of the plant's states and the input.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> from certrack.tuning.result import FrontPoint
    >>> points = (FrontPoint(0.05, 1e-3), FrontPoint(0.1, 2e-3), FrontPoint(0.2, None))
    >>> front = certrack.Front("period", "error", points)
    >>> len(certrack.plotting.front_figure(front, "").axes)
    1
    """
    factor, unit = (
        time_unit(*(p.limit for p in front.points)) if front.limit in TIMES else (1.0, "")
    )
    feasible = [(factor * p.limit, p.objective) for p in front.points if p.objective is not None]
    lost = [factor * p.limit for p in front.points if p.objective is None]
    output, force = (units[0], units[-1]) if units else ("", "")
    with style():
        drawing = new_figure(4.5, 3.2)
        ax = drawing.subplots()
        if feasible:
            ax.plot(*zip(*feasible, strict=True), ".-")
            sizes = [size for _, size in feasible]
            if max(sizes) > LOGARITHMIC_FROM * min(sizes):
                ax.set_yscale("log")
        ax.set_xscale("log")
        for value in lost:
            ax.axvline(value, color=RED, ls=":", lw=1.0)
        if lost:
            ax.axvline(lost[0], color=RED, ls=":", lw=1.0, label="nothing keeps all limits")
            drawing.legend(loc="outside lower center")
        ax.set_xlabel(f"{front.limit}{in_brackets(unit or _unit_of(front.limit, output, force))}")
        estimate = "error, estimated" if front.objective == "error" else front.objective
        ax.set_ylabel(f"{estimate}{in_brackets(_unit_of(front.objective, output, force))}")
        ax.use_sticky_edges = False
        few_ticks(ax)
        set_title(drawing, title)
    return drawing


def _unit_of(quantity: str, output: str, force: str) -> str:
    return {"error": output, "peak input": force}.get(quantity, "")
