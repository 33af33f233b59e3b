"""kill -9 at many random moments: the same call goes on and ends with the same bytes."""

import os
import subprocess
import sys

import pytest
from depth import depth

KILLS = depth(20, 200)

#: Compiles once; then each run is a fork of its own, killed after a random time.
PROGRAM = f"""
import hashlib, os, random, signal, sys, time
from pathlib import Path
import certrack
from certrack.studies.ensembles import ensemble as module

KILLS = {KILLS}
work = Path(sys.argv[1])
system = certrack.load("example1").with_settings(duration=0.4, tail=None)
prepared, once = module._prepared, []

def compiled(*arguments):
    if not once:
        once.append(prepared(*arguments))
    return once[0]

module._prepared = compiled

def result(folder):
    found = certrack.ensemble(
        system, 6400, seed=1, limit=float("inf"), chunk=50, out=folder, threads=1, per_member=True
    )
    arrays = found.statistics.packed()
    outcomes = sorted(zip(arrays.pop("outcomes").tolist(), arrays.pop("outcome_counts").tolist()))
    state = hashlib.sha256(repr(outcomes).encode())
    for name in sorted(arrays):
        state.update(name.encode() + arrays[name].tobytes())
    return state.hexdigest(), found.computed

reference, computed = result(None)
begin = time.monotonic()
assert result(work / "whole")[0] == reference
length = time.monotonic() - begin
rng = random.Random(0)
killed = resumed = 0
for trial in range(10 * KILLS):
    folder = work / str(trial)
    for _ in range(5):
        child = os.fork()
        if child == 0:
            os.close(2)
            try:
                result(folder)
            finally:
                os._exit(0)
        time.sleep(rng.uniform(0, 0.4 * length))
        os.kill(child, signal.SIGKILL)
        killed += os.WIFSIGNALED(os.waitpid(child, 0)[1])
    again, computed = result(folder)
    assert again == reference, f"other bytes in folder {{trial}}"
    resumed += computed < 6400
    assert result(folder) == (reference, 0)
    if killed >= KILLS:
        break
print(killed, resumed, trial + 1)
"""

#: Two at once, on one folder.
TWO = """
import json, sys, certrack
system = certrack.load("example1").with_settings(duration=0.2, tail=None)
found = certrack.ensemble(system, 1000, seed=1, limit=float("inf"), chunk=20, out=sys.argv[1])
print(json.dumps({k: v for k, v in found.summary().items() if not k.startswith(("comp", "micro"))}))
"""


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_at_random_moments_it_resumes_to_the_same_bytes(tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, tmp_path],
        capture_output=True,
        text=True,
        check=False,
        timeout=1500,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    killed, resumed, trials = map(int, done.stdout.split())
    assert killed >= KILLS
    assert resumed >= trials / 2  # most were killed in the middle


@pytest.mark.slow
def test_two_processes_on_one_folder_are_refused_or_right(tmp_path):
    def start(folder):
        return subprocess.Popen(
            [sys.executable, "-c", TWO, folder],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    alone = start(tmp_path / "alone").communicate()[0]
    assert alone
    both = [start(tmp_path / "both") for _ in range(3)]
    finished = 0
    for process in both:
        out, err = process.communicate()
        if process.returncode == 0:
            finished += 1
            assert out == alone
        else:
            assert "another process computes into it" in err.splitlines()[-1]
    assert finished >= 1
    assert start(tmp_path / "both").communicate()[0] == alone
