"""The long computations of the bottom bar: each reports its progress, and ends with one frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from certrack.app.decimation import decimate
from certrack.app.frames import FrameKind, pack_frame
from certrack.app.gains import movable_gains
from certrack.app.guarantee import output_unit
from certrack.app.optimum import optimum_result
from certrack.app.responses import curves, number_text
from certrack.app.task_progress import TaskProgress
from certrack.core import checks
from certrack.core.rounding import printed_bound
from certrack.reports.tables import BOUND_TEXT_DIGITS
from certrack.simulation.metrics import METRIC_LABELS
from certrack.systems.system import System

if TYPE_CHECKING:
    from certrack.studies.ensembles.ensemble import Ensemble
    from certrack.studies.falsifier.drive import DriveFalsification

#: Columns of pixels of the curve of a worst case.
WORST_PIXELS = 1200

#: What a page may ask for at most.
MAX_SEARCH_RUNS, MAX_ENSEMBLE, MAX_MARGIN_MEMBERS, MAX_TUNE_STARTS = 200_000, 100_000, 1000, 64

#: Members of the first fan chart that is shown, and how many times more the next one has: all the
#: early ones together cost less than a seventh of the last.
FIRST_MEMBERS, MORE_MEMBERS = 32, 8

#: Limits that a page may give to tuning.
TUNE_LIMITS = ("error", "peak_input", "energy", "period", "delay_margin", "noise")

Send = Callable[[bytes], None]


def run_task(
    task: str, system: System, options: Mapping[str, Any], design: int, send: Send
) -> bytes:
    """Carry out one of :data:`certrack.app.messages.TASKS`.

    Parameters
    ----------
    task : str
    system : System
    options : mapping
        From the page: what is missing has its default.
    design : int
        Whose answer it is.
    send : callable
        Gets the frames of the progress.

    Returns
    -------
    bytes
        The frame of the result.
    """
    progress = TaskProgress(task, design, send)
    works = {"falsify": _falsify, "ensemble": _ensemble, "margins": _margins, "tune": _tune}
    work = (works | {"optimum": optimum_result})[task]

    def frame(result: TaskResult, state: str) -> bytes:
        header, arrays = result
        return pack_frame(
            FrameKind.TASK, {"task": task, "state": state, **header}, arrays, design=design
        )

    result = work(system, options, progress, lambda early: send(frame(early, "early")))
    return frame(result, "done")


TaskResult = tuple[dict[str, Any], list[np.ndarray]]

#: Shows a result of fewer members, or the like, before all is done.
Show = Callable[[TaskResult], None]


def _integer_option(
    options: Mapping[str, Any], name: str, default: int, least: int, most: int
) -> int:
    return checks.integer(name, options.get(name, default), least, most)


def _falsify(
    system: System, options: Mapping[str, Any], progress: TaskProgress, show: Show
) -> TaskResult:
    """The worst case found, and the curve of its error."""
    from certrack.simulation.simulator import simulate
    from certrack.studies.falsifier.falsify import falsify
    from certrack.systems.writer import to_text

    budget = _integer_option(options, "budget", 6000, 100, MAX_SEARCH_RUNS)
    unit = output_unit(system)
    result = falsify(
        system,
        budget=budget,
        seed=_seed(options),
        progress=progress.part("runs", "worst so far", unit),
        certifying=progress.part("steps", at_work=lambda _: "certifying"),
    )
    drive = result.drive
    of_drive = drive is not None and math.isfinite(drive.worst_error)
    case = drive.system if drive is not None and of_drive else result.system
    worst = drive.worst_error if drive is not None and of_drive else result.worst_error
    against = result.against
    certificate = drive.certificate if drive is not None and of_drive else against
    alarm = result.alarm
    times, rows = curves(simulate(case), None)
    times, rows = decimate(times, [rows[system.plant.n]], WORST_PIXELS)
    bound = None
    if certificate is not None and certificate.exists and certificate.verified:
        bound = certificate.bound
    header = {
        "worst": worst,
        "text": number_text(worst if math.isfinite(worst) else None),
        "runs": result.evaluations,
        "spent": _runs_spent(result.evaluations, drive),
        "loop": "implemented" if of_drive else "continuous",
        "certified": None if bound is None else printed_bound(bound, BOUND_TEXT_DIGITS),
        "ratio": bound / worst if bound is not None and worst else None,
        "alarm": alarm,
        "reason": result.reason,
        "left_out": dict(result.left_out),
        "case": to_text(case),
        "stopped": result.stopped,
    }
    return header, [times, *rows]


def _runs_spent(runs: int, drive: DriveFalsification | None) -> str:
    """Of which loop the runs of a search are; a linear drive's case is found without any."""
    if drive is None:
        return str(runs)
    loop = "the loop as the drive runs it"
    of_drive = f"{drive.runs} of {loop}" if drive.runs else f"{loop} by its linear kernels"
    return f"{runs} of the continuous law; {of_drive}"


