"""Ratios within one run: candidates are timed in turns, so that a noisy machine hurts all alike."""

import time

import pytest


@pytest.fixture
def interleaved():
    """Time per call of each candidate: best of several rounds in which all take their turn.

    Where all work in one thread, the clock may be that of the processor, which does not count what
    others on the machine do.
    """

    def measure(candidates, rounds=9, turn=0.05, clock=time.perf_counter):
        best = dict.fromkeys(candidates, float("inf"))
        for _ in range(rounds):
            for name, call in candidates.items():
                calls, begin = 0, clock()
                while (spent := clock() - begin) < turn or not calls:
                    call()
                    calls += 1
                best[name] = min(best[name], spent / calls)
        return best

    return measure


@pytest.fixture
def report(capsys):
    """Print past pytest's capture."""

    def show(*lines):
        with capsys.disabled():
            print("\n" + "\n".join(lines))

    return show
