"""How fast the product is here and now, for tests that refuse what takes much too long.

The machines that run the tests are shared and of several kinds, so a limit in seconds says nothing
by itself. Where one is written down, it is of a machine that loads the starter file in 20 ms, and
what a test allows is scaled by what that takes beside it: a ratio within one run, which also holds
where the coverage of lines is measured.

`python tests/pace.py` ends with 1 on a machine that has no time for that coverage, which makes the
tests half as long again.
"""

import sys
import time
from contextlib import contextmanager

import certrack

#: Processor time of a load of the starter file where the limits were written down, s.
LOAD_SECONDS = 0.02

#: The same on the slowest machine that is quick enough to measure the coverage of all tests, s.
QUICK_LOAD_SECONDS = 0.014


def load_seconds() -> float:
    """Processor time of a load here and now, s."""
    text = certrack.starter()
    certrack.loads(text)  # what is imported or compiled once
    begin = time.process_time()
    for _ in range(5):
        certrack.loads(text)
    return (time.process_time() - begin) / 5


def pace() -> float:
    """How many times as long as there a load takes; at least 1."""
    return max(1.0, load_seconds() / LOAD_SECONDS)


def too_long(spent: float, seconds: float) -> bool:
    """Whether the processor time that was spent is above a limit of that machine."""
    return spent > seconds and spent > seconds * pace()


@contextmanager
def within(seconds: float):
    """What is done inside must not take longer, in processor time of all threads together."""
    begin = time.process_time()
    yield
    spent = time.process_time() - begin
    assert not too_long(spent, seconds), f"{spent:.2f} s of processor time, {seconds:g} allowed"


if __name__ == "__main__":
    sys.exit(load_seconds() > QUICK_LOAD_SECONDS)
