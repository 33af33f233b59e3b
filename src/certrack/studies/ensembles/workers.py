"""Who computes the chunks: the threads of this process, or a Dask cluster.

The results are the same; only the order of completion differs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from certrack.core.errors import InputError, MissingExtra
from certrack.studies.ensembles.engine import Engine, compute_chunk
from certrack.studies.ensembles.plan import Plan, Range
from certrack.studies.ensembles.statistics import Statistics

#: Members, their statistics as arrays (None: already in the total), and the seconds spent on them
#: divided by the number of workers.
ChunkResult = tuple[Range, dict[str, np.ndarray] | None, float]

#: Members per chunk: what is lost when a run is killed, and what a worker gets at a time.
CHUNK_MEMBERS = 16_384

#: Methods whose members take microseconds.
COMPILED = ("native", "implicit")

#: Members per chunk on a cluster, at most, where they are computed by one of these: a larger one
#: spends less on sending and merging. Each worker still gets so many chunks.
CLUSTER_CHUNK_MEMBERS, CHUNKS_FOR_EACH = 4 * CHUNK_MEMBERS, 4

#: Chunks in flight per worker: enough that none waits, few enough that memory stays flat.
CHUNKS_PER_WORKER = 2


def cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def chunk_members(plan: Plan, members: int, client: Any) -> int:
    """Members per chunk, in this process or on the cluster of `client`."""
    if client is None or plan.method not in COMPILED:
        return CHUNK_MEMBERS
    each = members // (CHUNKS_FOR_EACH * max(1, len(client.scheduler_info()["workers"])))
    multiple = each // CHUNK_MEMBERS * CHUNK_MEMBERS
    return max(CHUNK_MEMBERS, min(multiple, CLUSTER_CHUNK_MEMBERS))


def in_this_process(
    engine: Engine,
    chunks: Iterable[Range],
    total: Statistics | None,
    ran: Callable[[int], None] | None = None,
) -> Iterator[ChunkResult]:
    """Compute here; the statistics are added to `total`, or each chunk's are arrays of its own.

    `ran` gets how many of a chunk are done, where members are run one by one.
    """
    for begin, end in chunks:
        clock = time.perf_counter()
        arrays = None
        if total is None:
            arrays = engine.packed(begin, end, ran)
        else:
            engine.compute(begin, end, total, ran)
        yield (begin, end), arrays, time.perf_counter() - clock


def on_cluster(plan: Plan, chunks: Iterable[Range], client: Any) -> Iterator[ChunkResult]:
    """Compute on a Dask cluster; a chunk whose worker dies is computed by another."""
    from distributed import as_completed

    everywhere = client.scatter(plan, broadcast=True)
    waiting = iter(chunks)
    workers = max(1, len(client.scheduler_info()["workers"]))
    spans: dict[Any, Range] = {}

    def submit() -> Any:
        for begin, end in waiting:
            future = client.submit(compute_chunk, everywhere, begin, end, pure=False, retries=5)
            spans[future.key] = (begin, end)
            return future
        return None

    first = [future for _ in range(CHUNKS_PER_WORKER * workers) if (future := submit()) is not None]
    queue = as_completed(first)
    for future in queue:
        arrays, spent = future.result()
        yield spans.pop(future.key), arrays, spent / workers
        if (following := submit()) is not None:
            queue.add(following)


@contextmanager
def connect(address: str) -> Iterator[Any]:
    """A client of the Dask scheduler at `address`.

    Raises
    ------
    MissingExtra
        If distributed is not installed.
    InputError
        If the scheduler cannot be reached or has no workers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtra("distributed", "cluster", "running on a Dask cluster") from None
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError, TypeError) as problem:  # the last: TLS without keys
        reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise InputError(
            "--cluster", f"cannot reach the scheduler ({reason})", address, "e.g. tcp://host:8786"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError("--cluster", "the scheduler has no workers", address)
        yield client