def _ensemble(
    system: System, options: Mapping[str, Any], progress: TaskProgress, show: Show
) -> TaskResult:
    """Quantile bands of every signal, and the statistics of the metrics."""
    from certrack.studies.ensembles.ensemble import ensemble
    from certrack.studies.ensembles.error_limit import limit_and_starts

    members = _integer_option(options, "members", 2000, 8, MAX_ENSEMBLE)
    seed = _seed(options)
    early = FIRST_MEMBERS
    while early * MORE_MEMBERS <= members:
        progress.say(f"the first {early} members")
        show(_fan(ensemble(system, early, seed=seed, limit=math.inf)))
        early *= MORE_MEMBERS
    progress.say("certifying the limit of the error")
    limit_and_starts(system, None)  # it is remembered
    report = progress.part("members", "worst so far", output_unit(system))
    return _fan(ensemble(system, members, seed=seed, progress=report))


def _fan(result: Ensemble) -> TaskResult:
    """Bands and statistics of an ensemble."""
    from certrack.studies.ensembles.statistics import LEVELS

    table = []
    for name, label in METRIC_LABELS.items():
        entries = result.statistics.metrics[name].summary()
        table.append([label, *(number_text(entries[q]) for q in ("50%", "95%", "99%", "max"))])
    violations = result.violations()
    header = {
        "members": result.members,
        "seed": result.seed,
        "signals": list(result.signals),
        "levels": list(LEVELS),
        "table": table,
        "outcomes": {name: count for name, count in result.statistics.outcomes.items() if count},
        "limit": result.limit,
        "limit_text": None if result.limit is None else printed_bound(result.limit),
        "limit_origin": result.limit_origin,
        "violations": violations,
        "worst": [{"error": value, "member": member} for value, member in result.statistics.worst],
    }
    bands = result.bands  # levels, signals, times
    return header, [result.t, *bands.reshape(-1, bands.shape[-1])]


def _margins(
    system: System, options: Mapping[str, Any], progress: TaskProgress, show: Show
) -> TaskResult:
    """What period, delay and saturation may become."""
    from certrack.studies.margins import margins

    members = _integer_option(options, "members", 32, 1, MAX_MARGIN_MEMBERS)
    report = progress.part("values tried")
    result = margins(system, members=members, seed=_seed(options), progress=report)
    unit = (system.plant.units or ("",))[-1]
    named = {
        "longest period, s": (result.period, ">"),
        "longest delay, s": (result.delay, ">"),
        f"lowest saturation, {unit}" if unit not in ("", "1") else "lowest saturation": (
            result.saturation,
            "<",
        ),
    }
    rows = []
    for label, (margin, sign) in named.items():
        within = number_text(margin.within)
        rows.append(
            {
                "label": label,
                "within": f"{sign} {within}" if margin.unlimited else within,
                "bounded": number_text(margin.bounded),
                "exact": number_text(margin.exact),
                "values": list(margin.values),
                "errors": list(margin.errors),
            }
        )
    header = {
        "rows": rows,
        "error": number_text(result.error),
        "origin": result.origin,
        "members": result.members,
        "at": number_text(result.at),
        "as_stated": None if result.as_given is None else number_text(result.as_given),
    }
    return header, []


def _tune(
    system: System, options: Mapping[str, Any], progress: TaskProgress, show: Show
) -> TaskResult:
    """Gains within limits, before and after."""
    from certrack.reports.tuning import price_lines, tuned_bounds
    from certrack.tuning.result import Tuned
    from certrack.tuning.tune import finishing_step, tune

    limits: dict[str, Any] = {
        name: checks.real(name, options[name], above=0)
        for name in TUNE_LIMITS
        if options.get(name) is not None
    }
    objective = options.get("objective", "error")
    starts = _integer_option(options, "starts", 2, 1, MAX_TUNE_STARTS)
    front = options.get("front") or None
    unit = output_unit(system) if objective == "error" else ""
    result: Tuned = tune(
        system,
        objective=objective,
        starts=starts,
        seed=_seed(options),
        front=front,
        progress=progress.part("starts", "best so far", unit),
        proving=progress.part("steps", at_work=finishing_step),
        sweeping=progress.part("points", "last", unit, lambda _: "front"),
        **limits,
    )
    before, after = result.before.summary(), result.after.summary()
    table = [
        [label, *(_figure(name, value) for value in values)]
        for pair in tuned_bounds(result)
        for name, (label, *values) in zip(("certified", "found"), pair, strict=True)
        if any(value is not None for value in values)
    ]
    for name, label in TUNED_LABELS.items():
        if before.get(name) is None and after.get(name) is None:
            continue
        table.append([label, *(_figure(name, figures.get(name)) for figures in (before, after))])
    header = {
        "objective": objective,
        "table": table,
        "gains": {gain.path: gain.value for gain in movable_gains(result.system)},
        "limits": list(result.limits),
        "active": price_lines(result),
        "notes": [*result.notes, *result.broken],
        "front": None
        if result.front is None
        else {
            "limit": result.front.limit,
            "objective": result.front.objective,
            "points": [[p.limit, p.objective] for p in result.front.points],
        },
    }
    return header, []


#: Figures of a tuned design that are shown.
TUNED_LABELS = {
    "tail_error": "tail error",
    "peak_input": "peak input over the starts",
    "energy": "input energy",
    "input_variation": "variation of input",
    "noise": "gain from noise to input",
    "period": "longest stable period, s",
}


def _figure(name: str, value: float | None) -> str:
    if name == "certified":
        return printed_bound(value, BOUND_TEXT_DIGITS)
    return number_text(value if value is None or math.isfinite(value) else None)


def _seed(options: Mapping[str, Any]) -> int:
    return _integer_option(options, "seed", 0, 0, 2**63 - 1)
