"""A run as curves, and as numbers in the command line's own texts."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from certrack.app.decimation import decimate
from certrack.app.frames import FrameKind, pack_frame
from certrack.loops.plant import measured
from certrack.reports.tables import short_number
from certrack.simulation.metrics import METRIC_LABELS
from certrack.simulation.run import Run

#: Points per column of pixels in a window of a run, computed anew from the dense solution.
POINTS_PER_PIXEL = 2


def run_frame(
    run: Run,
    window: tuple[float, float] | None,
    pixels: int,
    *,
    design: int,
    view: int,
    began: float,
    notes: Sequence[str] = (),
) -> bytes:
    """The curves of a run in a window: t, states, error, reference, input, estimates.

    Parameters
    ----------
    run : Run
    window : (low, high) or None, s
    pixels : int
    design, view : int
        Counters of the page.
    began : float
        ``time.perf_counter()`` when the work began.
    notes : texts
    """
    times, rows = curves(run, window, pixels)
    times, rows = decimate(times, rows, pixels)
    first = float(times[0]) if len(times) else 0.0
    system = run.system
    poles, metrics = system.controller.coordinates.poles, run.metrics.as_dict()
    header: dict[str, Any] = {
        "t0": first,
        "window": window,
        "outcome": run.outcome.name,
        "message": run.message,
        "end": run.trajectory.end,
        "steps": len(run.trajectory.times) - 1,
        "sampled": system.implementation is not None,
        "metrics": metrics,
        "texts": metric_texts(metrics),
        "poles": sorted([float(p.real), float(p.imag)] for p in poles),
        "notes": [*run.notes, *notes],
        "ms": round(1e3 * (time.perf_counter() - began), 2),
    }
    return pack_frame(FrameKind.RUN, header, [times - first, *rows], design=design, view=view)


def curves(
    run: Run, window: tuple[float, float] | None, pixels: int = 4000
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times and rows: of the whole run its own samples, of a part of it as many as are seen.

    A window that lies beside the run, such as behind its escape, has only the run's nearest end:
    there is no solution beyond it.
    """
    system, plant, end = run.system, run.system.plant, run.trajectory.end
    if window is None or (window[0] <= 0 and window[1] >= end):
        return run.t, [*run.x, run.x[0] - run.y_d, run.y_d, run.u, *run.z]
    low, high = (min(max(side, 0.0), end) for side in window)
    t = np.linspace(low, high, POINTS_PER_PIXEL * pixels)
    states = run.trajectory.interpolate(t)
    x = measured(system, states)
    y_d = system.reference.values(t, 0)[0]
    first = len(system.simulated_states)
    z = states[first : first + len(system.controller.states)]
    return t, [*x[: plant.n], x[0] - y_d, y_d, run.input_of(t, states), *z]


def metric_texts(metrics: Mapping[str, float | None]) -> dict[str, str]:
    """Metrics as the command line's table prints them."""
    return {name: number_text(metrics[name]) for name in METRIC_LABELS}


def number_text(value: float | None) -> str:
    """A number as a table of the command line shows it."""
    return "-" if value is None else short_number(value)
