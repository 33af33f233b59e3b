"""Compute the members that are not on disk, chunk by chunk, and keep what is finished."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from certrack.core.progress import Progress
from certrack.studies.ensembles import workers
from certrack.studies.ensembles.all_lost import probe_first, require_survivors
from certrack.studies.ensembles.checkpoints import Checkpoints
from certrack.studies.ensembles.corners import span_of
from certrack.studies.ensembles.engine import Engine
from certrack.studies.ensembles.plan import Plan, Range
from certrack.studies.ensembles.statistics import Statistics


def complete(
    plan: Plan,
    engine: Engine | None,
    client: Any,
    total: Statistics,
    checkpoints: Checkpoints | None,
    members: int,
    chunk: int,
    progress: Progress,
) -> tuple[int, float]:
    """Add to `total` what is on disk and compute the rest; how many, and in how many seconds."""
    covered = [] if checkpoints is None else checkpoints.load(total, members)
    missing = list(_missing(covered, members, chunk))
    wanted = sum(end - begin for begin, end in missing)
    progress(members - wanted, members, _largest(total))
    seconds = 0.0
    if engine is None:
        results = workers.on_cluster(plan, missing, client)
    else:
        parts = missing if checkpoints else list(probe_first(missing))
        results = workers.in_this_process(
            engine,
            parts,
            total if checkpoints is None else None,
            lambda part: progress(total.members + part, members, _largest(total)),
        )
    for span, arrays, spent in results if missing else ():
        covered.append(span)
        seconds += spent
        if arrays is not None:
            total.add_packed(arrays)
            if checkpoints is not None:
                checkpoints.save(span, arrays)
                checkpoints.gather(total, covered)
        progress(total.members, members, _largest(total))
        require_survivors(total, members, plan.system)
    return wanted, seconds


def complete_corners(
    plan: Plan, engine: Engine | None, client: Any, checkpoints: Checkpoints | None
) -> Statistics | None:
    """The runs at the corners of the ranges: from disk, or computed; None where there are none."""
    span = span_of(plan.system)
    if span is None:
        return None
    plan = replace(plan, per_member=True)
    stored = None if checkpoints is None else checkpoints.load_corners(span)
    if stored is not None:
        return stored
    statistics = plan.empty()
    if engine is None:
        ((_, arrays, _),) = workers.on_cluster(plan, [span], client)
        assert arrays is not None
        statistics.add_packed(arrays)
    else:
        engine.compute(*span, statistics)
    if checkpoints is not None:
        checkpoints.save_corners(span, statistics.packed())
    return statistics


def _largest(total: Statistics) -> float | None:
    """The largest tail error so far."""
    return total.worst[0][0] if total.worst else None


def _missing(covered: list[Range], members: int, chunk: int) -> Iterator[Range]:
    """Members that no range covers, cut at multiples of the chunk."""
    begin = 0
    for first, last in [*covered, (members, members)]:
        while begin < first:
            end = min(first, (begin // chunk + 1) * chunk)
            yield begin, end
            begin = end
        begin = max(begin, last)
