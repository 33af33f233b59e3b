"""The reference as the form shows it: a drawing with limits, points to be moved, other kinds."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from certrack.core.errors import CertrackError
from certrack.systems.system import System

#: The kind of a reference that is a formula and has no word in the file.
FORMULA = "formula"

#: Derivatives that each kind can have, at most; the others have all.
HIGHEST_ORDER = {
    "triangle": 1,
    "trapezoid": 1,
    "steps": 1,
    "velocity": 2,
    "scurve": 3,
    "moves": 4,
    "samples": 4,
    "polynomial": 5,
    "chirp": 5,
}

#: Times of a drawing; derivatives that it shows at most.
DRAWN_TIMES, DRAWN_ORDER = 400, 3

#: Lists whose entries can be moved in the drawing, by kind; at most so many.
MOVED_LISTS = {
    "steps": "levels",
    "moves": "positions",
    "velocity": "positions",
    "scurve": "positions",
    "polynomial": "positions",
    "samples": "values",
}
MAX_MOVED = 40

#: A point is reached where the distance to it is below this part of the range.
POINT_TOLERANCE = 1e-6


def reference_record(system: System, text: str) -> dict[str, Any]:
    """What the form draws of a reference, ready for JSON.

    Parameters
    ----------
    system : System
    text : str
        Its file.
    """
    reference, duration = system.reference, system.settings.duration
    table = tomllib.loads(text).get("reference", {})
    order = int(min(DRAWN_ORDER, reference.order))
    needed = system.controller.coordinates.q + 1
    times = np.linspace(0.0, duration, DRAWN_TIMES)
    times = np.union1d(times, reference.breaks(0.0, duration))
    values = reference.values(times, order)
    finite = np.isfinite(values)
    rows = np.where(finite, values, 0.0)
    return {
        "kind": table.get("kind", FORMULA),
        "kinds": [[k, HIGHEST_ORDER.get(k, math.inf) >= needed] for k in REFERENCE_TEMPLATES],
        "times": [float(f"{t:.6g}") for t in times],
        "rows": [[float(f"{v:.5g}") for v in row] for row in rows],
        "limits": _limits(system, order),
        "points": _points(table, times, rows),
    }


def _limits(system: System, order: int) -> list[float | None]:
    """Proven or declared bounds of y_d and its derivatives; None where there is none."""
    limits: list[float | None] = []
    for i in range(order + 1):
        try:
            value = system.reference.bounds(i).values[-1]
        except CertrackError:
            value = math.inf
        limits.append(value if math.isfinite(value) else None)
    return limits


def _points(table: Mapping[str, Any], times: np.ndarray, rows: np.ndarray) -> dict[str, Any] | None:
    """The numbers of the file that stand for points of the curve, each with its time."""
    name = MOVED_LISTS.get(table.get("kind", ""), "")
    numbers = table.get(name)
    if not isinstance(numbers, list) or not 0 < len(numbers) <= MAX_MOVED:
        return None
    if not all(isinstance(number, (int, float)) for number in numbers):
        return None  # formulas are changed in the text
    values = [float(number) for number in numbers]
    near = POINT_TOLERANCE * (float(np.ptp(rows[0])) or 1.0)
    arrivals: list[float | None] = []
    begin = 0
    for value in values:
        reached = np.flatnonzero(np.abs(rows[0, begin:] - value) <= near)
        if reached.size:
            begin += int(reached[0])
            arrivals.append(float(f"{times[begin]:.6g}"))
        else:
            arrivals.append(None)  # beyond the run, or cut off by a soft start
    return {"path": f"reference.{name}", "values": values, "times": arrivals}


def reference_of_kind(kind: str, system: System) -> dict[str, Any]:
    """Entries of a table ``[reference]`` of another kind, as large and as long as the present one.

    Parameters
    ----------
    kind : str
        One of those that :func:`reference_record` lists.
    system : System
    """
    duration = system.settings.duration
    values = system.reference.values(np.linspace(0.0, duration, DRAWN_TIMES), 0)
    size = _rounded(float(np.max(np.abs(values)))) or 1.0
    order = system.controller.coordinates.q + 1
    entries = REFERENCE_TEMPLATES[kind](size, duration, order)
    return entries if kind == FORMULA else {"kind": kind, **entries}


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


def _moves(size: float, duration: float, order: int) -> dict[str, Any]:
    """There and back, a tenth of the run each; limits up to the order that the law asks for."""
    limits = _motion_limits(size, duration)
    names = list(limits)[: max(2, order)]
    return {
        "positions": [0, size, 0],
        "dwell": _rounded(duration / 4),
        "start": _rounded(duration / 20),
        **{name: limits[name] for name in names},
    }


def _motion_limits(size: float, duration: float) -> dict[str, float]:
    """Of a move over `size` in about a tenth of the run, each phase a part of it."""
    scale = 20 / duration
    return {
        name: _rounded(size * scale ** (i + 1) * 4**i)
        for i, name in enumerate(("speed", "acceleration", "jerk", "snap"))
    }


def _with_limits(count: int) -> Any:
    def template(size: float, duration: float, order: int) -> dict[str, Any]:
        entries = _moves(size, duration, 2)
        return {**entries, **dict(list(_motion_limits(size, duration).items())[:count])}

    return template


#: First entries of each kind that the form offers, of a size, a duration and an order.
REFERENCE_TEMPLATES: Mapping[str, Any] = {
    FORMULA: lambda A, T, _: {"signal": f"{A:g}*sin({_rounded(4 * math.pi / T):g}*t)"},
    "triangle": lambda A, T, _: {"amplitude": A, "period": _rounded(T / 2)},
    "trapezoid": lambda A, T, _: {
        "amplitude": A,
        "period": _rounded(T / 2),
        "rise": _rounded(T / 16),
    },
    "steps": lambda A, T, _: {
        "times": [_rounded(T / 10), _rounded(T / 2)],
        "levels": [0, A, 0],
        "slope": _rounded(20 * A / T),
    },
    "moves": _moves,
    "velocity": _with_limits(2),
    "scurve": _with_limits(3),
    "polynomial": lambda A, T, order: {
        "positions": [0, A, 0],
        "dwell": _rounded(T / 4),
        "start": _rounded(T / 20),
        "duration": _rounded(T / 8),
        "degree": min(9, 2 * max(2, order) + 1),
    },
    "chirp": lambda A, T, order: {
        "amplitude": A,
        "frequencies": [_rounded(2 * math.pi / T), _rounded(16 * math.pi / T)],
        "duration": T,
        "smoothness": min(3, max(0, order - 2)),
    },
    "multisine": lambda A, T, _: {
        "amplitudes": [_rounded(A / 2), _rounded(A / 4)],
        "frequencies": [_rounded(4 * math.pi / T), _rounded(10 * math.pi / T)],
    },
    "samples": lambda A, T, order: {
        "times": [T * part for part in (0, 0.25, 0.5, 0.75, 1)],
        "values": [0, A, 0, -A, 0],
        **({} if order < 2 else {"interpolation": "spline", "degree": 5 if order < 4 else 7}),
    },
}
