"""The worst inputs of a chain: signs of kernels and a linear program, in turn.

A bound that grows with the state makes the error depend on the product of disturbance and motion.
Along the last motion it is linear; its worst inputs give the next motion. The best one counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from certrack.certificates.worst_profile import WorstProfile, worst_profile
from certrack.studies.falsifier.linear.chain import Chain, Kernels, Motion, kernels, run
from certrack.studies.falsifier.linear.slow_signal import SlowSignal, slow_signals

#: Turns at most, and the relative gain below which there is no other.
TURNS, LEAST_GAIN = 4, 1e-4

#: Pieces by which the reference comes to rest after the end.
STOPPING_PIECES = 60


@dataclass(frozen=True)
class WorstInputs:
    """What an adversary does to a chain.

    Attributes
    ----------
    chain : Chain
    error : float
        |e_1| at the end, as far as the chain's steps are the loop.
    kernels : Kernels
        Disturbances and errors of sensors have their signs.
    reference : WorstProfile
    slow : mapping of int to SlowSignal
        Disturbances whose speed is bounded, by number of the input.
    """

    chain: Chain
    error: float
    kernels: Kernels
    reference: WorstProfile
    slow: Mapping[int, SlowSignal] = field(default_factory=dict)


def worst_inputs(chain: Chain, turns: int = TURNS) -> WorstInputs | None:
    """The worst inputs found; None where the linear program is not solved."""
    best: WorstInputs | None = None
    motion: Motion | None = None
    for _ in range(turns):
        signed = kernels(chain, motion)
        reference = worst_profile(signed.reference, chain.bounds, chain.widths, STOPPING_PIECES)
        if reference is None:
            break
        reference = _within_jumps(reference, chain.largest_jump)
        slow = slow_signals(chain, signed)
        motion = run(chain, signed, reference, {j: (w.held(), w.growth) for j, w in slow.items()})
        error = abs(motion.error)
        if best is not None and not error > best.error * (1 + LEAST_GAIN):
            break
        best = WorstInputs(chain, error, signed, reference, slow)
        if not any(chain.uncertainty.grows(k) for k in chain.acting):
            break
    return best


def _within_jumps(reference: WorstProfile, largest: float) -> WorstProfile:
    """The reference, made smaller until its last derivative jumps no more than it may."""
    steps = float(np.abs(np.diff(reference.pieces)).max(initial=0.0))
    if steps <= largest:
        return reference
    factor = largest / steps
    return WorstProfile(
        factor * reference.value,
        factor * reference.start,
        factor * reference.pieces,
        reference.widths,
    )
