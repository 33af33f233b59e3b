"""An ensemble on a Dask cluster of this machine, one worker of which is killed: `make bench`.

Four workers of one thread, in processes of their own. What counts is the processor time of all
processes, the starts of the workers left out, against the same members without a cluster.
"""

import os
import resource
import signal
import sys
import time
from pathlib import Path

import pytest

import certrack

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from clusters import local_cluster

MEMBERS = 1_000_000
WORKERS = 4

#: Processor time over that without a cluster that is wanted at most, and beyond which something
#: has gone wrong: the killed worker's chunks are computed twice, and the machine may be busy.
WANTED, MOST = 1.15, 3.0


def spent_by(pids):
    """Processor time of processes so far, s."""
    ticks = 0
    for pid in pids:
        words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        ticks += sum(map(int, words[11:13]))  # user, system
    return ticks / os.sysconf("SC_CLK_TCK")


def own():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


@pytest.mark.filterwarnings("ignore")  # of Dask, of a worker that died
@pytest.mark.parametrize("kills", [True, False])
def test_overhead(kills, report):
    distributed = pytest.importorskip("distributed")
    system = certrack.load("example1")
    certrack.ensemble(system, 64)  # compiles, and finds the limit
    begin = own()
    here = certrack.ensemble(system, MEMBERS, threads=1)
    alone = own() - begin
    with (
        local_cluster(WORKERS) as cluster,
        distributed.Client(cluster) as client,
    ):
        certrack.ensemble(system, WORKERS * 64, chunk=16, client=client)  # imports
        first = set(client.run(os.getpid).values())
        before, begin, lost, victim = spent_by(first), own(), 0.0, max(first)

        def progress(done, total, worst):
            nonlocal lost
            if kills and not lost and done > total / 4:
                lost = spent_by([victim])
                os.kill(victim, signal.SIGKILL)

        clock = time.perf_counter()
        there = certrack.ensemble(system, MEMBERS, client=client, progress=progress)
        wall = time.perf_counter() - clock
        last = set(client.run(os.getpid).values())
        merging = own() - begin
        workers = spent_by(last) + lost - before  # with the imports of the one that came instead
    assert bool(lost) is kills
    assert there.summary()["tail_error"] == here.summary()["tail_error"]
    assert (there.statistics.bands.counts == here.statistics.bands.counts).all()
    ratio = (workers + merging) / alone
    report(
        f"{MEMBERS} members, {'one worker killed' if kills else 'no worker killed'}: "
        f"{alone:.2f} s alone, {workers:.2f} s in {WORKERS} workers and {merging:.2f} s here, "
        f"{ratio:.2f} times as much, wanted {WANTED}; {wall:.1f} s by the clock"
    )
    assert ratio < MOST
