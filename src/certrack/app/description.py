"""What a page knows of a system before it has run: names, units, gains, limits, the form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from certrack.app.form import form_of
from certrack.app.frames import FrameKind, pack_frame
from certrack.app.gains import movable_gains
from certrack.app.profiles import reference_record
from certrack.core.errors import CertrackError, InputError
from certrack.core.rationals import float_of
from certrack.simulation.metrics import METRIC_LABELS, settling_band
from certrack.systems.system import System


def system_frame(
    system: System, text: str, name: str, file: Mapping[str, str] | None = None
) -> bytes:
    """All that the page shows of a text that loads.

    Parameters
    ----------
    system : System
    text, name : str
        Its file.
    file : mapping, optional
        ``name`` and ``digest`` of what it was read from, below the folder of the server.
    """
    plant, settings, drive = system.plant, system.settings, system.implementation
    units = list(plant.units or ("",) * (plant.n + 1))
    header = {
        "name": name,
        "file": file,
        "title": system.title,
        "text": text,
        "problem": None,
        "law": system.law.kind,
        "states": list(plant.states),
        "units": ["" if unit == "1" else unit for unit in units],
        "estimates": [z.name for z in system.controller.states],
        "estimated": _true_values(system),
        "gains": [gain.record() for gain in movable_gains(system)],
        "feedforward": feedforward_of(system),
        "duration": settings.duration,
        "band": settling_band(settings, system.reference),
        "tail": settings.tail_start,
        "metrics": METRIC_LABELS,
        "drive": drive is not None,
        "period": None if drive is None else drive.period,
        "limits": None if drive is None or drive.saturation is None else list(drive.saturation),
        "population": system.population is not None,
        "form": form_of(text),
        "reference": reference_record(system, text),
    }
    return pack_frame(FrameKind.SYSTEM, header)


def refusal_frame(
    problem: CertrackError, text: str, file: Mapping[str, str] | None = None
) -> bytes:
    """What is wrong with a text, where it is known with its line and key."""
    line = problem.line if isinstance(problem, InputError) else None
    key = problem.key if isinstance(problem, InputError) else ""
    problem_record = {"message": str(problem), "line": line, "key": key}
    header = {"text": text, "file": file, "problem": problem_record}
    return pack_frame(FrameKind.SYSTEM, header)


def feedforward_of(system: System) -> dict[str, Any] | None:
    """The order of the feed-forward, with what it may be; None if the law has none to choose."""
    law = system.law
    try:
        order = law.order(system.plant)
    except CertrackError:
        return None
    if order != law.feedforward or system.plant.n < 2:
        return None
    smooth = system.reference.order
    most = system.plant.n - 1
    if math.isfinite(smooth):
        most = max(order, min(most, int(smooth) - 1))
    return {"value": order, "most": most, "path": "law.feedforward"}


def _true_values(system: System) -> list[dict[str, Any]]:
    """True value and range of each estimate, where they are known and constant."""
    plant, truth = system.plant, system.truth
    values: list[dict[str, Any]] = []
    for z in system.controller.states:
        entry: dict[str, Any] = {"value": None, "range": None}
        if not truth.states:
            if z.name == "delta_hat":
                entry["value"] = _inverse(_number(truth.input_gain))
                entry["range"] = _inverse_range(plant.input_gain_range)
            elif z.name.startswith("theta_hat_"):
                index = int(z.name.rpartition("_")[2]) - 1
                entry["value"] = _number(truth.theta[index]) if truth.theta else None
                ranges = plant.theta_range
                entry["range"] = None if ranges is None else list(map(_number, ranges[index]))
        values.append(entry)
    return values


def _number(value: Any) -> float | None:
    """A number, or a formula that is one."""
    expr = getattr(value, "expr", value)
    try:
        return float_of(expr) if hasattr(expr, "free_symbols") else float(expr)
    except (TypeError, ValueError, ArithmeticError):
        return None


def _inverse(value: float | None) -> float | None:
    return None if not value else 1 / value


def _inverse_range(ends: Any) -> list[float] | None:
    if ends is None:
        return None
    low, high = (_inverse(_number(end)) for end in ends)
    return None if low is None or high is None else sorted((low, high))
