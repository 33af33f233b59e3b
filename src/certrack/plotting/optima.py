"""The picture of optimal trajectories beside the run of the law."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from certrack.plotting.shared import PAGE_WIDTH, in_brackets, new_figure, set_title, style

if TYPE_CHECKING:
    from certrack.studies.optimal.goal import Goal
    from certrack.studies.optimal.optimal import Optima

#: Legend of an optimum by what is minimised.
LEAST_FORMULAS = {
    "squared_error": r"least $\int e_1^2\,dt$",
    "energy": r"least $\int u^2\,dt$",
    "peak": r"least $\max|u|$",
    "time": "shortest time",
}

#: A limit as it is written in the legend.
LIMIT_FORMULAS = {"squared_error": r"\int e_1^2", "energy": r"\int u^2", "peak": "|u|"}

#: So many settling times of the law are shown: what differs is the transient.
SHOWN_SETTLING_TIMES = 3.0


def optima_figure(result: Optima, title: str) -> Figure:
    """Output and input of the law and of the optima, over the transient.

    Parameters
    ----------
    result : Optima
    title : str

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> found = certrack.optimal(certrack.load("example1"), "energy", squared_error=0.2, horizon=3)
    >>> len(certrack.plotting.optima_figure(found, "").axes)
    2
    """
    run = result.run
    units = run.system.plant.units
    output, force = (units[0], units[-1]) if units else ("", "")
    settled = SHOWN_SETTLING_TIMES * result.law.time
    end = min(result.horizon, settled) if math.isfinite(settled) and settled else result.horizon
    with style():
        drawing = new_figure(PAGE_WIDTH, 4.2)
        above, below = drawing.subplots(2, 1, sharex=True)
        above.plot(run.t, run.y_d, color="k", ls="--", lw=1.0, label="reference $y_d$")
        above.plot(run.t, run.x[0], color="k", lw=1.0, label="law")
        below.plot(run.t, run.u, color="k", lw=1.0)
        shown = [run.u[run.t <= end]]
        for entry in filter(lambda optimum: optimum.converged, result.optima):
            limits = (
                rf"{LIMIT_FORMULAS[name]} \leq {value:.3g}"
                for name, value in entry.goal.limits.items()
            )
            label = f"{LEAST_FORMULAS[entry.goal.minimised]} with ${', '.join(limits)}$"
            above.plot(entry.times, entry.output, label=label)
            both_ends = np.array([entry.ends[:-1], entry.ends[1:]]).T.reshape(-1)
            below.plot(both_ends, entry.inputs.T.reshape(-1))
            shown.append(entry.inputs[:, entry.ends[:-1] <= end].reshape(-1))
        above.set_ylabel(f"output{in_brackets(output)}")
        below.set_ylabel(f"input{in_brackets(force)}")
        below.set_xlabel("time [s]")
        below.set_xlim(0.0, end)
        low, high = (f(np.concatenate(shown)) for f in (np.min, np.max))
        below.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
        drawing.legend(loc="outside lower center", ncols=2)
        if title:
            set_title(drawing, title)
    return drawing


def _label(goal: Goal) -> str:
    limits = [rf"{LIMIT_FORMULAS[name]} \leq {value:.3g}" for name, value in goal.limits.items()]
    return (
        f"{LEAST_FORMULAS[goal.minimised]} with ${', '.join(limits)}$"
        if limits
        else LEAST_FORMULAS[goal.minimised]
    )
