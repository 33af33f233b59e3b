"""The jobs of workers: from a text and gains to a frame."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from certrack.app.description import refusal_frame, system_frame
from certrack.app.form import with_entries, with_numbers, with_reference_table
from certrack.app.frames import FrameKind, pack_frame
from certrack.app.guarantee import certificates_frame, estimate_frame
from certrack.app.messages import require_text_size
from certrack.app.open_design import Designs, OpenDesign, continuous_law, nominal_law
from certrack.app.order import names_typed, with_states
from certrack.app.profiles import REFERENCE_TEMPLATES, reference_of_kind
from certrack.app.responses import run_frame
from certrack.app.written_law import law_frame
from certrack.certificates.certify import certify
from certrack.certificates.estimates.estimate import (
    NEARBY_ACCURACY,
    BoundEstimate,
    estimate,
)
from certrack.core import checks
from certrack.core.errors import CertrackError
from certrack.systems.shipped import starter
from certrack.systems.system import System

Job = Mapping[str, Any]
Sender = Callable[[bytes], None]

#: By which part the bound that follows a moving gain may be above the least: less than is seen.
#: A gain moves where the last bound was asked for less than so long ago, s.
MOVE_ACCURACY, STILL_MOVING = 1e-4, 0.5


class JobContext:
    """What a worker keeps between jobs."""

    def __init__(self) -> None:
        self.designs = Designs()
        self.bound_asked = -math.inf

    def open(self, job: Job) -> OpenDesign:
        """The design of a job."""
        folder = job.get("folder")
        return self.designs.of(job["text"], job["name"], None if folder is None else Path(folder))

    def system(self, job: Job) -> System:
        """The system of a job, with its gains."""
        return self.open(job).with_gains(job.get("gains", {}))


def _warm(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """Compile what the first page opens."""
    try:
        design = context.open(job)
        if job["role"] == "run":
            context.designs.run(continuous_law(design.system) or design.system)
        elif job["role"] == "bound":
            design.warm = estimate(design.system)
    except CertrackError:  # the page will be told
        pass
    return pack_frame(FrameKind.NOTE, {"note": "ready"})


def _run(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """Responses; of a drive those of the continuous law, which are at hand at once."""
    system = context.system(job)
    if not job["sampled"]:
        system = continuous_law(system) or system
    run = context.designs.run(system)
    counters = {"design": job["design"], "view": job["view"]}
    window = None if job["window"] is None else (job["window"][0], job["window"][1])
    return run_frame(run, window, job["pixels"], began=began, **counters)


def _bound(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """The bound in floats, which begins where the last one ended."""
    design = context.open(job)
    system = design.with_gains(job["gains"])
    moving = began - context.bound_asked < STILL_MOVING
    context.bound_asked = began
    accuracy = MOVE_ACCURACY if moving else NEARBY_ACCURACY
    design.warm = estimate(system, warm=design.warm, accuracy=accuracy)
    return estimate_frame(design.warm, job["design"], began)


def _exact(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """All certificates."""
    design = context.open(job)
    system = design.with_gains(job["gains"])
    near = design.warm = estimate(system, warm=design.warm)
    results = certify(system, job["effort"], progress, warm=near)
    counters = {"effort": job["effort"], "design": job["design"], "began": began}
    return certificates_frame(system, results, near, nominal=_nominal(system, near), **counters)


def _nominal(system: System, near: BoundEstimate) -> BoundEstimate | None:
    """A bound that tells its causes, where that of the drive or of ranges does not."""
    nominal = None if near.shares else nominal_law(system)
    return None if nominal is None else estimate(nominal)


def _describe(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """What a page shows of a text, after its entries were changed, or what is wrong with it."""
    text = job["text"]
    try:
        if job.get("entries"):
            text = _edited(context, job)
        require_text_size(job["name"], text.encode())
        design = context.open({**job, "text": text})
    except CertrackError as problem:
        return refusal_frame(problem, text, job.get("file"))
    return system_frame(design.system, text, job["name"], job.get("file"))


def _edited(context: JobContext, job: Job) -> str:
    """The text with entries changed; another kind of reference brings entries of its own."""
    entries = dict(job["entries"])
    text: str = job["text"]
    if job["gains"]:
        text = with_numbers(text, job["gains"])
    kind = entries.pop("reference.kind", None)
    if kind is not None:
        kind = checks.choice("reference.kind", kind, REFERENCE_TEMPLATES)
        text = with_reference_table(text, reference_of_kind(kind, context.open(job).system))
    if "plant.states" in entries:
        text = with_states(text, names_typed(entries["plant.states"]))
    return with_entries(text, entries)


def _source(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """A shipped system, or the commented empty plant."""
    text = starter(job["name"] or None)
    name = f"{job['name'] or 'my-drive'}.toml"
    return _describe(context, {**job, "text": text, "name": name}, began, send, progress)


def _text(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """The text with the gains that the sliders have now."""
    text = with_numbers(job["text"], job["gains"])
    return pack_frame(FrameKind.TEXT, {"text": text}, design=job["design"])


def _law(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """Plant and law as formulas."""
    return law_frame(context.system(job), job["design"])


def _task(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """A long computation; its own last frame is the answer."""
    from certrack.app.long_tasks import run_task

    system = context.open({**job, "text": with_numbers(job["text"], job["gains"])}).system
    return run_task(job["task"], system, job["options"], job["design"], send)


def _export(context: JobContext, job: Job, began: float, send: Sender, progress: Any) -> bytes:
    """The design as a file."""
    from certrack.app.exports import exported_file
    from certrack.app.task_progress import TaskProgress

    report = TaskProgress("export", job["design"], send).part("steps")
    text = with_numbers(job["text"], job["gains"])
    system = context.open({**job, "text": text}).system
    name, data = exported_file(system, text, job["name"], job["format"], report)
    header = {"name": name, "seconds": round(time.perf_counter() - began, 2)}
    return pack_frame(FrameKind.FILE, header, data=data, design=job["design"])


#: What a worker is asked to do.
JOBS: Mapping[str, Callable[..., bytes]] = {
    "warm": _warm,
    "run": _run,
    "bound": _bound,
    "exact": _exact,
    "describe": _describe,
    "source": _source,
    "text": _text,
    "law": _law,
    "task": _task,
    "export": _export,
}
