"""The budget of loading and verifying: spent, it ends in one line, and nothing comes after it."""

import subprocess
import sys
import threading
import time

import pytest

import certrack
from certrack.certificates import verification
from certrack.core import budget
from certrack.core.budget import resident_megabytes, within_budget
from certrack.core.errors import InputError
from certrack.systems import reader


def spin():
    while True:
        sum(range(100))


def eat():
    eaten = []
    while True:
        eaten.append(bytearray(b"x" * 1_000_000))


@pytest.mark.parametrize(
    ("work", "what"), [(spin, "0.2 s of processor time"), (eat, "300 MB of memory")]
)
def test_what_spends_its_budget_is_refused(work, what):
    with pytest.raises(InputError) as refused:
        within_budget(work, what="x", seconds=0.2 if work is spin else 60, megabytes=300)
    assert str(refused.value) == (
        f"x: is given up: it needs more than {what}. Make it simpler or set the environment "
        "variable CERTRACK_BUDGET to a factor"
    )


def test_work_that_catches_everything_is_refused_in_the_end():
    begin = time.monotonic()

    def stubborn():
        while time.monotonic() - begin < 1.5:
            try:
                spin()
            except BaseException:
                continue
        return "done"

    with pytest.raises(InputError, match="is given up"):
        within_budget(stubborn, what="x", seconds=0.1, megabytes=1000)


def test_no_exception_comes_after_the_work(monkeypatch):
    """Not even where the work ends at the moment when its budget does."""
    monkeypatch.setattr(budget, "POLL_INTERVAL", 0.001)
    refused = 0
    for i in range(60):
        begin, length = time.thread_time(), 0.02 * (0.9 + i / 200)

        def work(begin=begin, length=length):
            while time.thread_time() - begin < length:
                sum(range(100))

        try:
            within_budget(work, what="x", seconds=0.02, megabytes=1000)
        except InputError:
            refused += 1
    for _ in range(100_000):  # where an exception that is late would arrive
        pass
    assert 0 < refused < 60
    assert not [thread for thread in threading.enumerate() if "budget" in thread.name]


def test_only_its_own_thread_is_charged():
    stop = threading.Event()

    def busy():
        while not stop.is_set():
            sum(range(1000))

    others = [threading.Thread(target=busy) for _ in range(2)]
    for other in others:
        other.start()
    try:
        slept = within_budget(
            lambda: time.sleep(0.6) or "slept", what="x", seconds=0.3, megabytes=1000
        )
    finally:
        stop.set()
        for other in others:
            other.join()
    assert slept == "slept"


def test_its_own_errors_pass():
    with pytest.raises(ZeroDivisionError):
        within_budget(lambda: 1 / 0, what="x", seconds=1, megabytes=100)


def test_no_memory_is_one_line():
    def too_much():
        raise MemoryError

    with pytest.raises(InputError, match="x: needs more memory than this machine gives"):
        within_budget(too_much, what="x", seconds=1, megabytes=100)


def test_a_factor_widens_or_lifts_it(monkeypatch):
    def work():
        begin = time.thread_time()
        while time.thread_time() - begin < 0.3:
            pass
        return "done"

    monkeypatch.setenv("CERTRACK_BUDGET", "100")
    assert within_budget(work, what="x", seconds=0.1, megabytes=100) == "done"
    monkeypatch.setenv("CERTRACK_BUDGET", "0")
    assert within_budget(work, what="x", seconds=0.1, megabytes=100) == "done"
    monkeypatch.setenv("CERTRACK_BUDGET", "1")
    with pytest.raises(InputError, match="is given up"):
        within_budget(work, what="x", seconds=0.1, megabytes=100)


@pytest.mark.parametrize("factor", ["much", "-1", "inf", "nan", ""])
def test_a_factor_that_is_none_is_refused(monkeypatch, factor):
    monkeypatch.setenv("CERTRACK_BUDGET", factor)
    with pytest.raises(InputError, match="CERTRACK_BUDGET: must be a factor, or 0 for no limit"):
        certrack.load("example1")


def test_the_memory_of_the_process_is_known():
    before = resident_megabytes()
    eaten = bytearray(b"x" * 100_000_000)
    assert 80 < resident_megabytes() - before < 200
    assert 20 < before < 10_000
    del eaten


def test_loading_has_a_budget(monkeypatch):
    monkeypatch.setattr(reader, "LOAD_SECONDS", 0.1)
    monkeypatch.setattr(reader, "parse_toml", lambda text: spin())
    with pytest.raises(InputError, match=r"^drive.toml: is given up: it needs more than 0.1 s"):
        certrack.loads(certrack.starter(), "drive.toml")


def test_verifying_has_a_budget(monkeypatch, tmp_path):
    monkeypatch.setattr(verification, "VERIFY_SECONDS", 0.1)
    monkeypatch.setattr(verification, "read_document", lambda path: spin())
    with pytest.raises(InputError, match=r"cert.json: is given up: it needs more than 0.1 s"):
        verification.verify(tmp_path / "cert.json")


def test_a_profiler_works_after_loading():
    """An exception that is taken back leaves CPython 3.11 waiting; under a profiler it hangs."""
    program = (
        "import cProfile, certrack\n"
        "system = certrack.load('dual-motor-lean')\n"
        "profile = cProfile.Profile()\n"
        "profile.runcall(system.with_settings, duration=3)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
