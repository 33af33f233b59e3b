"""Speed of the falsifier: `make bench`.

Adversaries drawn from all that is admitted, hard patterns of all frequencies among them, and those
that a search begins with: in compiled lanes, and by the Taylor method on a grid of 600 times.
"""

import time

import numpy as np
import pytest

import certrack
from certrack.studies.falsifier.lanes import WORTH_LANES
from certrack.studies.falsifier.loop import AdversarialLoop

#: Adversaries; the lanes must be so many times as fast.
MEMBERS, LEAST_GAIN = 96, 4


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
def test_adversaries(interleaved, report, name):
    system = certrack.load(name)
    lanes, grid = AdversarialLoop(system, WORTH_LANES), AdversarialLoop(system)
    low, high = np.array([(v.low, v.high) for v in grid.adversary.variables]).T
    drawn = np.random.default_rng(0).uniform(low, high, (MEMBERS, len(low))).T
    starts = grid.adversary.plausible_starts()
    first = np.repeat(starts, MEMBERS // len(starts), axis=0).T
    best = interleaved(
        {
            "drawn, lanes": lambda: lanes.errors(drawn),
            "drawn, grid": lambda: grid.errors(drawn),
            "first, lanes": lambda: lanes.errors(first),
            "first, grid": lambda: grid.errors(first),
        },
        clock=time.process_time,
    )
    report(name, *(f"{kind:14s}{1e6 * s / MEMBERS:7.1f} us" for kind, s in best.items()))
    assert best["drawn, grid"] > LEAST_GAIN * best["drawn, lanes"]
