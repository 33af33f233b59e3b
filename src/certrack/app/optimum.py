"""How good any law could be, for the bottom bar: optima of the plant beside the law's own run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from certrack.app.decimation import decimate
from certrack.app.task_progress import TaskProgress
from certrack.core import checks
from certrack.systems.system import System

#: Elements of the finest mesh that a page gets: minima within a percent or so, in seconds.
PAGE_ELEMENTS = 240

#: Columns of pixels of the curves of an optimum.
OPTIMUM_PIXELS = 1200


def optimum_result(
    system: System, options: Mapping[str, Any], progress: TaskProgress, show: Callable[..., None]
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """The least squared error and the least energy that any law could have where this one is.

    Parameters
    ----------
    system : System
    options : mapping
        ``horizon``, s, and ``elements`` of the finest mesh.
    progress : TaskProgress
    show : callable
        Not called: nothing is shown early.

    Returns
    -------
    header and arrays
        The command line's table and notes; of each optimum times, error and input.

    Raises
    ------
    InputError
        Where the law's own run does not reach the horizon.
    MissingExtra
        Without CasADi.
    """
    from certrack.reports.optima import LEAST_TEXTS, optima_notes, optima_table
    from certrack.studies.optimal.mesh_search import FIRST_ELEMENTS
    from certrack.studies.optimal.optimal import MAX_ELEMENTS, optimal

    horizon = options.get("horizon")
    elements = options.get("elements", PAGE_ELEMENTS)
    result = optimal(
        system,
        horizon=None if horizon is None else checks.real("horizon", horizon, above=0),
        elements=checks.integer("elements", elements, FIRST_ELEMENTS, MAX_ELEMENTS),
        progress=progress.part("searches", "iterations"),
    )
    printed = optima_table(result)
    curves: list[np.ndarray] = []
    for entry in result.optima:
        inputs = np.interp(entry.times, np.repeat(entry.ends, 2)[1:-1], entry.inputs.T.reshape(-1))
        rows = [entry.output - entry.reference, inputs]
        times, rows = decimate(entry.times, rows, OPTIMUM_PIXELS)
        curves += [times, *rows]
    header = {
        "columns": list(printed.columns),
        "table": [list(row) for row in printed.rows],
        "notes": optima_notes(result),
        "optima": [LEAST_TEXTS[entry.goal.minimised] for entry in result.optima],
        "found": [entry.converged for entry in result.optima],
        "horizon": result.horizon,
    }
    return header, curves
